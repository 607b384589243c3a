"""`status` and `monitor` on terminals of several sizes, and the page of `monitor --web`."""

from __future__ import annotations

import asyncio
import copy
import io
import itertools
import json
import shutil
import socket
import subprocess
import threading
import time
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from rich.text import Text

from imucald.commands.monitor_view import LiveEvent, input_health, live_events, monitor_picture
from imucald.commands.status import exit_status
from imucald.commands.status_view import (
    headline,
    no_answer,
    picture,
    print_status,
    short,
)
from imucald.core.errors import LinkError
from imucald.mount.contradictions import WORDS, StandingFault
from imucald.mount.estimate import ANGLES
from imucald.runtime.flow import flow
from imucald.service.asking import BusyError
from imucald.service.journal import Journal
from imucald.service.parts import ServiceOptions
from imucald.service.recent_history import COLUMNS
from imucald.service.service import Service
from simulated_bus import CONFIG

REASON = "acceleration or braking above 1 m/s2 (2 of 3 seen), and then a little more of it"
NUMBERS = itertools.count()


@pytest.fixture(scope="module")
def silent():
    """The status of a daemon that has heard nothing."""
    options = ServiceOptions(config=CONFIG, interface="virtual", channel=f"mon-{next(NUMBERS)}")
    service = Service(options, Journal(io.StringIO()))
    try:
        return json.loads(json.dumps(service.status()))
    finally:
        service.close()


@pytest.fixture
def status(silent):
    """The status of one that is usable."""
    found = copy.deepcopy(silent)
    found |= {"state": "usable", "quality": 2, "first_usable_s": 76.8, "duration_s": 100.0}
    found["mount"] = {
        "roll_deg": 14.4, "pitch_deg": 28.6, "yaw_deg": -10.6,
        "quaternion_wxyz": [0.9546, 0.1431, 0.2331, -0.1182],
        "std_deg": {"x": 0.5, "y": 0.3, "z": 0.35},
        "angle_std_deg": {"roll": 0.56, "pitch": 0.31, "yaw": 0.44},
        "sits": "x points forward, 29 deg down; y points left; z points up, 26 deg forward",
        "steep": None,
        "mirrored": None,
        "target_std_deg": {"usable": {"x": 2.0, "y": 2.0, "z": 1.0},
                           "fine": {"x": 0.8, "y": 0.7, "z": 0.3}},
    }  # fmt: skip
    found["waiting_for"] = {"roll": REASON, "pitch": REASON, "yaw": "more driving"}
    found["signals"] = {"accel": {"samples": 10, "rate_hz": 100.0},
                        "speed": {"samples": 5, "rate_hz": 0.0}}  # fmt: skip
    found["signal_health"] = {"sensors": {"accel": {"stuck": "y"}}, "events": []}
    found["health"] = dict.fromkeys(found["health"], False)
    found["link"] |= {"state": "up"}
    found["silent_s"] = 0.0
    return found


def drawn(part, width: int, height: int = 40) -> list[str]:
    console = Console(width=width, height=height, file=io.StringIO(), force_terminal=False)
    made = part(console) if callable(part) else part
    console.print(made)
    return console.file.getvalue().splitlines()  # type: ignore[attr-defined]


def without_input(status) -> dict[str, Any]:
    """The same daemon 25 s after the last frame."""
    health = status["health"] | {"accelerometer_missing": True}
    return status | {"silent_s": 25.0, "health": health}


SEEN_FIRST = {
    "all is well": ({}, {}, "corrected frames flow, marked fine"),
    "no frame comes": ({"silent_s": 25.0}, {"accelerometer_missing": True}, "NO INPUT for 25 s"),
    "other frames come": ({}, {"accelerometer_missing": True}, "NO ACCELEROMETER"),
    "the bus is down": ({"link": {"state": "down"}}, {}, "BUS DOWN"),
    "the bus takes nothing": ({}, {"send_failed": True}, "FRAMES NOT SENT"),
    "a stuck sensor": ({}, {"accelerometer_faulty": True}, "ACCELEROMETER FAULTY"),
    "two calibrators": ({}, {"id_conflict": True}, "ANOTHER NODE SENDS OUR IDS"),
    "a suspect mount": ({"state": "suspect", "quality": 4}, {}, "SUSPECT"),
    "no mount yet": ({"state": "levelled", "quality": 0, "first_usable_s": None}, {}, "not yet"),
    "an uncertain mount": ({"state": "levelled", "quality": 0}, {}, "not certain any more"),
}


