"""The page of a diagnosis: whole, self-contained, safe, and small whatever the drive."""

from __future__ import annotations

import importlib.util
import math
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import cache
from math import radians
from types import SimpleNamespace

import made_diagnosis as made
import numpy as np
import pytest

from html_page import NAME_SPACES, Page
from imucald.core.errors import ImucaldError
from imucald.diagnosis.fit.score import Problem
from imucald.diagnosis.gain import gain_of
from imucald.diagnosis.result import Candidate, Estimated, Gain, Kind, SignalGain, Structure
from imucald.report import numbers, titles
from imucald.report import wording as words
from imucald.report.decimation import clearest_segment, envelope, log_bins, trend
from imucald.report.model_changes import as_diff, model_changes, shown_changes, value_text
from imucald.report.page import About, report_page, require_libraries

ABOUT = About(["a.log", "b.log"], "car.yaml", "car_model.yaml", "2026-01-02 03:04, imucald 9")
SVG = "{http://www.w3.org/2000/svg}"


def page(diagnosis) -> Page:
    return Page(report_page(diagnosis, ABOUT))


@cache
def whole(verdict: str) -> str:
    """The page of a diagnosis with this verdict."""
    return report_page(made.ALL[verdict](), ABOUT)


@pytest.fixture(scope="module")
def found() -> Page:
    return Page(whole("found"))


@pytest.mark.slow
def test_causes_come_with_values_intervals_and_evidence(found):
    text = found.text
    assert (
        "Found: body roll (9.62 instead of 4.50 deg/g) and accelerometer bias (left: 25.2 mg)"
        in text
    )
    assert "Two causes are certain." in text
    assert "Body roll in bends differs from the model file's." in text
    assert "0.01712 ± 0.00062 rad/(m/s²)" in text
    assert "9.62 ± 0.35 deg/g" in text  # 0.01712 rad/(m/s^2) * 57.296 * 9.80665
    assert "4.50 deg/g" in text, "what the file said"
    assert "25.2 ± 2.2 mg" in text
    assert "21 σ beyond the tolerance" in text
    assert "What speaks against it it predicts worse in 40 % of the segments" in text
    assert "a.log, b.log (30 min)" in text
    assert "no temperature signal" in text


def test_gain_signals_and_what_was_not_named_are_there(found):
    text = found.text
    assert "673 nats likelier (95 % interval 590 to 755)" in text
    assert (
        "accelerometer left found m/s² 0.312 0.101 0.0940 -68 % 0.300 → 0.0800 offset +0.13" in text
    )
    assert "Use the extended model file (--write-model FILE): it predicts better" in text
    outcomes = ["accelerometer scale not decidable here", "gyroscope scale within tolerance"]
    places = [text.index(one) for one in outcomes]
    assert places == sorted(places), "what pays most comes first"


@pytest.mark.slow
def test_a_file_that_makes_anything_worse_is_not_recommended():
    worse = made.found(gain=Gain(673.0, (590.0, 755.0), ("gyro_x",)), recommended=False)
    text = page(worse).text
    assert (
        "Next: Do not use the extended model file (--write-model FILE): it predicts gyroscope "
        "forward worse. The causes are certain, but a written value that this signal shows is wrong"
        in text
    )


@pytest.mark.slow
def test_what_is_likely_stands_apart():
    text = page(
        made.found(causes=(made.BIAS,), likely=(replace(made.ROLL, certainty="likely"),))
    ).text
    assert "Likely, but not written into the file: body roll." in text
    assert text.index("Certain") < text.index("Likely causes pass a weaker test")


def test_the_extended_model_is_shown_as_a_diff_and_in_full(found):
    text = found.text
    assert "- roll_gradient: 0.008" in text
    assert "+ roll_gradient: 0.0171235" in text
    assert "+ bias: [0, 0.2471, 0]" in text
    assert "roll_gradient: 0.01712345678" in text, "the whole file, folded"


def test_ambiguous_says_what_it_may_be_and_how_to_tell():
    text = Page(whole("ambiguous")).text
    assert (
        "Ambiguous: accelerometer bias (left: 25.2 mg), accelerometer cross-axis or mount rotation"
        in text
    )
    for way in ("curves both ways and stops facing both ways", "straight braking and slow"):
        assert way in text
    assert "What it may be" in text
    tags = re.findall(r'<span class="tag (\w+)">(\w+)</span>', whole("ambiguous"))
    assert tags == [("ambiguous", "ambiguous")] * 3, "none of them is certain, each has a card"
    assert ("certain", "certain") in re.findall(
        r'<span class="tag (\w+)">(\w+)</span>', whole("found")
    )


