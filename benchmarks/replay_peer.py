"""The peer of `replay_speed`: python-can's candump reader and cantools' decode, ours only.

python -m benchmarks.replay_peer DATABASE LOG...
"""

from __future__ import annotations

import sys

import can
import cantools.database


def main() -> None:
    database, *logs = sys.argv[1:]
    loaded = cantools.database.load_file(database)
    decoders = {message.frame_id: message.decode for message in loaded.messages}
    read = used = 0
    for log in logs:
        for message in can.CanutilsLogReader(log):
            read += 1
            decode = decoders.get(message.arbitration_id)
            if decode is not None:
                decode(message.data)
                used += 1
    print(read, used)


if __name__ == "__main__":
    main()