@pytest.mark.parametrize("case", SEEN_FIRST)
def test_the_first_line_says_whether_corrected_frames_flow_now(status, case):
    changed, alarms, words = SEEN_FIRST[case]
    now = status | {"state": "fine", "quality": 3, "uptime_s": 100.0} | changed
    now["link"] = status["link"] | changed.get("link", {})
    now["health"] = status["health"] | alarms
    for lines in (
        drawn(picture(now), 80),
        drawn(lambda c: monitor_picture(now, [], c, Text("")), 80, 24),
        [short(now)],
        [short(now, with_angles=False)],
    ):
        assert lines[0].startswith(words)
        if changed.get("state") is None and words != SEEN_FIRST["all is well"][2]:
            assert "(mount: fine)" in lines[0]
    assert flow(now).kind == {"all is well": "good", "no mount yet": "not yet"}.get(
        case,
        {
            "an uncertain mount": "not yet",
            "a stuck sensor": "faulty",
            "a suspect mount": "suspect",
            "two calibrators": "conflict",
        }.get(case, "none"),
    )


def test_a_known_mount_has_no_colour_while_nothing_flows(status):
    """What was green on a bus without input misled."""
    console = Console(width=100, file=io.StringIO(), force_terminal=True, color_system="standard")
    status["progress"] = PROGRESS
    silent = without_input(status) | {"state": "fine", "quality": 3}
    console.print(headline(silent))
    console.print(monitor_picture(silent, [], console, Text("")))
    console.print(picture(silent))
    dead = monitor_picture(status, [], console, Text(""), "the daemon has ended")
    console.print(dead)
    text = console.file.getvalue()  # type: ignore[attr-defined]
    green = "\x1b[1;32m"
    assert f"{green}fine" not in text
    assert "\x1b[32m" not in text
    console.print(headline(status | {"state": "fine", "quality": 3}))
    console.print(picture(status))
    text = console.file.getvalue()  # type: ignore[attr-defined]
    assert f"{green}fine" in text
    assert "\x1b[32m━" in text, "the gate at 100 %"


def test_nobody_is_asked_to_drive_while_nothing_flows(status):
    """Driving does not help: the input has to come back first."""
    status["progress"] = PROGRESS
    silent = without_input(status)
    ended = "the daemon has ended"
    for words in (short, partial(short, with_angles=False)):
        assert "3 min of driving" not in words(silent)
        assert "waiting for" not in words(silent)
    for size in ((100, 50), (80, 24)):
        for one, trouble in ((silent, ""), (status, ended)):
            console = Console(width=size[0], height=size[1], file=io.StringIO())
            shown = monitor_picture(one, [], console, Text(""), trouble)
            text = "\n".join(drawn(shown, *size))
            assert "of driving" not in text
            assert "waiting for" not in text
    assert "waiting for" not in "\n".join(drawn(picture(silent), 100))
    assert "of driving" in "\n".join(drawn(picture(status), 100))


def test_a_daemon_that_does_not_answer_is_the_first_line(status):
    lines = drawn(lambda c: monitor_picture(status, [], c, Text(""), "no such socket"), 80, 24)
    assert lines[0].startswith("NO ANSWER: no such socket")


@pytest.mark.parametrize("size", [(80, 24), (120, 40)])
def test_the_last_status_of_an_ended_daemon_is_not_said_to_be_now(status, size):
    status["health"] |= {"speed_missing": True}
    lines = drawn(lambda c: monitor_picture(status, [], c, Text(""), "ended"), *size)
    assert not [line for line in lines if line.startswith("now ")]
    lines = drawn(lambda c: monitor_picture(status, [], c, Text("")), *size)
    assert [line for line in lines if line.startswith("now ")]


def test_an_ended_daemon_and_a_silent_one_are_named_with_the_time_of_the_last_answer():
    gone, silent = LinkError("/run/x.sock: refused"), BusyError("no answer")
    clock = time.strftime("%H:%M:%S", time.localtime(1.6e9))
    ended = f"the daemon has ended; its last answer was at {clock}"
    assert no_answer(gone, 1.6e9) == ended
    assert no_answer(silent, 1.6e9) == ended.replace("has ended", "does not answer")
    assert no_answer(gone, None) == "/run/x.sock: refused", "it may never have run"


