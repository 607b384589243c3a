"""The joint solution on drives in closed form: what a consumer keeps of cross-talk and zero."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from imucald.core.samples import GRAVITY
from imucald.drive.roads import road_slopes
from imucald.drive.vertical import CarriedVertical
from imucald.drive.windows import WINDOW, spectra
from imucald.mount.joint import evidence as module
from imucald.mount.joint import sums
from imucald.mount.joint.evidence import Block, Evidence, Solution
from imucald.mount.joint.fusion import LinearMeasurement, any_sensor, fuse, joined
from imucald.mount.joint.state import UNKNOWNS, Priors
from joint.planar_drive import ROTATION, Sensor, blocks, cross_talk

ALL = np.ones(64, dtype=bool)
LEVEL_ROADS = Priors(crown=(0.0, 0.002), slope=0.002)
MIXED = np.eye(3) + np.array([[0.0, 0.05, -0.03], [-0.02, 0.0, 0.04], [0.03, -0.05, 0.0]])
SENSORS = {
    "sound": Sensor(),
    "axes mixed by 2 to 5 %": Sensor(accel=MIXED),
    "one gain of 3 %": Sensor(accel=np.diag([1.0, 1.03, 1.0])),
    "gyroscope turned by a degree": Sensor(
        gyro=np.eye(3) + 0.0175 * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    ),
    "zero of 0.2 m/s2": Sensor(zero=np.array([0.2, -0.15, 0.1])),
}


def solved(minutes: float, sensor: Sensor, **drive: float) -> Solution:
    evidence = Evidence(LEVEL_ROADS)
    for block in blocks(minutes, sensor, **drive):  # type: ignore[arg-type]
        evidence.add_block(block)
    found = evidence.solve()
    assert found is not None
    return found


@pytest.mark.parametrize("name", SENSORS)
def test_the_corrected_force_keeps_little_of_the_other_axes_whatever_the_sensor_mixes(
    name: str,
) -> None:
    sensor = SENSORS[name]
    found = solved(6.0, sensor)
    left = cross_talk(found.force, sensor.accel)
    for entry, place in {"xy": (0, 1), "yx": (1, 0), "zx": (2, 0)}.items():
        assert abs(left[place]) < np.radians(0.3), entry
        assert abs(left[place]) < 4.0 * getattr(found.sent(), entry), entry
    level = found.force @ (sensor.accel @ ROTATION.T[:, 2] * GRAVITY + sensor.zero) - found.zero
    assert np.abs(level[:2]).max() < 0.05
    assert abs(level[0]) < 4.0 * found.sent().zero_x


@pytest.mark.parametrize(
    "sensor",
    [
        Sensor(accel=np.diag([-1.0, 1.0, 1.0])),
        Sensor(accel=np.eye(3)[[1, 0, 2]]),
    ],
    ids=["one sign", "axes exchanged"],
)
def test_signals_that_no_sensor_fits_have_no_solution(sensor: Sensor) -> None:
    """Exchanged axes of the gyroscope may have one; `alternatives` finds them."""
    evidence = Evidence(Priors())

    def take(drive: list[Block]) -> None:
        for block in drive:
            evidence.add_block(block)
            evidence.solve_when_due()

    is_refused = False
    try:
        take(blocks(6.0, sensor))
    except np.linalg.LinAlgError:
        is_refused = True
    assert evidence.solution is None or (is_refused and evidence.solution.is_of_sensors)


def test_without_a_bend_the_answer_to_bends_is_stated_as_unknown() -> None:
    found = solved(3.0, Sensor(), bends=0.0)
    assert found.sent().yx < np.radians(0.5)
    assert found.sent().xy > np.radians(1.0)


@pytest.mark.parametrize("late_s", [-0.3, 0.2, 0.7, 1.2])
def test_a_late_speed_is_found_and_costs_no_angle(late_s: float) -> None:
    found = solved(6.0, Sensor(), late_s=late_s)
    assert found.delay == pytest.approx(late_s, abs=0.05)
    assert abs(cross_talk(found.force, np.eye(3))[1, 0]) < np.radians(0.3)


@pytest.mark.slow
def test_a_delay_that_moves_in_long_evidence_is_followed_piece_by_piece(monkeypatch) -> None:
    """All at once would hold the frames of the live loop up for some tenths of a second."""
    taken, made = Evidence._take, [0]

    def counted(self: Evidence, first: int, stop: int) -> None:
        made[-1] += stop - first
        taken(self, first, stop)

    monkeypatch.setattr(Evidence, "_take", counted)
    evidence = Evidence(LEVEL_ROADS)
    usual, later = (blocks(40.0, Sensor(), late_s=late_s) for late_s in (0.2, 0.5))
    for block in usual[:150] + later[150:]:
        evidence.add_block(block)
        evidence.solve_when_due()
        made.append(0)
    assert max(made) <= 2 * module.MADE_AT_ONCE  # with what came since the last solution
    assert sum(made) > 1.5 * len(usual), "all was made again"
    assert evidence.delay > 0.2
    found = evidence.solution
    assert found is not None
    assert abs(cross_talk(found.force, np.eye(3))[1, 0]) < np.radians(0.3)


def test_lost_ticks_cost_their_own_samples_alone() -> None:
    whole, holed = solved(6.0, Sensor()), solved(6.0, Sensor(), lost=0.2)
    assert abs(cross_talk(holed.force, np.eye(3))[1, 0]) < np.radians(0.3)
    assert holed.sent().yx < 2.0 * whole.sent().yx


def test_ticks_that_do_not_count_change_no_spectrum() -> None:
    rng = np.random.default_rng(1)
    window, use = rng.normal(size=(WINDOW, 3)), rng.random(WINDOW) > 0.3
    spoilt = window.copy()
    spoilt[~use] = 1e6
    np.testing.assert_allclose(spectra(spoilt, use), spectra(window, use), rtol=0, atol=1e-6)


def test_an_equation_between_columns_holds_in_their_spectra() -> None:
    rng = np.random.default_rng(2)
    x, use = rng.normal(size=(WINDOW, 2)), rng.random(WINDOW) > 0.3
    both = np.column_stack([x, 0.7 * x[:, 0] - 2.0 * x[:, 1]])
    a, b, y = spectra(both, use).T
    np.testing.assert_allclose(y, 0.7 * a - 2.0 * b, atol=1e-9)


def test_the_vertical_is_carried_as_step_by_step() -> None:
    rng = np.random.default_rng(3)
    rate = 0.2 * rng.normal(size=(192, 3)) + [0.0, 0.0, 0.3]
    pull = np.array([0.0, 0.0, 1.0]) + 0.1 * rng.normal(size=(192, 3))
    carried, parts = CarriedVertical(), []
    for k in range(0, 192, 64):
        parts.append(carried.block(rate[k : k + 64], pull[k : k + 64], ALL)[0])
    up, expected = pull[:64].mean(axis=0), []
    for k in range(192):
        w = rate[k] * 0.1
        angle = np.linalg.norm(w)
        axis = w / angle
        turned = (
            up * np.cos(angle)
            - np.cross(axis, up) * np.sin(angle)
            + axis * (axis @ up) * (1.0 - np.cos(angle))
        )
        gain = 0.1 / min(30.0, 3.0 + 0.1 * k)
        up = turned * (1.0 - gain) + gain * pull[k]
        expected.append(up)
    np.testing.assert_allclose(np.concatenate(parts), expected, atol=1e-9)


@pytest.mark.parametrize("which", [0, 1, 2])
def test_what_a_gyroscopes_cross_talk_makes_of_the_vertical_is_its_slope(which: int) -> None:
    rng = np.random.default_rng(4)
    rate = 0.1 * rng.normal(size=(128, 3)) + [0.0, 0.0, 0.2]
    pull = np.tile([0.0, 0.0, 1.0], (128, 1))
    size = 1e-5
    C = np.eye(3)
    C += (
        size
        * [  # as `CarriedVertical.block` orders them
            np.array([[0, 0, 1], [0, 0, 0], [0, 0, 0]]),
            np.array([[0, 0, 0], [0, 0, 1], [0, 0, 0]]),
            np.array([[0, -1, 0], [1, 0, 0], [0, 0, 0]]),
        ][which]
    )
    sound, wrong = CarriedVertical(), CarriedVertical()
    for k in range(0, 128, 64):
        up, tilts = sound.block(rate[k : k + 64], pull[k : k + 64], ALL)
        off, _ = wrong.block(rate[k : k + 64] @ C.T, pull[k : k + 64], ALL)
    np.testing.assert_allclose((off - up) / size, tilts[:, which], atol=0.03)


def test_no_gain_is_touched_however_far_the_first_axes_were_off() -> None:
    evidence = Evidence(LEVEL_ROADS)
    turn = 0.7  # rad about the vertical, as a poor first look may be off
    wrong = np.array(
        [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    for block in blocks(6.0, Sensor()):
        evidence.add_block(block)
    evidence.start_from(wrong @ ROTATION)
    found = evidence.solve()
    assert found is not None
    np.testing.assert_allclose(np.linalg.svd(found.force)[1], 1.0, atol=0.01)
    assert abs(cross_talk(found.force, np.eye(3))[1, 0]) < np.radians(0.3)


def test_a_long_drive_is_solved_on_and_forgets_its_beginning(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "MOST_BLOCKS", 60)
    monkeypatch.setattr(module, "KEPT_BLOCKS", 40)
    turn = np.radians(3.0)
    turned = np.array(
        [[np.cos(turn), -np.sin(turn), 0.0], [np.sin(turn), np.cos(turn), 0.0], [0.0, 0.0, 1.0]]
    )
    evidence, answer = Evidence(LEVEL_ROADS), ROTATION.T @ turned @ ROTATION
    for k, b in enumerate(blocks(16.0, Sensor())):
        moved = b._replace(force=b.force @ answer.T, rate=b.rate @ answer.T)
        evidence.add_block(b if k < 75 else moved)
        evidence.solve_when_due()
    assert evidence.seconds <= 60 * 6.4
    assert evidence.solution is not None
    left = evidence.solution.force @ answer @ ROTATION.T - np.eye(3)
    assert abs(left[1, 0]) < np.radians(0.3)


def test_windows_put_together_answer_as_windows_kept_one_by_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sensor, found = SENSORS["axes mixed by 2 to 5 %"], []
    for recent in (16, 10_000):
        monkeypatch.setattr(sums, "RECENT", recent)
        evidence = Evidence(LEVEL_ROADS)
        for block in blocks(12.0, sensor, lost=0.1):
            evidence.add_block(block)
            evidence.solve_when_due()
        assert evidence.solution is not None
        found.append(evidence.solution)
    together, apart = found
    smallest = min(apart.sent().xy, apart.sent().yx)
    assert np.abs(together.force - apart.force).max() < 0.1 * smallest
    assert together.sent().xy == pytest.approx(apart.sent().xy, rel=0.03)
    assert together.sent().zero_x == pytest.approx(apart.sent().zero_x, rel=0.03)


def test_an_hour_keeps_a_few_megabytes_and_no_more_after_that() -> None:
    evidence, sizes = Evidence(LEVEL_ROADS), []
    for k, block in enumerate(blocks(100.0, Sensor())):
        evidence.add_block(block)
        if k % 8 == 0:
            evidence.solve_when_due()
            sizes.append(len(pickle.dumps(evidence)))
    assert max(sizes) < 1e7  # 2.6 of them are the ticks
    assert max(sizes[80:]) <= 1.1 * max(sizes[:80])


def test_a_vertical_carried_in_one_piece_is_that_of_its_blocks() -> None:
    rng = np.random.default_rng(5)
    rate = 0.2 * rng.normal(size=(192, 3))
    pull = np.array([0.0, 0.0, 1.0]) + 0.1 * rng.normal(size=(192, 3))
    use = rng.random(192) > 0.2
    whole, by_block = CarriedVertical(), CarriedVertical()
    up, tilts = whole.block(rate, pull, use)
    for k in range(0, 192, 64):
        part = slice(k, k + 64)
        one, tilt = by_block.block(rate[part], pull[part], use[part])
        np.testing.assert_allclose(up[part], one, atol=1e-12)
        np.testing.assert_allclose(tilts[part], tilt, atol=1e-12)


def test_the_axis_of_turning_is_known_from_bends_better_than_roads_are_level() -> None:
    tilted = np.eye(3) + np.array([[0.0, 0.0, 0.03], [0.0, 0.0, -0.02], [0.0, 0.0, 0.0]])
    sensor = Sensor(gyro=ROTATION.T @ tilted @ ROTATION, zero=np.array([0.2, -0.15, 0.1]))
    evidence = Evidence(Priors(crown=(0.0, 0.006)))
    for block in blocks(12.0, sensor):
        evidence.add_block(block)
        evidence.solve_when_due()
    found = evidence.solution
    assert found is not None
    sent, left = found.sent(), cross_talk(found.rate, sensor.gyro)
    assert np.degrees(sent.rate_xz) < 0.4  # the tilt of roads in bends alone: 0.5
    assert np.degrees(sent.rate_yz) < 0.5
    assert abs(left[0, 2]) < 3.0 * sent.rate_xz
    assert abs(left[1, 2]) < 3.0 * sent.rate_yz


def slopes(stretch: int, seed: int = 0, rms: float = 0.02) -> np.ndarray:
    """160 blocks of 100 m. A new slope begins after each `stretch` blocks."""
    rng = np.random.default_rng(seed)
    along, across = np.repeat(rms * rng.standard_normal((2, 160 // stretch)), stretch, axis=1)
    metres = np.full(160, 100.0)
    return np.column_stack([along * metres, across * metres, metres, metres])


def mean_errors(stretch: int, rms: float) -> tuple[np.ndarray, np.ndarray]:
    """Mean slopes (40, 2) that were found on roads whose mean slope is zero, and deviations."""
    found = [road_slopes(slopes(stretch, seed, rms), 0.02) for seed in range(40)]
    return np.array([x.mean for x in found]), np.sqrt([x.mean_variance for x in found])


@pytest.mark.parametrize("rms", [0.02, 0.05])
@pytest.mark.parametrize("stretch", [4, 16])
def test_the_deviation_of_the_mean_slope_follows_steeper_and_longer_grades(
    stretch: int, rms: float
) -> None:
    error, std = mean_errors(stretch, rms)
    assert 0.6 < np.sqrt(np.mean((error / std) ** 2)) < 1.3
    expected = rms * np.sqrt(stretch / 160.0)
    assert 0.7 * expected < np.median(std) < 1.6 * expected


def test_a_drive_that_has_just_begun_has_the_slopes_of_usual_roads() -> None:
    nothing, first = road_slopes(np.zeros((0, 4)), 0.02), road_slopes(slopes(4)[:1], 0.02)
    for found in (nothing, first):
        np.testing.assert_allclose(np.sqrt(found.variances), 0.02, rtol=0.1)
    standing = np.tile([0.05, 0.0, 1.0, 0.0], (20, 1))  # at rest on a slope
    found = road_slopes(standing, 0.02)
    assert found.mean[0] == pytest.approx(0.05)
    assert np.sqrt(found.mean_variance[0]) > 0.018


@pytest.mark.parametrize("squat", [0.0, 0.006])
def test_a_body_that_pitches_when_it_brakes_puts_no_motion_into_the_vertical_force(
    squat: float,
) -> None:
    """3.5 deg/g, and braking that is harder than the launches: without the term, 0.4 deg."""
    evidence = Evidence(Priors(crown=(0.0, 0.002), slope=0.002))
    for one in blocks(6.0, Sensor(), squat=squat, brakes=2.0):
        evidence.add_block(one)
    found = evidence.solve()
    assert found is not None
    assert abs(np.degrees(cross_talk(found.force, np.eye(3))[2, 0])) < 0.2


def test_two_measurements_on_the_same_road_do_not_count_twice() -> None:
    """A grade of the whole drive is in the mean force and in the axis of turning of its bends."""
    rows = np.eye(UNKNOWNS)[9:11]  # of two unknowns that are equal but for a small difference
    level, turning = (
        LinearMeasurement(row[None], np.array([0.02]), np.array([[0.0004]])) for row in rows
    )
    tie = LinearMeasurement(rows[:1] - rows[1:], np.zeros(1), np.array([[1e-8]]))
    prior = any_sensor(Priors(cross_axis=((0.01, 1.0),)))
    nothing = np.zeros(UNKNOWNS)
    stds = [
        np.sqrt(fuse(prior, [tie, *measured], nothing)[1][9, 9])
        for measured in ([level], [joined(level, turning, 0.0004 - 1e-9)], [level, turning])
    ]
    assert stds[1] == pytest.approx(stds[0], rel=0.02)
    assert stds[2] < 0.9 * stds[0], "nothing is tested otherwise"