def test_the_file_of_an_ambiguous_verdict_is_for_prediction_only():
    two = ("accel_bias", "mount_rotation")
    d = replace(made.ambiguous(), look_alikes=(two,), model_after=made.AFTER)
    why = "one of two causes that fit equally well"
    text = page(d).text
    assert f"for prediction only: it contains {why}" in words.verdict(d).next
    assert words.advice(d) == ("use it for prediction only", f"it contains {why}")
    assert words.verdict(d).next.startswith("Record another drive (curves both ways")
    assert "nothing that was looked for" not in text
    assert "mount rotation fits as well" in text
    assert "Largest reduction of a residual, on data not used for the fit by 68 %" in text


def test_one_way_to_separate_two_causes_stands_once():
    assert len(words.ways_apart(("wheels_against_speed", "wheel_speed_scale"))) == 1


def test_unknown_says_where_the_structure_lives():
    text = Page(whole("unknown")).text
    assert "the model does not explain accelerometer left and vehicle yaw rate" in text
    assert "spectral peak at 0.62 Hz, while cornering" in text
    assert "there is no gain" not in Page(whole("found")).text
    assert "there is no gain" in text
    assert "Residual reduced" not in text, "nothing was fitted"


def test_nothing_found_claims_nothing():
    text = Page(whole("nothing")).text
    assert "Nothing found in " in text
    assert "Certain" not in text
    assert "Nothing in the model file changes." in text


def test_a_likely_cause_alone_is_the_headline_and_not_green():
    diagnosis = replace(made.nothing(), likely=(replace(made.ROLL, certainty="likely"),))
    text = words.verdict(diagnosis)
    assert text.headline == "Likely: body roll (9.62 instead of 4.50 deg/g)"
    assert text.next.startswith("Record a longer drive (a slalom on a flat road)")
    assert "Nothing is certain." in text.explanation
    assert "fits" not in text.explanation
    assert 'class="verdict likely"' in report_page(diagnosis, ABOUT)


def test_every_signal_has_four_pictures_that_are_valid_svg(found):
    assert len(found.pictures) == 4 * 3
    for svg in found.pictures:
        root = ET.fromstring(svg)
        assert root.tag == f"{SVG}svg"
        assert len(list(root.iter(f"{SVG}path"))) > 10
        assert "nan" not in "".join(p.get("d", "") for p in root.iter(f"{SVG}path")).lower()


@pytest.mark.parametrize("verdict", list(made.ALL))
def test_the_contents_list_leads_to_every_section(verdict):
    tags = Page(whole(verdict)).tags
    headings = [attrs["id"] for tag, attrs in tags if tag == "h2"]
    assert len(headings) >= 5
    assert [attrs["href"] for tag, attrs in tags if tag == "a"] == [f"#{h}" for h in headings]


def test_values_with_units_stand_under_the_mouse(found):
    for svg in found.pictures:
        shown = [e.text.split("\n") for e in ET.fromstring(svg).iter(f"{SVG}title")]
        assert len(shown) >= 15
        assert all(len(lines) >= 2 for lines in shown)
        assert all("m/s²" in line or "rad/s" in line for lines in shown for line in lines[1:])
    bars = [attrs.get("title") for tag, attrs in found.tags if tag == "i" and attrs.get("title")]
    assert "before 0.312 m/s²" in bars
    assert "after 0.101 m/s²" in bars


def test_the_pictures_draw_the_residual_before_and_after():
    """The line of means against the driver lies where the made-up truth puts it."""
    from imucald.report.plots import AFTER, BEFORE, driver_picture

    svg = driver_picture(made.picture(size=0.15))
    root = ET.fromstring(svg.replace("<svg", f"<svg {NAME_SPACES}", 1))
    heights = {}
    for path in root.iter(f"{SVG}path"):
        style = path.get("style", "").lower()
        for colour in (BEFORE, AFTER):
            if f"stroke: {colour.lower()}" in style and "fill: none" in style:
                points = re.findall(r"([\d.]+) ([\d.]+)", path.get("d"))
                if len(points) > 10:
                    heights[colour] = [float(y) for _, y in points]
    assert heights[BEFORE] == sorted(heights[BEFORE], reverse=True), "it rises with the driver"
    assert np.ptp(heights[AFTER]) < 0.1 * np.ptp(heights[BEFORE])