def test_a_low_terminal_shows_what_is_wrong_with_events_and_foot(status):
    status["health"] |= {"id_conflict": True}
    status["progress"] = PROGRESS
    status["mount"]["steep"] = "the angles of a steep mount go together: use the quaternion " * 2
    events = events_of(status, [{"at": 1.6e9, "level": "notice", "text": "usable at 70.4 s"}])
    lines = drawn(lambda c: monitor_picture(status, events, c, Text("the foot")), 80, 24)
    assert len(lines) <= 24
    assert lines[-1].strip() == "the foot"
    assert "now     another node sends our ids" in "\n".join(lines)
    assert events[-1].clock in "\n".join(lines)


@pytest.mark.parametrize(("height", "is_repeated"), [(24, True), (60, False)])
def test_a_status_longer_than_the_terminal_ends_with_its_first_line(status, height, is_repeated):
    file = io.StringIO()
    print_status(Console(width=80, height=height, file=file, force_terminal=True), status)
    lines = [Text.from_ansi(line).plain for line in file.getvalue().splitlines()]
    assert lines[0] == "corrected frames flow, marked usable"
    assert (lines[-1] == lines[0]) == is_repeated


def test_an_input_that_is_not_checked_is_not_green(status):
    assert input_health(status, "speed", 50.0) == ("received, not checked", "dim")


def test_one_line_has_flow_angles_and_what_is_waited_for(status):
    line = short(status)
    assert "\n" not in line
    assert line.startswith("corrected frames flow, marked usable; roll +14.40° ±")
    assert f"waiting for roll, pitch: {REASON}" in line


def test_an_angle_that_is_not_known_is_said_so_in_one_line(status):
    status["mount"]["angle_std_deg"]["yaw"] = 90.0
    assert ", yaw not known; waiting for" in short(status)


def events_of(status, logged=()) -> list[LiveEvent]:
    return live_events(status, 1.6e9, logged)


@pytest.mark.parametrize("width", [80, 100, 140])
def test_no_reason_is_cut_at_any_width(status, width):
    events = events_of(status)
    for lines in (
        drawn(lambda c: monitor_picture(status, events, c, Text("foot")), width, 50),
        drawn(picture(status), width),
    ):
        assert max(map(len, lines)) <= width
        assert " ".join(" ".join(lines).split()).count(REASON) >= 1
        assert "…" not in "".join(lines)


def row(text: str, name: str) -> list[str]:
    (found,) = (line for line in text.splitlines() if line.startswith(name))
    return found.split()


def test_now_and_target_stand_side_by_side_with_one_convention(status):
    text = "\n".join(drawn(picture(status), 100))
    assert row(text, "yaw") == ["yaw", "-10.60°", "±0.88°"]
    assert row(text, "up axis") == ["up", "axis", "±0.70°", "fine", "below", "±0.60°"]
    assert text.count("± is 95 %") == 1
    assert "waiting for  roll, pitch: " in text
    assert status["mount"]["sits"] in " ".join(text.split())


def test_what_is_judged_stands_beside_the_target_and_not_what_the_housing_is_known_to(status):
    status["mount"]["judged_std_deg"] = {"x": 0.25, "y": 0.3, "z": 0.12}
    text = "\n".join(drawn(picture(status), 100))
    assert row(text, "yaw") == ["yaw", "-10.60°", "±0.88°"]
    assert row(text, "up axis") == ["up", "axis", "±0.24°", "fine", "below", "±0.60°"]


def test_no_row_has_two_plus_minus(status):
    """One for the angle of the housing and one for a corrected axis read as one."""
    for part in (picture(status), lambda c: monitor_picture(status, [], c, Text(""))):
        lines = drawn(part, 120)
        assert all(line.count("±") == 1 for line in lines if line.startswith(tuple(ANGLES)))
        axes = [line for line in lines if " axis  " in line and "below" in line]
        assert [line.count("±") for line in axes] == [2] * 3, "and the limit of its target"


PROGRESS = {
    "goal": "fine",
    "gates": [
        {"gate": "forward axis", "share": 1.0, "left_s": 0},
        {"gate": "up axis", "share": 0.349, "left_s": 160},
        {"gate": "check of the signs", "share": 0.7, "left_s": None},
    ],
}


