"""Replay of a long log against python-can's reader and cantools' decode, as whole processes.

    python -m benchmarks.replay_speed [--rounds 3] [--long] [--many]

The log is simulated once: 1,000,000 frames at about 2,700 frames a second, 15 % of them ours, with
counters and checksums. Times are the best of alternating rounds. The first round, which does not
count, fills the caches that any installation has; one line says what it takes to parse the
database anew, as after a change.

--many: that log five times in one process through `imucald.replay`, against the peer's five in one;
and an hour of driving with all its signals kept (the simulated bus alone, without other units).
"""

from __future__ import annotations

import argparse
import itertools
import sys
from pathlib import Path

from benchmarks.measured import EXAMPLES, ROOT, Run, best, imucald, made_once, run, verdict

FRAMES = 1_000_000
MINUTES = 6.3
"""A little more than that many frames need."""
SETTINGS = (
    "--seed",
    "1",
    "--set",
    "steering.rate_hz=50",
    "--set",
    "bus.background_frames_per_s=2290",
)
CONFIG = EXAMPLES / "passenger_car.yaml"
DATABASE = ROOT / "daemon" / "imucald" / "data" / "imucald_example.dbc"
IN_TEXT = "database: ../../dbc/imucald_example.dbc"
"""How the configuration names it: a copy lies elsewhere."""
PEER = "python-can + cantools"
PARSED = "  its database parsed"
NOTHING_KEPT = {"CACHE_DIRECTORY": "/dev/null/nothing"}
"""No folder can be made there."""
BAR_READ, BAR_WRITE, BAR_MEMORY = 10.0, 4.0, 300.0
"""Times faster without and with output; MiB."""
BAR_MANY = 20.0
"""Times faster, five logs in one process."""
BAR_HOUR = 1.5
"""Processor time of an hour of driving with all signals, by estimator [s]."""
MANY = 5
HOUR = ("--seed", "1", "--minutes", "60")


def log_of(frames: int) -> Path:
    """A log of exactly so many frames."""
    minutes = str(MINUTES * frames / FRAMES)

    def make(path: Path) -> None:
        whole = path.with_suffix(".whole")
        run(imucald("simulate", "--out", whole, "--minutes", minutes, "--background", *SETTINGS))
        with whole.open("rb") as source, path.open("wb") as target:
            target.writelines(itertools.islice(source, frames))
        whole.unlink()

    return made_once(f"vehicle-{frames}.log", f"{frames} {minutes} {SETTINGS}", make)


def replay(log: Path, *more: str) -> list[str]:
    return imucald("replay", log, "--config", CONFIG, "--quiet", *more)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--long", action="store_true", help="memory on a log four times as long")
    parser.add_argument("--many", action="store_true", help="logs in one process; an hour")
    options = parser.parse_args()
    log = log_of(FRAMES)
    out = log.with_suffix(".out")
    commands = {
        PEER: [
            sys.executable, "-m", "benchmarks.replay_peer", str(DATABASE), str(log),
        ],
        "imucald replay": replay(log),
        "imucald replay --out": replay(log, "--out", str(out)),
        PARSED: replay(log),
    }  # fmt: skip
    runs: dict[str, list[Run]] = {name: [] for name in commands}
    for k in range(options.rounds + 1):
        for name, command in commands.items():
            found = run(command, NOTHING_KEPT if name == PARSED else None)
            if k > 0:  # the first round compiles modules and warms the file cache
                runs[name].append(found)
    out.unlink()
    peer = best(runs[PEER])
    read, used = map(int, peer.output.split())
    print(
        f"{read} frames, {used} of them ours ({100 * used / read:.1f} %), best of {options.rounds}"
    )
    bars = {"imucald replay": BAR_READ, "imucald replay --out": BAR_WRITE}
    met = True
    for name, found in runs.items():
        one = best(found)
        cpu, ratio = min(r.cpu for r in found), peer.wall / one.wall
        line = f"{name:24s} {one.wall:7.2f} s  {cpu:6.2f} s cpu  {one.memory:5.0f} MiB"
        if name == PARSED:
            line += f"  {ratio:5.1f} x faster"
        elif name in bars:
            met &= ratio >= bars[name] and one.memory < BAR_MEMORY
            line += (
                f"  {ratio:5.1f} x faster (bar {bars[name]:.0f}: {verdict(ratio >= bars[name])})"
            )
        print(line)
    if options.long:
        long = run(replay(log_of(4 * FRAMES), "--out", "/dev/null"))
        met &= long.memory < BAR_MEMORY
        print(
            f"{'four times the log':24s} {long.wall:7.2f} s  {long.cpu:6.2f} s cpu  "
            f"{long.memory:5.0f} MiB (bar {BAR_MEMORY:.0f}: {verdict(long.memory < BAR_MEMORY)})"
        )
    if options.many:
        met &= many(log, options.rounds)
    return 0 if met else 1


def many(log: Path, rounds: int) -> bool:
    """Five logs in one process, and an hour with all signals; whether all bars are met."""
    logs = [str(log)] * MANY
    peer_command = [sys.executable, "-m", "benchmarks.replay_peer", str(DATABASE), *logs]
    ours = [sys.executable, "-m", "benchmarks.replay_many", str(CONFIG)]
    peers, five = [], []
    for _ in range(rounds):
        peers.append(run(peer_command))
        five.append(run([*ours, "result", *logs]))
    peer, one = (min(found, key=lambda r: r.cpu) for found in (peers, five))
    ratio = peer.cpu / one.cpu
    bar = f"(bar {BAR_MANY:.0f}: {verdict(ratio >= BAR_MANY)})"
    print(f"{MANY} logs in one process, processor time: {PEER} {peer.cpu:.2f} s, imucald "
          f"{one.cpu:.2f} s ({one.memory:.0f} MiB): {ratio:.1f} x faster {bar}")  # fmt: skip

    def make(path: Path) -> None:
        run(imucald("simulate", "--out", path, *HOUR))

    hour = made_once("hour.log", " ".join(HOUR), make)
    runs = [run([*ours, "signals", str(hour)]) for _ in range(rounds)]
    read, _, _ = best(runs).output.split()
    took = min(float(r.output.split()[2]) for r in runs)
    memory = max(r.memory for r in runs)
    bar = f"(bar {BAR_HOUR} s: {verdict(took <= BAR_HOUR)})"
    print(f"an hour of driving, {read} frames, all signals kept: "
          f"{took:.2f} s cpu, {memory:.0f} MiB {bar}")  # fmt: skip
    return ratio >= BAR_MANY and took <= BAR_HOUR


if __name__ == "__main__":
    sys.exit(main())