def test_one_curve_is_drawn_where_nothing_was_extended():
    from imucald.report.plots import BEFORE

    assert all(BEFORE.lower() in svg.lower() for svg in Page(whole("found")).pictures)
    assert not any(BEFORE.lower() in svg.lower() for svg in Page(whole("unknown")).pictures)
    assert "The segment with the largest residual" in Page(whole("unknown")).text


@pytest.mark.parametrize("verdict", list(made.ALL))
def test_nothing_is_fetched_from_anywhere(verdict):
    text = whole(verdict)
    parsed = Page(text)
    assert not {tag for tag, _ in parsed.tags} & {"script", "link", "iframe", "object", "base"}
    for _, attrs in parsed.tags:
        for name, value in attrs.items():
            if name in ("src", "href", "srcset", "action", "data", "poster"):
                assert value.startswith("#")
    style = re.search(r"<style>(.*?)</style>", text, re.S)[1]
    assert not re.search(r"url\(|@import", style)
    for svg in parsed.pictures:
        addresses = re.findall(r'(?:href|src)="([^"]*)"', svg)
        assert all(address.startswith("#") for address in addresses)


HOSTILE = "<script>alert('x')</script>\"'&{{7*7}}${\\bad}$"


def test_hostile_names_are_text_and_nothing_else():
    strange = made.picture(signal=HOSTILE, seconds=60.0)
    strange = replace(strange, driver_name=HOSTILE, unit=HOSTILE)
    cause = replace(
        made.ROLL, name=HOSTILE, text=HOSTILE, signals=(HOSTILE,),
        parameters={HOSTILE: Estimated(1.0, 0.1, HOSTILE)}, evidence={HOSTILE: 1.0},
        against=(HOSTILE,),
    )  # fmt: skip
    diagnosis = made.found(
        causes=(cause,),
        look_alikes=((HOSTILE, HOSTILE),),
        to_separate=HOSTILE,
        signals={HOSTILE: SignalGain(1.0, 0.5, 0.4, HOSTILE)},
        candidates=(Candidate(HOSTILE, "does not pay", -1.0, HOSTILE),),
        structure=(Structure(HOSTILE, HOSTILE, 1.0, HOSTILE),),
        notes=(HOSTILE,),
        pictures=(strange,),
    )
    text = report_page(diagnosis, About([HOSTILE], HOSTILE, HOSTILE, HOSTILE))
    parsed = Page(text)
    assert "script" not in {tag for tag, _ in parsed.tags}
    assert "<script" not in text.lower()
    assert parsed.text.count("alert('x')") >= 12
    assert "{{7*7}}" in parsed.text
    for svg in parsed.pictures:
        assert "script" not in {e.tag.removeprefix(SVG) for e in ET.fromstring(svg).iter()}


@pytest.mark.slow
def test_a_long_drive_with_thousands_of_rows_makes_a_page_for_a_mail():
    names = [f"accel_{i}" for i in range(40)]
    picture = made.picture(seconds=6 * 3600.0)
    diagnosis = made.found(
        pictures=tuple(replace(picture, signal=name) for name in names[:18]),
        signals={name: SignalGain(2.0, 1.0, 1.0, "m/s^2") for name in names},
        candidates=tuple(Candidate(f"cause_{i}", "does not pay", -float(i), "no better")
                         for i in range(5000)),
        structure=tuple(Structure("accel_1", "bursts", float(i), "here") for i in range(3000)),
        notes=tuple(f"note {i}" for i in range(3000)),
    )  # fmt: skip
    text = report_page(diagnosis, ABOUT)
    assert len(text) < 3_000_000
    parsed = Page(text)
    assert "4 more signals have no pictures here" in parsed.text
    assert "2800 more notes" in parsed.text