def test_each_gate_has_a_bar_with_its_share_and_the_driving_that_is_left(status):
    status["progress"] = PROGRESS
    lines = drawn(lambda c: monitor_picture(status, [], c, Text("")), 100)
    names = ("forward axis", "up axis", "check of the signs")
    forward, up, signs = (next(x for x in lines if x.startswith(n) and " %" in x) for n in names)
    assert any(line.startswith("to fine") for line in lines)
    assert forward.split()[-2:] == ["100", "%"]
    assert up.rstrip().endswith("34 %  about 3 min of driving")
    assert signs.rstrip().endswith("70 %")


def test_a_low_terminal_keeps_the_progress_and_the_newest_event(status):
    """As one line, and cut, where the bars and the whole text do not fit."""
    status["progress"] = PROGRESS
    status["waiting_for"] = {"roll": "word " * 30, "pitch": "other " * 25, "yaw": "more " * 30}
    events = [LiveEvent(1.6e9, "state", "an event of many lines " * 20)]
    lines = drawn(lambda c: monitor_picture(status, events, c, Text("the foot")), 80, 24)
    assert len(lines) <= 24
    assert "to fine: check of the signs 70 %" in lines
    assert sum("an event of many lines" in line for line in lines) == 1


def test_a_contradiction_of_signals_names_the_next_command(status):
    status["standing_faults"] = [StandingFault.TURN_YAW_RATE.value]
    for part in (picture(status), lambda c: monitor_picture(status, [], c, Text(""))):
        assert "run 'imucald check'" in " ".join("\n".join(drawn(part, 100)).split())
    status["standing_faults"] = []
    status["waiting_for"] = {"yaw": f"{WORDS[StandingFault.TURN_YAW_RATE]}; other"}
    assert "imucald check" not in "\n".join(drawn(picture(status), 100))


def test_time_that_is_left_is_in_seconds_below_a_minute(status):
    status["progress"] = {"goal": "usable", "gates": [{"gate": "g", "share": 0.2, "left_s": 26}]}
    assert short(status).endswith("to usable: g 20 %, about 30 s of driving")


def test_one_line_has_the_gate_that_takes_longest(status):
    status["progress"] = PROGRESS
    assert short(status).endswith("; to fine: check of the signs 70 %")
    gates = [*PROGRESS["gates"][:2]]  # type: ignore[index]
    status["progress"] = {"goal": "fine", "gates": gates}
    assert short(status).endswith("; to fine: up axis 34 %, about 3 min of driving")
    assert "to fine" not in short(status | {"progress": None})


def test_the_target_is_that_of_the_state_that_is_waited_for(status):
    """All deviations small, and the signs not seen to agree: *usable* is what comes next."""
    status["progress"] = {"goal": "usable", "gates": PROGRESS["gates"][2:]}  # type: ignore[index]
    assert "usable below ±2.00°" in "\n".join(drawn(picture(status), 100))


def test_a_mount_that_stays_fine_beyond_its_limit_shows_how_long(status):
    """Yaw ±0.70° next to 'fine below ±0.60°' would contradict the state."""
    text = "\n".join(drawn(picture(status | {"state": "fine", "quality": 3}), 100))
    assert "±0.70°  fine up to ±0.84°" in text
    assert "fine below ±0.60°" not in text


def test_a_monitor_shows_what_the_daemon_logged(status):
    logged = [{"at": 1.5e9, "level": "notice", "text": "usable at 70.4 s"},
              {"at": 1.5e9 + 1.0, "level": "warning", "text": "no speed"}]  # fmt: skip
    found = [(e.at, e.kind, e.text) for e in events_of(status, logged)]
    assert found == [(1.5e9, "log", "usable at 70.4 s"), (1.5e9 + 1.0, "alarm", "no speed")]


