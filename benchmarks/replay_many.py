"""Several logs in one process through `imucald.replay`, for `replay_speed --many`.

python -m benchmarks.replay_many CONFIG {signals,result} LOG...

Prints frames read and used, and the processor time [s] that the replays took without the start.
"""

from __future__ import annotations

import os
import sys
import time

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def main() -> None:
    import imucald

    path, what, *logs = sys.argv[1:]
    config = imucald.Config.load(path)
    began = time.process_time()
    drives = [imucald.replay(config, log, signals=what == "signals") for log in logs]
    took = time.process_time() - began
    read = sum(drive.frames["read"] for drive in drives)
    print(read, sum(drive.frames["used"] for drive in drives), round(took, 3))


if __name__ == "__main__":
    main()