def test_numbers_that_are_none_do_not_break_the_page():
    short = made.picture(seconds=3.0)
    empty = replace(
        short, signal="gyro_x", t=np.zeros(0), measured=np.zeros(0), predicted_before=np.zeros(0),
        predicted_after=np.zeros(0), driver=np.zeros(0), frequency=np.zeros(0),
        spectrum_before=np.zeros(0), spectrum_after=np.zeros(0),
    )  # fmt: skip
    lost = np.full_like(short.t, np.nan)
    absent = replace(short, signal="gyro_y", measured=lost, driver=lost)
    still = replace(short, signal="gyro_z", driver=np.zeros_like(lost))
    cause = replace(made.ROLL, parameters={"a": Estimated(math.nan, math.inf, "1")},
                    evidence={"sigma": math.nan})  # fmt: skip
    parsed = page(made.found(
        causes=(cause,),
        gain=Gain(math.nan, (-math.inf, math.inf)),
        signals={"accel_x": SignalGain(math.nan, 0.0, 0.0, "m/s^2")},
        candidates=(Candidate("x", "does not pay", -math.inf, ""),),
        pictures=(empty, absent, still),
    ))  # fmt: skip
    assert len(parsed.pictures) == 12
    assert "not known" in parsed.text
    assert not re.search(r"\bnan\b|\binf\b", parsed.text)


def test_the_same_diagnosis_gives_the_same_page():
    assert report_page(made.nothing(), ABOUT) == whole("nothing")


@pytest.mark.parametrize("name", ["jinja2", "matplotlib"])
def test_a_missing_library_is_an_error_with_the_remedy(monkeypatch, name):
    known = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda n, *more: None if n == name else known(n, *more)
    )
    with pytest.raises(ImucaldError, match=rf"needs {name}: .*pip install '\.\[report\]'"):
        require_libraries()


def test_words_need_neither_library():
    """The terminal speaks with the same words where the extra is not installed."""
    code = (
        "import sys; sys.modules['jinja2'] = sys.modules['matplotlib'] = None;"
        "import imucald.commands.diagnose_view, imucald.report.model_changes as changes;"
        "from imucald.commands.diagnose_view import titles;"
        "print(titles.cause_title('dropouts'), changes.value_text([1.5, None]))"
    )
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False
    )
    assert (process.stderr, process.stdout) == ("", "drop-outs [1.5, null]\n")


# words ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(("value", "std", "text"), [
    (0.0171234, 0.00031, "0.01712 ± 0.00062"),
    (-3.0, 0.5, "-3.0 ± 1.0"),
    (1234.5, 120.0, "1234 ± 240"),
    (0.5, 0.0, "0.5000"),
    (1e-9, 3e-9, "1.00e-09 ± 6.0e-09"),
    (math.nan, 1.0, "-"),
])  # fmt: skip
def test_values_are_rounded_by_their_deviation(value, std, text):
    assert numbers.with_spread(value, std) == text


@pytest.mark.parametrize(("key", "text"), [
    ("mount.lever_arm_m.0", "lever arm, forward"),
    ("accel.bias.y", "accelerometer zero error, left"),
    ("mount.turn.z", "turn, yaw"),
    ("gyro.scale.1", "gyroscope gain error, sensor y"),
    ("accel.cross_axis.1", "accelerometer cross axis, z in x"),
    ("speed.delay_s", "speed delay"),
    ("chassis.steering_ratio", "steering ratio"),
    ("_speed.doubled", "speed doubled"),
])  # fmt: skip
def test_parameters_have_names_that_people_use(key, text):
    assert titles.key_title(key) == text


@pytest.mark.parametrize(("key", "p", "text"), [
    ("gyro.bias.z", Estimated(radians(0.5), radians(0.02), "rad/s"), "0.500 ± 0.040 deg/s"),
    ("chassis.steering_ratio", Estimated(16.42, 0.31, "1"), "16.42 ± 0.62"),
    ("speed.scale", Estimated(0.031, 0.004, "1"), "3.10 ± 0.80 %"),
    ("speed.delay_rate", Estimated(1.74e-4, 9e-6, "1"), "174 ± 18 ppm"),
    ("mount.lever_arm_m.0", Estimated(1.5, 0.1, "m"), "1.50 ± 0.20 m"),
])  # fmt: skip
def test_values_are_in_units_that_people_use(key, p, text):
    assert numbers.for_people(key, p)[0] == text


def test_a_cause_that_nobody_has_named_yet_has_a_title():
    assert titles.cause_title("trailer_sway") == "trailer sway"
    assert titles.signal_title("accel_z") == "accelerometer up"
    assert titles.signal_title("brake_torque") == "brake torque"