@pytest.mark.parametrize(("width", "height"), [(80, 24), (80, 40), (120, 30), (140, 40)])
def test_the_picture_fits_the_terminal_with_its_newest_event_and_foot(status, width, height):
    status["progress"] = PROGRESS
    status["correction"] = {
        "cross_talk_std_deg": dict.fromkeys(("xy", "yx", "zx", "zy"), 0.3),
        "gyro_cross_talk_std_deg": dict.fromkeys(("xz", "yz"), 0.3),
        "zero_std_mps2": [0.1, 0.1, None],
    }
    logged = [
        {"at": 1.6e9 + k, "level": "notice", "text": f"suspect at {k}.0 s ({REASON})"}
        for k in range(30)
    ]
    events = events_of(status, logged)
    lines = drawn(lambda c: monitor_picture(status, events, c, Text("the foot")), width, height)
    assert len(lines) <= height
    assert lines[-1].strip() == "the foot"
    assert events[-1].clock in "\n".join(lines)


def test_what_happened_before_a_long_silence_keeps_its_time_of_day(status):
    status["duration_s"] = 110.0  # 100 s of frames, and the 10 s that stream time goes on
    status["silent_s"] = 3600.0
    status["details"] = {"shifts": [{"t": 40.0, "angle": "yaw", "size_deg": 5.0}]}
    (moved,) = events_of(status)
    assert moved.at == pytest.approx(1.6e9 - 3600.0 - 100.0 + 40.0)


def test_evidence_says_what_counts(status):
    """'0 right turns' next to 'weights: turns 17 %' reads as a contradiction."""
    status["details"] = {
        "launches_and_brakings": 0,
        "left_turns": 1,
        "right_turns": 0,
        "evidence_share": {"yaw": {"yaw_dvdt": 0.83, "yaw_turn": 0.17}},
    }
    text = " ".join(" ".join(drawn(picture(status), 80)).split())
    assert "evidence 0 launches and brakings above 1 m/s², 1 left turn above 0.8 m/s², " in text
    assert "0 right turns above 0.8 m/s²" in text
    assert "weights yaw: acceleration 83 %, turns 17 %" in text


def test_sensors_are_not_called_sound_while_none_sends(silent):
    late = silent | {"uptime_s": 60.0}
    line = next(x for x in drawn(picture(late), 100) if x.startswith("sensors"))
    assert "no accelerometer, no gyroscope" in line
    line = next(x for x in drawn(picture(silent), 100) if x.startswith("sensors"))
    assert "no samples received yet" in line


def test_what_is_not_learnt_from_is_a_row_where_there_is_something(status):
    def text() -> str:
        return "\n".join(drawn(lambda c: monitor_picture(status, [], c, Text("")), 120, 50))

    assert "not used" not in text()
    left_out = {"signal": "speed", "cause": "stuck", "seconds": 12.0}
    status["details"]["not_learnt_from"] = [left_out]
    assert "not used  12 s (speed stuck)" in text()


def test_inputs_say_what_is_wrong_with_them(status):
    text = "\n".join(drawn(lambda c: monitor_picture(status, [], c, Text("")), 120, 50))
    accel = next(line for line in text.splitlines() if line.startswith("accel"))
    speed = next(line for line in text.splitlines() if line.startswith("speed"))
    assert "100/s" in accel
    assert "stuck (y)" in accel
    assert "silent" in speed


def now(status) -> str:
    (line,) = (line for line in drawn(picture(status), 400) if line.lstrip().startswith("now"))
    return line.partition("now")[2].strip()


def test_nothing_wrong_is_said_only_where_neither_mount_nor_signals_are(status):
    assert now(status) == "nothing wrong"
    trouble = WORDS[StandingFault.ACCEL_LEVEL] + " (9.81 to 10.40 m/s^2)"
    suspect = status | {"state": "suspect", "waiting_for": dict.fromkeys(ANGLES, trouble)}
    assert now(suspect) == trouble
    suspect["health"] = suspect["health"] | {"accelerometer_faulty": True}
    assert now(suspect) == f"accelerometer faulty; {trouble}"
    unexplained = status | {"state": "suspect"}
    assert now(unexplained).startswith("the mount is suspect: the drive contradicts the mount")


def test_a_saved_mount_that_this_drive_contradicts_is_the_reason_and_one_event(status):
    wrong = {"t": 15.0, "turned_deg": 170.2}
    restored = {"phase": "doubted", "given": False, "doubt": "", "contradicted": wrong}
    suspect = status | {"state": "suspect", "details": {"restored": restored}}
    assert (
        now(suspect)
        == "the mount of an earlier drive does not fit this drive: it is off by 170 deg"
    )
    later = copy.deepcopy(suspect)
    later["details"]["restored"]["contradicted"]["turned_deg"] = 171.8
    faults = [e.text for e in events_of(later) if e.kind == "fault"]
    assert faults == [now(later)]
    assert "off by 172 deg" in faults[0]


