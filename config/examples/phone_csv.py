"""Write the CSV of a phone as a CAN log.

  python config/examples/phone_csv.py phone.csv phone.log
  imucald init --database config/examples/dbc/phone.dbc phone.log --out phone.yaml

The column `t` is the time [s]; each other column has the name of a signal of dbc/phone.dbc and its
unit. A row may contain only a part of the messages, if the phone samples its sensors separately.
"""

import csv
import sys
from pathlib import Path

import can
import cantools

messages = cantools.database.load_file(Path(__file__).parent / "dbc" / "phone.dbc").messages
with Path(sys.argv[1]).open(newline="") as rows, can.Logger(sys.argv[2]) as log:
    for row in csv.DictReader(rows):
        for message in messages:
            texts = {name: row.get(name) for name in message.signal_tree}
            if all(texts.values()):
                data = message.encode({name: float(text) for name, text in texts.items()})
                log(can.Message(float(row["t"]), message.frame_id, False, data=data))
