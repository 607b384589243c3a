"""Logs of public repositories that nobody tuned on: what `init` and `replay` make of them.

    python -m benchmarks.public_logs --data DIR [--only NAME ...] [--names-taken-away]
                                     [--information] [--diagnose]

DIR holds a clone of each repository as OWNER+NAME (for what is absent the command is shown); the
logs are made below DIR/logs. Of each: the quantities that `init` finds with sign and unit beside
the configuration by hand in `right/`, and the mount by that configuration, of the whole and of both
halves, beside what is known. With --information also how well least squares alone know the yaw,
with --diagnose what `diagnose` says of the second half beside the first, and of effects that are
put in; that is shown and not judged.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

import numpy as np

import imucald
from benchmarks.init.judge import Verdict, judge
from benchmarks.init.renamed import renamed
from benchmarks.public_logs.diagnosed import diagnosed
from benchmarks.public_logs.frames import write_log
from benchmarks.public_logs.information import known_by_itself
from benchmarks.public_logs.logs import LOGS, PublicLog
from imucald.can.dbc.database import load_database
from imucald.can.logs.log_reader import LogReader
from imucald.config import load_config
from imucald.core.errors import ImucaldError
from imucald.core.rotations import rotation_from_angles, vector_from_rotation
from imucald.discovery import GatheredFrames, as_yaml, discover

FOUND_BAR = 0.9
FAR = 3.0
"""Standard deviations by which an estimate may differ from what is known, or from its half."""


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True, help="folder of the clones")
    parser.add_argument("--only", nargs="+", choices=[log.name for log in LOGS])
    parser.add_argument("--names-taken-away", action="store_true", help="signals without names")
    parser.add_argument("--information", action="store_true", help="what a log by itself knows")
    parser.add_argument("--diagnose", action="store_true", help="diagnose too (minutes a log)")
    options = parser.parse_args()
    logs = [log for log in LOGS if not options.only or log.name in options.only]
    absent = [log for log in logs if not log.repository.is_in(options.data)]
    for repository in dict.fromkeys(log.repository for log in absent):
        print(
            f"absent: git clone {repository.url} {options.data / repository.folder}   "
            f"# {repository.commit[:8]}, licence: {repository.licence}"
        )
    total = Verdict()
    wrong = 0
    for log in logs:
        if log in absent:
            continue
        try:
            folder = _made(log, options.data)
        except (ValueError, ImucaldError) as error:
            print(f"{log.name}: {error}")
            absent.append(log)
            continue
        one = _found(log, folder, options.names_taken_away)
        print(f"{log.name}: init {one.found} of {one.asked} right{_words(one)}", flush=True)
        for name in ("right", "unsure_right", "unsure_wrong", "wrong", "missing"):
            getattr(total, name).extend(getattr(one, name))
        for text, is_far in _mounts(log, folder):
            print(f"  {text}", flush=True)
            wrong += is_far
        for text in known_by_itself(folder) if options.information else ():
            print(f"  by itself: {text}", flush=True)
        for text in diagnosed(folder) if options.diagnose else ():
            print(f"  diagnose: {text}", flush=True)
    if not total.asked:
        print("nothing was measured")
        return 1
    print(
        f"right with sign and unit: {total.found} of {total.asked}, {len(total.unsure_right)} of "
        f"them marked unsure (bar {FOUND_BAR:.0%}); wrong and not marked: {len(total.wrong)} "
        f"(bar 0); mounts beyond {FAR:g} deviations: {wrong} (bar 0); logs absent: {len(absent)}"
    )
    return 1 if total.found < FOUND_BAR * total.asked or total.wrong or wrong or absent else 0


def _made(log: PublicLog, data: Path) -> Path:
    """The log's folder, made where it is not there yet."""
    folder = data / "logs" / log.name
    if not (folder / "drive.log").exists():
        write_log(folder, log.convert(data))
    shutil.copy(log.configuration, folder / "right.yaml")
    return folder