def test_a_saved_mount_that_was_replaced_is_said_to_be_so(status):
    status["details"] = {"restored": {"phase": "new", "given": False, "turned_deg": None}}
    text = " ".join(" ".join(drawn(picture(status), 400)).split())
    assert "mount of an earlier drive: replaced by the mount of this drive" in text


def test_a_mount_that_was_usable_from_the_start_has_no_time(status):
    status["first_usable_s"] = 0.0
    text = "\n".join(drawn(headline(status), 120))
    assert "usable from the start" in text
    assert "after 0:00" not in text


def test_after_a_restart_status_says_why_the_mount_was_suspect(status):
    restored = {"phase": "doubted", "given": False, "doubt": "gravity is larger than before"}
    suspect = status | {"state": "suspect", "details": {"restored": restored}}
    said = "the mount was suspect when it was saved: gravity is larger than before"
    assert now(suspect) == said
    suspect["details"]["restored"]["phase"] = "confirmed"
    assert now(suspect | {"state": "usable"}) == "nothing wrong"


def test_a_daemon_that_has_just_begun_is_starting_and_a_silent_one_has_a_fault(silent):
    for state in ("waiting", "restored"):
        begun = silent | {"state": state, "uptime_s": 0.5}
        begun["link"] = silent["link"] | {"state": "up"}
        text = "\n".join(drawn(picture(begun), 80))
        assert "starting" in text
        assert "no accelerometer" not in text
        assert "no corrected frames yet" in text
        assert exit_status(begun) == 5
        later = begun | {"uptime_s": 2.5}
        text = "\n".join(drawn(picture(later), 80))
        assert "starting" not in text
        assert "no accelerometer" in text
        assert exit_status(later) == 7
    conflict = begun | {"health": begun["health"] | {"id_conflict": True}}
    assert exit_status(conflict) == 7
    assert "another node" in "\n".join(drawn(picture(conflict), 80))


def test_an_older_daemon_without_the_new_keys_is_shown(status):
    for key in ("sits", "steep", "mirrored", "target_std_deg", "angle_std_deg"):
        del status["mount"][key]
    text = "\n".join(drawn(picture(status), 80))
    assert "±0.70°" in text
    assert "below" not in text


def test_a_move_stands_between_the_lines_of_the_log_with_its_time_of_day(status):
    status["details"] = {"shifts": [{"t": 40.0, "angle": "yaw", "size_deg": 5.0}]}
    logged = [
        {"at": 1.6e9 - age, "level": "notice", "text": f"{age:g} s ago"} for age in (90.0, 1.0)
    ]
    before, moved, after = events_of(status, logged)
    assert (before.text, after.text) == ("90 s ago", "1 s ago")
    assert moved.kind == "moved"
    assert moved.at == 1.6e9 - status["duration_s"] + 40.0
    assert moved.clock == time.strftime("%H:%M:%S", time.localtime(moved.at))


def test_a_sensor_that_was_found_where_it_was_is_not_said_to_be_moved(status):
    shift = {"t": 40.0, "angle": "yaw", "size_deg": 5.0, "turn_deg": [0.0, 0.0, -0.1]}
    status["details"] = {"shifts": [shift | {"within_deg": 1.2}]}
    (found,) = events_of(status)
    assert found.kind == "evidence"
    assert found.text == "the mount was determined again and is the same, within ±1.2 deg"


def test_two_faults_of_one_moment_are_both_listed(status):
    both = copy.deepcopy(status)
    names = [StandingFault.ORIENTATION, StandingFault.FORWARD]
    both["details"] = {"faults": [{"t": 40.0, "fault": name.value} for name in names]}
    listed = [e.text for e in events_of(both) if e.kind == "fault"]
    assert listed == [WORDS[name] for name in names]


def test_a_mount_that_nothing_has_confirmed_is_not_called_usable(status):
    stated = copy.deepcopy(status) | {"state": "restored", "quality": 1}
    for one, is_stated in ((stated, False), (status, True)):
        text = "\n".join(drawn(picture(one), 140))
        assert ("usable after" in text) == is_stated