def test_a_sure_cause_beside_an_ambiguous_one_is_reported():
    found = made.found(verdict="ambiguous", look_alikes=(("accel_bias", "accel_cross_axis"),))
    both = words.verdict(found)
    assert both.headline == (
        "Ambiguous: accelerometer bias (left: 25.2 mg) or accelerometer cross-axis"
    )
    assert "Certain in any case: body roll" in both.explanation
    text = page(found).text
    assert text.index("Certain body roll") < text.index("What it may be accelerometer bias")


def test_what_explains_the_numbers_and_cannot_be_has_its_signs_as_printed():
    left = Structure(
        "accel_x", Kind.NOT_PLAUSIBLE, 4.0, "accel scale off by 0.17 +- 0.03 explains it"
    )
    said = words.verdict(replace(made.nothing(), verdict="unknown", structure=(left,)))
    assert said.explanation.startswith("Accel scale off by 0.17 ± 0.03 explains it.")


def test_structure_beside_what_was_found_is_reported():
    said = words.verdict(made.found(structure=made.unknown().structure)).explanation
    assert (
        "No known cause explains the remaining differences in accelerometer left and "
        "vehicle yaw rate" in said
    )


def test_a_wrong_sign_is_the_headline():
    wrong = Structure("gyro_z", Kind.GOES_AGAINST, 1.0, "a sign is wrong")
    said = words.verdict(replace(made.nothing(), verdict="unknown", structure=(wrong,)))
    assert said.headline == "Unknown: opposite sign to the model's prediction in gyroscope up"
    assert said.next.startswith("Run 'imucald check' on these logs")


def test_a_gain_that_is_not_known_is_reported_so():
    assert words.gain(Gain(math.nan, (math.nan, math.nan))).startswith("not known")


def test_the_evidence_has_the_distance_that_the_threshold_is_for():
    assert words.evidence(made.ROLL) == (
        "21 σ beyond the tolerance of a correct model file, threshold 3.9 σ"
    )
    read = replace(made.ROLL, evidence={"held_out_nats": 12.0})
    assert words.evidence(read) == ""


def test_a_row_of_one_signal_that_fits_an_error_of_another_says_so():
    other = Structure(
        "accel_x", Kind.WANDERS, 2.0, "gyro.bias.y changes by 0.043 deg/s", "gyro.bias.y"
    )
    text = words.structure_text(other)
    assert text.startswith("the residual fits an error of another signal: gyroscope zero")
    assert text.endswith("changes by 0.043 deg/s")
    own = replace(other, signal="gyro_y")
    assert words.structure_text(own) == text.partition(": ")[2]


def test_a_fitted_cause_is_not_called_read_directly():
    """Parameters that move along a direction, as one gain for all axes, are not in `free`."""
    table = SimpleNamespace(blocks=8, gram=np.zeros((8, 1, 1)), keys=(), plain={}, index=list)
    forward = SimpleNamespace(blocks=8, usable=dict, residuals=lambda _: SimpleNamespace(of={}))
    asked = (table, Problem(table, np.zeros(0), np.zeros(0)), table, (), [forward])
    fitted, _ = gain_of(*asked, np.full(8, 5.0))
    assert fitted.was_fitted
    assert fitted.held_out_log_likelihood == pytest.approx(40.0)
    assert not gain_of(*asked)[0].was_fitted


# the model's changes ---------------------------------------------------------------------------


def test_changes_are_those_of_the_keys_that_differ():
    changes = model_changes(made.BEFORE, made.AFTER)
    assert [(c.key, c.before, c.after) for c in changes] == [
        ("suspension.roll_gradient", 0.008, 0.01712345678),
        ("accel.bias", [0.0, 0.0, 0.0], [0.0, 0.2471, 0.0]),
    ]
    assert model_changes(made.AFTER, made.AFTER) == []


def test_a_rounding_error_is_no_change():
    near = made.BEFORE.with_changes({"accel.bias": [1.78e-22, 0.0, 0.0]})
    assert near != made.BEFORE
    assert model_changes(made.BEFORE, near) == []


def test_delays_of_signals_that_the_drives_lack_are_not_shown():
    later = made.BEFORE.with_changes({"speed.delay_s": 0.2, "steering.delay_s": 0.2})
    shown = made.found(model_after=later, channels=frozenset({"accel", "speed"}))
    assert [change.key for change in shown_changes(shown)] == ["speed.delay_s"]
    every = shown_changes(made.found(model_after=later))
    assert [change.key for change in every] == ["speed.delay_s", "steering.delay_s"]


