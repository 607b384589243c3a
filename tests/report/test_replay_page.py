"""The page about a replayed drive: whole, offline, and true to what was sent."""

from __future__ import annotations

import json
import math
import re

import cantools.database
import numpy as np
import pytest

from html_page import Page
from imucald import cli
from imucald.can.logs.log_reader import LogReader
from imucald.report.drive_history import DriveHistory
from imucald.runtime.drive_events import in_order, reported_events, state_changes
from imucald.runtime.replay import Replay
from imucald.runtime.session import make_engine
from imucald.simulation import random_model, simulate
from imucald.traffic.can_log import EPOCH_S, write_log
from imucald.traffic.drive_encoder import BusEncoder
from paths import ROOT
from simulated_bus import CONFIG, loaded

SHIFT_S, SHIFT_DEG = 240.0, 10.0


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    """A drive whose sensor is turned on the way, and its log."""
    shift = {"t_s": SHIFT_S, "roll_deg": 0.0, "pitch_deg": SHIFT_DEG, "yaw_deg": 0.0}
    model = random_model(3, standing_first=True).with_changes({"mount.shifts": [shift]})
    drive = simulate(model, 3, 8.0)
    log = tmp_path_factory.mktemp("page") / "drive.log"
    write_log(drive, log, BusEncoder(loaded()))
    return drive, log


@pytest.fixture(scope="module")
def page(moved, tmp_path_factory):
    """The page's text, and the result beside it."""
    folder = tmp_path_factory.mktemp("report")
    result = folder / "result.json"
    arguments = ["replay", "--config", str(CONFIG), str(moved[1]), "--json", str(result)]
    assert cli.main([*arguments, "--quiet", "--report", str(folder / "drive")]) == 0
    assert cli.main([*arguments[:-1], str(folder / "plain.json"), "--quiet"]) == 0
    assert (folder / "plain.json").read_text() == result.read_text()
    return (folder / "drive" / "index.html").read_text(), json.loads(result.read_text())


@pytest.mark.slow
def test_the_page_is_whole_and_needs_no_network(page):
    text, _ = page
    assert "http" not in text
    assert "<script" not in text
    for attribute in ("src=", "@import", "url(http"):
        assert attribute not in text
    parsed = Page(text)
    assert sum(tag == "svg" for tag, _ in parsed.tags) >= 11
    assert len(text) < 2_000_000
    undefined = set(re.findall(r"var\((--[\w-]+)\)", text)) - set(re.findall(r"(--[\w-]+):", text))
    assert not undefined


@pytest.mark.slow
def test_the_angles_by_time_can_be_read_off_their_axes(page):
    text, result = page
    (picture,) = (svg for svg in Page(text).pictures if "roll [deg]" in svg)
    words = [word.strip() for word in Page(picture).texts if word.strip()]
    for name in ("roll", "pitch", "yaw"):
        label = words.index(f"{name} [deg]")
        texts = (word.replace("\N{MINUS SIGN}", "-") for word in words[label - 5 : label])
        ticks = [float(text) for text in texts if re.fullmatch(r"-?[.\d]+", text)]
        assert min(ticks) <= result["mount"][f"{name}_deg"] <= max(ticks), ticks


@pytest.mark.slow
def test_the_page_names_what_was_not_learnt_from(moved, tmp_path):
    lines = moved[1].read_text("utf-8").splitlines(keepends=True)
    times = [float(line[1 : line.index(")")]) for line in lines]
    log = tmp_path / "drive.log"
    within = [
        100.0 < t - times[0] < 130.0 and " 1A0#" in line
        for t, line in zip(times, lines, strict=True)
    ]
    assert sum(within) > 100
    log.write_text(
        "".join(line for line, cut in zip(lines, within, strict=True) if not cut), "utf-8"
    )
    arguments = ["replay", "--config", str(CONFIG), str(log), "--quiet", "--report"]
    assert cli.main([*arguments, str(tmp_path / "page")]) == 0
    text = (tmp_path / "page" / "index.html").read_text("utf-8")
    assert re.search(r"Not used for the mount: (2\d|3\d) s \(no valid speed sample\)", text)


@pytest.mark.slow
def test_the_page_says_how_the_sensor_sits_and_what_happened(page):
    text, result = page
    words = " ".join(Page(text).texts)
    assert result["mount"]["sits"] in words
    moved = re.search(
        r"the sensor was found moved: by ([+-][0-9.]+) deg about the left axis", words
    )
    assert moved
    assert float(moved[1]) == pytest.approx(SHIFT_DEG, abs=1.0)
    verdict = text.partition('<section class="verdict')[2].partition("</section>")[0]
    assert moved[0] in verdict, "a sensor that moved is said before any table"
    for state in ("levelled", "usable", "suspect", "recalibrating"):
        assert re.search(rf"\b{state}: ", words), state
    for axis, angle in zip("xyz", ("roll", "pitch", "yaw"), strict=True):
        assert f"{result['mount'][f'{angle}_deg']:+.2f}°" in words
        assert f"±{2 * result['mount']['judged_std_deg'][axis]:.2f}°" in words
        assert f"±{2 * result['mount']['angle_std_deg'][angle]:.2f}°" in words