# the page --------------------------------------------------------------------------------------


def history(count: int) -> dict[str, Any]:
    """So many rows of a daemon's history."""
    numbers = [14.4, 28.6, -10.6, 1.1, 0.6, 0.9, 1.0, 2.0, 9.0, 0.1, 0.2, 9.8, 0.1, 0.2]
    rows = [[1.6e9 + 2.0 * i, "usable", "good", *numbers] for i in range(count)]
    return {"period_s": 2.0, "columns": list(COLUMNS), "rows": rows}


def asked(status, *requests):
    """Status, headers and text of the answers to (method, path, host)."""
    pytest.importorskip("aiohttp")
    from aiohttp.test_utils import TestClient, TestServer

    from imucald.commands.monitor_web import LiveState, application

    state = LiveState("a note")
    for second in range(5):
        state.update(status, 1.6e9 + second)
    state.add_history(history(5))

    async def ask():
        found = []
        async with TestClient(TestServer(application(state))) as client:
            for method, path, host in requests:
                headers = {"Host": host} if host else {}
                answer = await client.request(method, path, headers=headers)
                found.append((answer.status, answer.headers, await answer.text()))
        return found

    return asyncio.run(ask())


def test_the_page_shows_what_the_terminal_does(status):
    (page, _, text), (script, _, js), (live, headers, data) = asked(
        status, ("GET", "/", None), ("GET", "/monitor.js", None), ("GET", "/live", None)
    )
    assert (page, script, live) == (200, 200, 200)
    assert "http" not in text
    assert "http" not in js
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    found = json.loads(data)
    yaw = found["mount"][2]
    assert (yaw["left"], yaw["target"]) == ("±0.70°", "fine below ±0.60°")
    assert found["sits"] == status["mount"]["sits"]
    assert [i["health"] for i in found["inputs"]] == ["stuck (y)", "silent"]
    assert len(found["views"]) == 3
    assert (found["now"], found["reached"]) == ("", ["usable after 1:16"])
    assert found["frames"]["late"] == status["link"].get("late", 0)
    assert [row[0] for row in found["history"]["rows"]] == [1.6e9 + 2.0 * i for i in range(5)]
    assert found["history"]["columns"] == list(COLUMNS)


@pytest.mark.parametrize(
    ("method", "path", "host", "code"),
    [
        ("POST", "/live", None, 405),
        ("DELETE", "/", None, 405),
        ("GET", "/etc/passwd", None, 404),
        ("GET", "/../pyproject.toml", None, 404),
        ("GET", "/live", "attacker.example", 403),
        ("GET", "/live", "127.0.0.1.attacker.example:80", 403),
    ],
)
def test_nothing_else_is_served_and_nobody_else_may_ask(status, method, path, host, code):
    ((found, _, text),) = asked(status, (method, path, host))
    assert found == code
    assert "mount" not in text


def test_no_empty_car_is_drawn_before_the_forward_direction_is_known(status):
    status["mount"]["std_deg"]["z"] = 90.0
    ((_, _, data),) = asked(status, ("GET", "/live", None))
    assert json.loads(data)["views"] == []


def test_half_open_requests_are_few_and_keep_nobody_out(status, monkeypatch):
    web = pytest.importorskip("aiohttp.web")
    from aiohttp import ClientSession

    from imucald.commands import monitor_web

    monkeypatch.setattr(monitor_web, "ASK_S", 0.5)
    state = monitor_web.LiveState()
    state.update(status, 1.6e9)

    async def attacked() -> tuple[int, int, int]:
        bounded = monitor_web.Connections()
        runner = web.AppRunner(monitor_web.application(state, bounded))
        await runner.setup()
        bounded.bound(runner.server)
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        port = runner.addresses[0][1]
        writers = []
        for _ in range(100):
            _, writer = await asyncio.open_connection("127.0.0.1", port)
            writer.write(b"GET /live HTTP/1.1\r\nHost: 127.0.0.1\r\n")
            writers.append(writer)
        await asyncio.sleep(0.1)
        most = len(runner.server.connections)
        async with ClientSession() as session:
            answer = await session.get(f"http://127.0.0.1:{port}/live")
            code = answer.status
            await asyncio.sleep(0.7)
            left = len(runner.server.connections)
            again = await session.get(f"http://127.0.0.1:{port}/live")  # on the same connection
            assert again.status == code
        for writer in writers:
            writer.close()
        await runner.cleanup()
        return most, code, left

    most, code, left = asyncio.run(attacked())
    assert most <= monitor_web.CONNECTIONS_MAX
    assert code == 200
    assert left == 1