def _found(log: PublicLog, folder: Path, without_names: bool) -> Verdict:
    """What `init` proposes beside the configuration by hand."""
    database, right = folder / "car.dbc", folder / "right.yaml"
    if without_names:
        database, right, _ = renamed(database, right, folder / "renamed")
    out = database.parent / "proposed.yaml"
    loaded = load_database(database)
    proposal = discover(
        {database.name: loaded}, GatheredFrames.from_chunks(LogReader([folder / "drive.log"]))
    )
    proposal.driving_side = load_config(right).config.vehicle.driving_side
    out.write_text(as_yaml(proposal, [database.name]))
    return judge(proposal, out, right, {}, fixed=not without_names)


def _words(one: Verdict) -> str:
    parts = (
        ("marked unsure: ", one.unsure_right), ("wrong, marked: ", one.unsure_wrong),
        ("WRONG AND SURE: ", one.wrong), ("missing: ", one.missing),
    )  # fmt: skip
    return "".join(f"; {text}{', '.join(names)}" for text, names in parts if names)


def _mounts(log: PublicLog, folder: Path) -> list[tuple[str, bool]]:
    """Lines about the mount, each with whether it is further off than its deviation allows."""
    config = imucald.Config.load(str(folder / "right.yaml"))
    whole = imucald.replay(config, str(folder / "drive.log"))
    mount = whole.mount
    if mount is None:
        return [(f"{whole.state}: no mount", False)]
    angles = (mount.roll_deg, mount.pitch_deg, mount.yaw_deg)
    text = " ".join(f"{a:+.2f}+-{s:.2f}" for a, s in zip(angles, mount.std_deg, strict=True))
    fine = "" if whole.first_fine_s is None else f" (fine from {whole.first_fine_s:.0f} s on)"
    lines = [(f"{whole.state}{fine}: roll, pitch, yaw {text} deg", False)]
    if any(angle is not None for angle in log.known):
        truth = [np.radians(a if k is None else k) for a, k in zip(angles, log.known, strict=True)]
        off = np.degrees(vector_from_rotation(mount.matrix @ rotation_from_angles(*truth).T))
        allowed = FAR * np.hypot(mount.std_deg, log.within / 2.0)
        text = ", ".join(f"{x:+.2f}" for x in off)
        is_far = bool(np.any(np.abs(off) > allowed))
        lines.append((f"from what is known +-{log.within:g}: {text} deg", is_far))
    halves = [imucald.replay(config, str(half)) for half in _halves(folder)]
    first, second = (half.mount for half in halves)
    if first is None or second is None:
        return [*lines, ("halves: no mount in one", False)]
    apart = np.degrees(vector_from_rotation(first.matrix @ second.matrix.T))
    sd = np.hypot(first.std_deg, second.std_deg)
    text = ", ".join(f"{x:+.2f} ({abs(x) / s:.1f} sd)" for x, s in zip(apart, sd, strict=True))
    was_sent = all(half.first_usable_s is not None for half in halves)
    is_far = was_sent and bool(np.any(np.abs(apart) > FAR * sd))
    words = "" if was_sent else " (not both usable: not judged)"
    return [*lines, (f"halves apart: {text} deg{words}", is_far)]


def _halves(folder: Path) -> list[Path]:
    """The log as two files, cut at half its time."""
    lines = (folder / "drive.log").read_bytes().splitlines(keepends=True)
    stamps = np.array([float(line[1 : line.index(b")")]) for line in lines])
    cut = int(np.searchsorted(stamps, 0.5 * (stamps[0] + stamps[-1])))
    paths = [folder / "first_half.log", folder / "second_half.log"]
    for path, part in zip(paths, (lines[:cut], lines[cut:]), strict=True):
        path.write_bytes(b"".join(part))
    return paths


if __name__ == "__main__":
    sys.exit(main())