@pytest.mark.slow
def test_the_corrected_force_is_what_a_control_unit_would_have_decoded(moved, tmp_path):
    drive, log = moved
    config = loaded()
    history = DriveHistory()
    engine = make_engine(config, on_samples=history.samples)
    reader = LogReader([log], engine.router.matches)
    sent = []

    def sink(frames):
        rows = frames.can_id == 0x640
        sent.extend(zip(frames.t[rows], frames.data[rows].tolist(), strict=True))

    Replay(engine, reader, sink).run()
    motion = history.motion()
    message = cantools.database.load_file(ROOT / "dbc" / "imucald_out.dbc")
    layout = message.get_message_by_frame_id(0x640)
    checked = 0
    for i in range(100, len(motion.t), 500):
        first, last = motion.t[i] - 0.25, motion.t[i] + 0.25
        rows = [d for t, d in sent if first <= round(t - sent[0][0], 6) < last]
        values = [layout.decode(bytes(d), decode_choices=False) for d in rows]
        if not values or any(v["AccelX"] < -65.0 for v in values):
            continue
        mean = np.mean([v["AccelX"] for v in values])
        assert motion.corrected[i, 0] == pytest.approx(mean, abs=0.05)
        checked += 1
    assert checked >= 3
    truth = drive.truth
    known = np.isfinite(motion.dvdt)
    real = np.interp(motion.t[known], truth.t, truth.acceleration)
    assert np.sqrt(np.mean((motion.dvdt[known] - real) ** 2)) < 0.25
    assert np.corrcoef(motion.dvdt[known], real)[0, 1] > 0.95


def test_changes_of_state_and_what_is_reported_come_in_order():
    states = [(1.0, "waiting", {}), (2.0, "waiting", {}), (7.0, "usable", {"yaw": "more driving"})]
    result = {
        "details": {
            "shifts": [{"t": 5.0, "angle": "pitch", "size_deg": -3.2}],
            "faults": [{"t": 3.0, "fault": "speed_unit"}],
        },
        "signal_health": {
            "events": [{"sensor": "gyro", "fault": "stuck", "axes": "y", "since_s": 4.0,
                        "until_s": 6.5}]
        },
    }  # fmt: skip
    events = in_order([*state_changes(states), *reported_events(result, [6.0])])
    assert [e.kind for e in events] == ["state", "fault", "sensor", "moved", "gap", "state"]
    texts = [e.text for e in events]
    assert texts[1] == "the speed's unit is wrong"
    assert texts[2] == "gyro stuck (y), for 2 s"
    assert texts[3] == "the sensor was found moved: the drive shows -3.2 deg about the left axis"
    assert texts[-1].endswith("waiting for yaw: more driving")


def test_a_reason_that_stands_is_listed_and_one_that_only_counts_on_or_passes_is_not():
    reasons = ["a standstill"] * 20 + ["turns (1 seen)"] * 5 + ["bends"] * 20 + ["bends"] * 20
    states = [
        (float(t), "levelled", {"roll": f"{reason} ({t} left)"}) for t, reason in enumerate(reasons)
    ]
    events = [(e.t, e.kind, e.text) for e in state_changes(states)]
    assert [(t, kind) for t, kind, _ in events] == [(0.0, "state"), (25.0, "reason")]
    assert events[1][2] == "waiting for roll: bends (25 left)"


def test_a_log_without_a_usable_drive_has_a_page_too(tmp_path):
    log = tmp_path / "short.log"
    log.write_text(f"({EPOCH_S:.6f}) can0 200#0000000000000000\n(broken\n")
    folder = tmp_path / "report"
    cli.main(["replay", "--config", str(CONFIG), str(log), "--quiet", "--report", str(folder)])
    words = " ".join(Page((folder / "index.html").read_text()).texts)
    assert "Nothing is known yet" in words
    assert "never usable" in words
    assert "Waiting for roll, pitch, yaw: the first 6 s of samples." in words
    assert not math.isnan(len(words))


@pytest.mark.slow
def test_several_drives_have_a_page_each_in_a_folder_of_their_own(moved, tmp_path):
    lines = moved[1].read_text().splitlines(keepends=True)
    logs = [tmp_path / "mon.log", tmp_path / "tue.log"]
    for log, first in zip(logs, (0, len(lines) // 2), strict=True):
        log.write_text("".join(lines[first : first + 20_000]))
    folder = tmp_path / "pages"
    arguments = ["replay", "--config", str(CONFIG), *map(str, logs), "--report", str(folder)]
    assert cli.main([*arguments, "--quiet"]) == 0
    assert sorted(file.parent.name for file in folder.glob("*/index.html")) == ["mon", "tue"]
    index = (folder / "index.html").read_text()
    assert [index.count(f'href="{log.stem}/index.html"') for log in logs] == [1, 1]
    for log in logs:
        page = Page((folder / log.stem / "index.html").read_text())
        assert any(log.name in text for text in page.texts)


def test_a_place_that_cannot_be_written_is_reported_before_the_work(tmp_path, capsys):
    taken = tmp_path / "taken"
    taken.write_text("")
    log = tmp_path / "a.log"
    log.write_text(f"({EPOCH_S:.6f}) can0 200#00\n")
    for place in (taken, tmp_path / "no" / "where"):
        arguments = ["replay", "--config", str(CONFIG), str(log), "--report", str(place)]
        assert cli.main(arguments) == 1
        assert str(place) in capsys.readouterr().err