def test_the_page_gets_only_rows_that_it_has_not_and_no_more_than_half_an_hour(status):
    from imucald.commands.monitor_web import LiveState

    state = LiveState()
    state.update(status, 1.6e9)
    state.add_history(history(950))
    assert len(state.page()["history"]["rows"]) == 900
    assert state.newest == 1.6e9 + 1898.0
    assert [row[0] for row in state.page(1.6e9 + 1895.0)["history"]["rows"]] == [
        1.6e9 + 1896.0,
        1.6e9 + 1898.0,
    ]


def test_no_gate_of_the_page_is_green_or_has_a_time_while_nothing_flows(status):
    from imucald.commands.monitor_web import LiveState

    state = LiveState()
    status["progress"] = PROGRESS

    def shown() -> tuple[bool, list[str]]:
        page = state.page()
        assert bool(page["reasons"]) != page["stale"]
        return page["stale"], [gate["left"] for gate in page["progress"]["gates"]]

    state.update(status, 1.6e9)
    assert shown() == (False, ["", "about 3 min of driving", ""])
    state.fail(LinkError("no socket"))
    assert shown() == (True, [""] * 3)
    state.update(without_input(status), 1.6e9)
    assert shown() == (True, [""] * 3)


def test_a_daemon_that_went_away_is_reported(status):
    from imucald.commands.monitor_web import LiveState

    state = LiveState()
    assert state.page() == {"trouble": "no answer yet"}
    state.update(status, 1.6e9)
    state.fail(LinkError("no socket"))
    assert state.page()["trouble"].startswith("the daemon has ended; its last answer was at ")
    assert state.page()["state"] == "usable"


def test_the_page_says_how_to_reach_it_from_another_machine(capsys, tmp_path: Path):
    pytest.importorskip("aiohttp")
    from imucald.commands.monitor_web import serve

    serve(tmp_path / "socket", 0, lambda: True, "")
    address, tunnel = capsys.readouterr().out.splitlines()
    port = address.split()[0].rpartition(":")[2]
    assert f"ssh -L {port}:127.0.0.1:{port} {socket.gethostname()}" in tunnel


@pytest.mark.slow
def test_a_real_browser_draws_the_page(status, tmp_path: Path):
    """Chromium runs the script under the page's own policy, and finds mount, chart and drawing."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser")
    if browser is None:
        pytest.skip("no chromium here")
    pytest.importorskip("aiohttp")
    from aiohttp import web

    from imucald.commands.monitor_web import LiveState, application

    state = LiveState()
    for second in range(20):
        state.update(status, 1.6e9 + second)
    state.add_history(history(20))
    ready, ports, loop = threading.Event(), [], asyncio.new_event_loop()

    async def begin():
        runner = web.AppRunner(application(state))
        await runner.setup()
        await web.TCPSite(runner, "127.0.0.1", 0).start()
        ports.append(runner.addresses[0][1])
        ready.set()

    def serve():
        asyncio.set_event_loop(loop)
        loop.create_task(begin())
        loop.run_forever()

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    assert ready.wait(10.0)
    command = [browser, "--headless", "--no-sandbox", "--disable-gpu",
               f"--user-data-dir={tmp_path}", "--virtual-time-budget=3000", "--dump-dom",
               f"http://127.0.0.1:{ports[0]}/"]  # fmt: skip
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    finally:
        loop.call_soon_threadsafe(loop.stop)
        thread.join(5.0)
    assert (
        'id="flow" role="status" class="good">corrected frames flow, marked usable<' in done.stdout
    )
    assert '<b id="state">usable</b>' in done.stdout
    assert '<p id="angles"><span class="whole">roll +14.40° ±1.1' in done.stdout
    assert status["mount"]["sits"] in done.stdout
    assert "fine below ±0.60°" in done.stdout
    assert done.stdout.count('class="sits"') == 3
    assert done.stdout.count('class="band"') == 3
    assert done.stdout.count('class="line raw"') == 3