def test_a_diff_opens_each_section_once():
    after = made.BEFORE.with_changes(
        {"suspension.squat_gradient": 0.01, "suspension.dive_gradient": 0.02,
         "gyro.bias": [1.0, 0.0, 0.0],
         "mount.shifts": [{"t_s": 5.0, "roll_deg": 1.0, "pitch_deg": 0.0, "yaw_deg": 0.0}]}
    )  # fmt: skip
    lines = [line for _, line in as_diff(model_changes(made.BEFORE, after))]
    assert [line for line in lines if line.endswith(":")] == ["suspension:", "mount:", "gyro:"]
    assert "  shifts: [{t_s: 5, roll_deg: 1, pitch_deg: 0, yaw_deg: 0}]" in lines


@pytest.mark.parametrize(("value", "text"), [
    (None, "null"), (True, "true"), (0.1 + 0.2, "0.3"), ([1.0, 2.5], "[1, 2.5]"),
    ([0.0] * 50, "[50 entries]"),
])  # fmt: skip
def test_values_are_written_as_yaml_has_them(value, text):
    assert value_text(value) == text


# thinning --------------------------------------------------------------------------------------


def test_an_envelope_keeps_every_spike():
    t = np.arange(100_000) / 10.0
    x = np.zeros(100_000)
    x[77_777], x[12_345] = 9.0, -8.0
    band = envelope(t, x, 400)
    assert np.max(band.high) == 9.0
    assert np.min(band.low) == -8.0
    assert band.t[np.argmax(band.high)] == pytest.approx(7777.7, abs=25.0)


def test_an_envelope_leaves_a_hole_where_nothing_was_measured():
    t = np.arange(1000) / 10.0
    x = np.ones(1000)
    x[300:400] = np.nan
    band = envelope(t, x, 100)
    hole = (band.t > 31.0) & (band.t < 39.0)
    assert np.isnan(band.mean[hole]).all()
    assert (band.mean[(band.t < 29.0) | (band.t > 41.0)] == 1.0).all()


def test_a_trend_finds_a_slope_and_leaves_out_thin_bins():
    x = np.linspace(-2.0, 2.0, 5001)
    found = trend(x, 3.0 * x + np.tile([0.5, -0.5], 2501)[:5001], 20, 12)
    assert found.mean == pytest.approx(3.0 * found.x, abs=0.02)
    assert found.high - found.mean == pytest.approx(0.5, abs=0.3)
    assert len(trend(x[:30], x[:30], 20, 12).x) == 0


def test_a_spectrum_keeps_its_level_in_logarithmic_bins():
    f = np.linspace(0.0, 50.0, 20_001)
    density = np.where(f > 0.0, 1.0 / np.maximum(f, 1e-9), 0.0)
    middle, mean = log_bins(f, density, 100)
    assert len(middle) <= 100
    assert middle[0] > 0.0
    assert mean * middle == pytest.approx(np.ones(len(middle)), rel=0.01)


def test_the_clearest_segment_is_where_the_residual_falls():
    t = np.arange(5000) / 10.0
    before = np.ones(5000)
    after = np.ones(5000)
    after[3000:3400] = 0.0
    rows = clearest_segment(t, before, after, 30.0)
    assert rows.start >= 3000
    assert rows.stop <= 3402
    assert rows.stop - rows.start == pytest.approx(300, abs=2)


def test_a_fault_alone_does_not_promise_a_better_prediction():
    read = made.found(gain=Gain(0.0, (0.0, 0.0), (), was_fitted=False))
    text = page(read).text
    assert "predicts better" not in text
    assert "read directly" in text
    assert words.verdict(read).next == (
        "Use the extended model file (--write-model FILE): its new values were measured at stops "
        "or read from samples, so the fit does not change."
    )
    assert "nats" not in text


def test_beside_a_loose_sensor_no_file_is_recommended():
    loose = Structure("accel_y", Kind.TOO_MUCH, 3.0, "1 m/s^2 is left")
    d = made.found(structure=(loose,), recommended=False)
    said = words.verdict(d).next
    assert "Do not use the extended model file" in said
    assert "the model does not explain accelerometer left" in said


def test_a_dozen_that_cannot_be_distinguished_have_a_short_headline_and_rivals_their_titles():
    many = tuple(titles.CAUSES)[:12]
    headline = words.verdict(replace(made.ambiguous(), look_alikes=(many,))).headline
    assert headline == (
        "Ambiguous: accelerometer bias (left: 25.2 mg), accelerometer scale, accelerometer "
        "cross-axis or 9 others"
    )
    assert words.against(replace(made.BIAS, against=("+- 2",)), made.ambiguous()) == [
        "± 2", "accelerometer cross-axis and mount rotation fit as well",
    ]  # fmt: skip


