"""How much of a configuration `imucald init` finds, and whether it calibrates as the right one.

    python -m benchmarks.init [--part measured|second_world|renamed|obfuscated] [--unseen]

Of every quantity of the hand-written configuration: right with sign and unit, or not; then the
state that `replay` reaches with either. Drives and seeds of `UNSEEN` were named before `init` was
written and are looked at with --unseen, once, at the end.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from benchmarks.init.judge import Quantities, Verdict, judge, quantities_of
from benchmarks.init.obfuscated import write_bus
from benchmarks.init.renamed import renamed
from benchmarks.measured import DATA, FOLDER, MEASURED_DRIVES, is_here, nothing_measured, verdict
from imucald.can.dbc.database import load_database
from imucald.can.logs.log_reader import LogReader
from imucald.config import load_config
from imucald.config_check import Check
from imucald.discovery import GatheredFrames, as_yaml, discover
from imucald.discovery.candidates import candidates_of, messages_in
from imucald.runtime.replay import Replay
from imucald.runtime.session import make_engine, open_config

PARTS = ("measured", "second_world", "renamed", "obfuscated")
"""Renamed: the first two with names that tell nothing."""
MEASURED = ("wrx_sti", "css_canmod_164", "kingston_2008", "vehsense_2018_08_04")
SECOND_WORLD = ("01", "04", "09", "14")
SEEDS = tuple(range(1, 11))
UNSEEN_MEASURED = (
    "quat_orient_21", "vehsense_2017_10_23_2245", "vehsense_2017_10_25_1829", "neu_circles",
    "ped_ethz", "ped_aymdi", "ped_everett_walk",
)  # fmt: skip
UNSEEN_SECOND_WORLD = ("02", "03", "05", "06", "07", "08", "10", "11", "12", "13")
UNSEEN_SEEDS = tuple(range(101, 111))
FOUND_BAR = 0.9
MINUTES = 10.0
WORTH = {"none": 0, "waiting": 1, "levelled": 2, "suspect": 2, "recalibrating": 2, "restored": 3,
         "usable": 3, "fine": 4}  # fmt: skip
"""States by what is sent in them."""

ALSO: Mapping[str, Mapping[str, Any]] = {
    "second_world": {
        "lamp": {"reverse": "GW_Antrieb.GW_Ruecklicht"},
        **{f"wheel {w}": {"reverse": {"signal": f"ESP_Rad_03.Rad_{w}_Dir", "equals": 2}}
           for w in ("VL", "VR", "HL", "HR")},
    },
    "css_canmod_164": {"gnss": {"heading": "gnss_attitude.Heading"}},
}  # fmt: skip
"""Further right answers: signals that say the same."""
WALKS: Mapping[str, Mapping[str, Any]] = {
    name: {
        "accelerometer": {a: f"IMU_ACCEL.ACCEL_{a.upper()}" for a in "xyz"},
        "gyroscope": {a: f"IMU_GYRO.GYRO_{a.upper()}" for a in "xyz"},
        **({"magnetometer": {a: f"IMU_MAG.MAG_{a.upper()}" for a in "xyz"}} if "walk" not in name
           else {}),
    }
    for name in ("ped_aymdi", "ped_everett_walk")
}  # fmt: skip
"""What is right in drives that have no example."""


@dataclass
class Case:
    """One log with its database and the configuration that is right."""

    name: str
    log: Path
    database: Path
    right: Path
    also: Mapping[str, Any] = field(default_factory=dict)
    are_named: bool = True


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--part", choices=PARTS)
    parser.add_argument("--unseen", action="store_true", help="the drives kept for the end")
    parser.add_argument("--only", help="a case by its name")
    parser.add_argument("--seeds", help="other obfuscated buses, as 11-40")
    parser.add_argument("--no-replay", action="store_true", help="judge the proposal alone")
    options = parser.parse_args()
    total = Verdict()
    worse = 0
    print(f"{'case':28} found sure/unsure  wrong: marked, unmarked; missing   by hand -> proposed")
    seeds: tuple[int, ...] = UNSEEN_SEEDS if options.unseen else SEEDS
    if options.seeds:
        first, last = map(int, options.seeds.split("-"))
        seeds = tuple(range(first, last + 1))
    for case in _cases("obfuscated" if options.seeds else options.part, options.unseen, seeds):
        if options.only not in (None, case.name):
            continue
        if not case.log.exists():
            print(f"{case.name}: absent ({case.log}), not measured")
            continue
        one, by_hand, proposed = _run(case, not options.no_replay)
        for name in ("right", "unsure_right", "unsure_wrong", "wrong", "missing", "beyond"):
            getattr(total, name).extend(f"{case.name}: {q}" for q in getattr(one, name))
        worse += WORTH[proposed] < WORTH[by_hand]
        words = ", ".join(
            f"{kind} {', '.join(names)}"
            for kind, names in (
                ("unsure:", one.unsure_right), ("marked:", one.unsure_wrong),
                ("WRONG:", one.wrong), ("missing:", one.missing), ("also:", one.beyond),
            ) if names
        )  # fmt: skip
        print(
            f"{case.name:28} {one.found:2}/{one.asked:2} {len(one.right):2}/{len(one.unsure_right)}"
            f"   {len(one.unsure_wrong)}, {len(one.wrong)}; {len(one.missing)}"
            f"   {by_hand} -> {proposed}   {words}",
            flush=True,
        )
    if total.asked:
        is_met = _told(total, worse)
    measured = _measured_drives("obfuscated" if options.seeds else options.part, options.unseen)
    if measured and not any(map(is_here, measured)):
        return nothing_measured(*measured)
    return 0 if total.asked and is_met else 1


def _told(total: Verdict, worse: int) -> bool:
    """Print what all cases came to; whether the bars are met."""
    part = total.found / total.asked
    print(
        f"right with sign and unit: {total.found} of {total.asked} ({100 * part:.1f} %, "
        f"{len(total.unsure_right)} of them marked unsure; bar 90: {verdict(part >= FOUND_BAR)})"
    )
    print(f"wrong and not marked: {len(total.wrong)} (bar 0: {verdict(not total.wrong)})")
    print(f"states below those of the right configuration: {worse} (bar 0: {verdict(not worse)})")
    return part >= FOUND_BAR and not total.wrong and not worse


def _measured_drives(part: str | None, unseen: bool) -> tuple[str, ...]:
    """Folders of the drives that a part is about."""
    if part == "obfuscated":
        return ()
    logs = UNSEEN_MEASURED if unseen else MEASURED
    return {"measured": logs, "second_world": ("second_world",)}.get(
        part or "", (*logs, "second_world")
    )


def _run(case: Case, replays: bool) -> tuple[Verdict, str, str]:
    folder = FOLDER / "init"
    folder.mkdir(parents=True, exist_ok=True)
    recording = GatheredFrames.from_chunks(LogReader([case.log]))
    path = os.path.relpath(case.database, folder)
    database = load_database(case.database)
    proposal = discover({path: database}, recording)
    # the one thing that nobody can see in a recording, and that the user fills in
    proposal.driving_side = load_config(case.right).config.vehicle.driving_side
    out = folder / f"{case.name}.yaml"
    out.write_text(as_yaml(proposal, [path]))
    also = {name: _quantities(case, signals) for name, signals in case.also.items()}
    moving = {
        c.path
        for one in messages_in(database, recording.traffic(), None)
        for c in candidates_of(one, int(recording.seconds * 10.0) + 1)
        if not c.is_constant
    }
    unseen = frozenset(
        name
        for name, numbers in quantities_of(case.right)[0].items()
        if any("." in n.source and n.source not in moving for n in numbers.values())
    )
    one = judge(proposal, out, case.right, also, case.are_named, unseen)
    if not replays:
        return one, "none", "none"
    return one, _state(case.right, case.log), _state(out, case.log)


def _quantities(case: Case, signals: Mapping[str, Any]) -> Quantities:
    path = FOLDER / "init" / f"also-{case.name}.yaml"
    axes: dict[str, str] = {}
    whole = {"database": str(case.database), "signals": {**signals}}
    if "accelerometer" not in signals:
        hand = quantities_of(case.right)[0]["accelerometer"]
        axes = {"xyz"[slot]: number.source for slot, number in hand.items()}
        whole["signals"]["accelerometer"] = axes
    path.write_text(json.dumps(whole))
    found = quantities_of(path)[0]
    return {name: found[name] for name in signals}


def _state(config: Path, log: Path) -> str:
    """The best state that a replay reaches; 'none' where the configuration cannot be used."""
    loaded = open_config(config)
    check = Check(loaded)
    for chunk in LogReader([log]):
        check.feed(chunk)
    if not check.report()["usable"]:
        return "none"
    engine = make_engine(open_config(config))
    summary = Replay(engine, LogReader([log], engine.router.matches)).run()
    return str(summary["state"])


def _renamed(case: Case) -> Case:
    """A case without the names; axes are known up to a rotation then."""
    folder = FOLDER / "init" / f"renamed-{case.name}"
    database, right, paths = renamed(case.database, case.right, folder)
    also = json.dumps(case.also)
    for old, new in paths.items():
        also = also.replace(f'"{old}"', f'"{new}"')
    return Case(f"renamed {case.name}", case.log, database, right, json.loads(also), False)


def _cases(part: str | None, unseen: bool, seeds: tuple[int, ...]) -> Iterator[Case]:
    if part in (None, "measured"):
        for name in UNSEEN_MEASURED if unseen else MEASURED:
            folder = DATA / name
            right = MEASURED_DRIVES / f"{name}.yaml"
            if not right.exists():
                right = folder / "car.yaml"
            if name in WALKS:
                right = FOLDER / f"{name}.yaml"
                FOLDER.mkdir(exist_ok=True)
                database = str(folder / "drive.dbc")
                right.write_text(json.dumps({"database": database, "signals": WALKS[name]}))
            yield Case(
                name, folder / "drive.log.gz", folder / "drive.dbc", right, ALSO.get(name, {})
            )
    if part in (None, "second_world"):
        world = DATA / "second_world"
        for number in UNSEEN_SECOND_WORLD if unseen else SECOND_WORLD:
            for folder in sorted(world.glob(f"{number}_*")):
                yield Case(
                    folder.name, folder / "can.log.gz", world / "oem.dbc", folder / "car.yaml",
                    ALSO["second_world"],
                )  # fmt: skip
    if part in (None, "renamed"):
        for case in (*_cases("measured", unseen, ()), *_cases("second_world", unseen, ())):
            if case.log.exists():
                yield _renamed(case)
    if part in (None, "obfuscated"):
        for seed in seeds:
            folder = FOLDER / "init" / f"seed{seed}"
            database, log, config = write_bus(seed, folder, MINUTES)
            yield Case(f"obfuscated {seed}", log, database, config, are_named=False)


if __name__ == "__main__":
    sys.exit(main())
