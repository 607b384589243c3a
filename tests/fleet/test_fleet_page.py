"""docs/fleet.md: its first fleet file works with the logs that it has one simulate; it names every
way to fail."""

from __future__ import annotations

import re
from pathlib import Path

from fleet_files import CONFIG

from imucald.fleet.drive_row import _causes
from imucald.fleet.fleet_file import load_fleet
from imucald.fleet.listing import list_logs
from imucald.fleet.reading import present_mounts
from imucald.fleet.task import FAILURES
from paths import ROOT


def test_the_first_fleet_file_of_the_page_lists_the_logs_of_its_commands(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "fleet.md").read_text()
    written = re.findall(r"imucald simulate .*--out (\S+)", text)
    assert len(written) > 1
    for name in written:
        log = tmp_path / name
        log.parent.mkdir(parents=True)
        log.write_text("(1.0) can0 001#00\n")
    example = text.partition("```yaml\n")[2].partition("```")[0]
    assert "config: car.yaml" in example
    (tmp_path / "fleet.yaml").write_text(example.replace("car.yaml", str(CONFIG)))
    fleet = load_fleet(tmp_path / "fleet.yaml")
    found = {log.source.removeprefix("file://") for log in list_logs(fleet)}
    assert {str(Path(source).relative_to(tmp_path)) for source in found} == set(written)
    assert {fleet.named(source)[0] for source in found} == {"car-1", "car-2"}


def test_the_page_names_every_way_in_which_a_log_can_fail() -> None:
    text = (ROOT / "docs" / "fleet.md").read_text()
    failing = text.partition("or in `failures` as ")[2].partition(". ")[0]
    assert set(re.findall(r"`(\w+)`", failing)) == set(FAILURES)


def test_a_change_within_its_interval_is_no_fault_of_a_drive() -> None:
    shift: dict[str, float | None] = {"within_deg": 1.0}
    result = {"signal_health": {"events": []}, "details": {"shifts": [shift]},
              "frames": {"used": 1, "rejected": {}}}  # fmt: skip
    assert list(_causes(result)) == []
    shift["within_deg"] = None
    assert list(_causes(result)) == ["mount moved in the drive"]


def test_the_mount_of_a_vehicle_is_that_since_its_sensor_was_last_moved() -> None:
    vehicles = [
        {"vehicle": name, "vehicle_type": "van", "drives": drives}
        for name, drives in (("b", 1), ("a", 5), ("unknown", 0))
    ]
    segments = [
        {"vehicle": "a", "segment": 1, "roll_deg": 5.0},
        {"vehicle": "a", "segment": 0, "roll_deg": 0.0},
        {"vehicle": "b", "segment": 0, "roll_deg": 2.0},
    ]
    moves = [{"vehicle": "a", "found": found} for found in (True, False)]
    found = present_mounts(vehicles, segments, moves)
    assert [(r["vehicle"], r["roll_deg"], r["all_drives"], r["moves"]) for r in found] == [
        ("a", 5.0, 5, 1),
        ("b", 2.0, 1, 0),
    ]