def cause(name, **parameters):
    return replace(made.BIAS, name=name, parameters=parameters, along_sensor={})


def test_a_headline_has_the_size_of_each_cause():
    zero = {f"gyro.bias.{a}": Estimated(radians(x), 1e-4, "rad/s") for a, x in
            (("x", 0.01), ("y", -0.02), ("z", 1.0))}  # fmt: skip
    along = {f"gyro.bias.{i}": p for i, p in enumerate(zero.values())}
    drift = {"speed.delay_rate": Estimated(203e-6, 9e-6, "1"),
             "speed.delay_s": Estimated(0.3, 0.001, "s")}  # fmt: skip
    shift = {"mount.shifts.roll_deg": Estimated(4.2, 0.4, "deg"),
             "mount.shifts.yaw_deg": Estimated(5.04, 0.36, "deg"),
             "mount.shifts.t_s": Estimated(225.0, math.nan, "s")}  # fmt: skip
    said = [
        words.with_size(one)
        for one in (
            replace(made.BIAS, name="gyro_bias", parameters=zero, along_sensor=along),
            cause("delay_rate", **drift),
            cause("signal_delay", **{"steering.delay_s": Estimated(0.12, 0.01, "s", 0.01)}),
            cause("mount_shift", **shift),
            cause(
                "saturation",
                **{
                    "_accel.clipped": Estimated(0.12, 0.0, "1"),
                    "accel.full_scale": Estimated(20.0, 0.0, "m/s^2", 39.2),
                },
            ),
            cause("saturation"),
        )
    ]
    assert said == [
        "gyroscope bias (up: 1.00 deg/s)",
        "clocks with different rates (203 ppm)",
        "signal delay (steering delay: 120 instead of 10.0 ms)",
        "mount shift (yaw: 5.04 deg)",
        "saturation (accelerometer clipped: 12.0 %)",
        "saturation",
    ]


def test_a_number_that_no_key_holds_is_not_shown_as_one():
    (row,) = words.parameter_rows(cause("saturation", **{
        "_accel.clipped": Estimated(0.12, 0.0, "1")}))  # fmt: skip
    assert row == ("accelerometer clipped", "12.00 %", "-", "", "12.00 %")


def test_a_cause_that_no_key_holds_is_corrected_at_its_source():
    clipped = replace(cause("saturation"), signals=("accel",))
    said = words.verdict(made.found(causes=(clipped,), model_after=made.BEFORE))
    assert said.next == (
        "Correct the cause in the sensor or its sender (accelerometer): the model file has no key "
        "for what was found."
    )


def test_a_search_that_was_ended_early_is_run_again_first():
    assert "--time-limit 300" in words.verdict(made.found(complete=False)).next


def test_a_loose_sensor_is_fastened():
    turned = made.found(causes=(replace(made.ROLL, name="mount_shift"),))
    assert words.verdict(turned).next == (
        "Fasten the sensor, and record a new drive. Use the extended model file (--write-model "
        "FILE) for these drives only: the sensor was turned during them."
    )
    assert "If the sensor is loose, fasten it" in words.verdict(made.unknown()).next
    assert words.verdict(made.nothing()).next.startswith("Nothing to do")


def test_a_time_of_the_drive_is_in_seconds_and_a_pure_number_has_no_unit():
    moment = Estimated(404.9, 15.0, "s", 0.0, 0.0)
    assert numbers.for_people("mount.shifts.t_s", moment)[0] == "405 ± 30 s"
    assert numbers.for_people("_gyro.stuck_s", Estimated(99.98, 0.0, "s"))[0] == "99.98 s"
    assert numbers.for_people("speed.delay_s", Estimated(0.25, 0.0, "s"))[0] == "250.0 ms"
    assert titles.key_title("mount.shifts.t_s") == "time of the shift"
    text = "gyro.scale.0 off by 0.54 +- 0.4; threshold 0.85"
    candidate = Candidate("gyro_scale", "not ruled out", 1.0, text)
    (row,) = words.not_named(made.found(candidates=(candidate,)))
    assert row.value.endswith("off by 0.54 ± 0.4; threshold 0.85")
