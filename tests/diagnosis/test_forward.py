"""The forward model beside drives of the second generator, which shares nothing with it."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from hidden import Effect, hidden_drive
from imucald.core.rotations import rotation_from_vector
from imucald.core.samples import Series
from imucald.diagnosis.cause_keys import extended, mount_of, value, with_delay_rate, with_shifts
from imucald.diagnosis.direct.stops import Rest, rest_of
from imucald.diagnosis.equations.forward import Forward
from imucald.diagnosis.fit.blocks import table_of
from imucald.diagnosis.signals import Channel, drive_of, duplicates, unusable
from imucald.model.model import VehicleModel, model_from_mapping

ROWS = 300
SEED, MINUTES = 21, 6.0


@cache
def world():
    """A drive, and the model file that is right in every number that the generator tells."""
    drive = hidden_drive(SEED, (), MINUTES)
    model = model_from_mapping(dict(drive.model), "baseline")
    return drive, model


@cache
def forward() -> Forward:
    drive, model = world()
    return Forward(drive_of(drive.samples), model, ROWS)


def residual(name: str, f: Forward) -> np.ndarray:
    """Residual of the rows that were there, the tilt of each block fitted."""
    found, masks = f.residuals({}), f.usable()
    y = found.of[name]
    if name in found.tilt:
        tilt = f.tilts(found, masks)
        first, second = found.tilt[name]
        y = y - tilt[:, :1] * first - tilt[:, 1:] * second
    return y[masks[name]]


@pytest.mark.parametrize(("name", "most"), [
    ("accel_x", 0.15), ("accel_y", 0.15), ("gyro_z", 0.01), ("lateral_accel", 0.15),
])  # fmt: skip
def test_what_is_left_of_an_honest_drive_is_small(name, most):
    assert np.std(residual(name, forward())) < most


def test_gravity_carried_by_the_gyroscope_takes_the_road_out():
    """With a gyroscope that says nothing of pitch and roll, the road stays in the residual."""
    drive, model = world()
    still = dict(drive.samples)
    R = mount_of(model)
    yaw_only = (drive.samples["gyro"].values @ R[2])[:, None] * R[2]
    still["gyro"] = Series(drive.samples["gyro"].t, yaw_only)
    blind = Forward(drive_of(still), model, ROWS)

    def slow(f: Forward) -> float:
        y = residual("accel_y", f)
        return float(np.std(y[: len(y) // 20 * 20].reshape(-1, 20).mean(axis=1)))

    assert slow(forward()) < 0.5 * slow(blind)


def test_a_turn_of_the_mount_about_level_axes_is_invisible_where_gravity_is_carried():
    """Why it is no rival of a bias: the tilt of each block takes it up."""
    f = forward()
    base, masks = f.residuals({}), f.usable()
    turned = f.residuals({"mount.turn.y": 0.02})
    shift = {}
    for found in (base, turned):
        tilt = f.tilts(found, masks)
        for name in ("accel_x", "accel_y"):
            first, second = found.tilt[name]
            left = (found.of[name] - tilt[:, :1] * first - tilt[:, 1:] * second)[masks[name]]
            shift.setdefault(name, []).append(left)
    for before, after in shift.values():
        assert np.std(after - before) < 0.03  # 0.02 rad of gravity would be 0.2


def test_no_column_is_the_raw_signal_of_its_own_equation():
    """A gain told by the signal itself would be 1.0000 +- 0.0000."""
    f = forward()
    masks = f.usable()
    f.settle(f.tilts(f.residuals({}), masks), np.ones(f.blocks))
    base, measured = f.residuals({}, by_inertia=True), f.measured()
    for key in ("accel.scale.0", "accel.scale.1", "accel.scale.2", "gyro.scale.0", "gyro.scale.1",
                "gyro.scale.2"):  # fmt: skip
        moved = f.residuals({key: 0.01}, by_inertia=True)
        for name in ("accel_z", "gyro_x", "gyro_y"):
            rows = masks[name].ravel()
            column = (base.of[name] - moved.of[name]).ravel()[rows]
            if np.std(column) < 1e-9:
                continue
            own = measured[name][rows]
            assert abs(np.corrcoef(column, own)[0, 1]) < 0.95, (key, name)


@pytest.mark.parametrize("name", ["gyro_z", "yaw_rate"])
def test_the_noise_of_an_equation_is_not_explained_by_two_gains_of_its_own_signals(name):
    """Each made of its own signal, the difference of their columns would be the equation itself."""
    samples = dict(world()[0].samples)
    rng, yaw = np.random.default_rng(5), samples["yaw_rate"]
    loud = 0.02 * rng.standard_normal(len(yaw.values))
    samples["yaw_rate"] = Series(yaw.t, yaw.values + loud)
    table = table_of([drive_of(samples)], world()[1])[0]
    gram = table.plain[name].sum(axis=(0, 1))
    free = np.linalg.lstsq(gram[1:, 1:], gram[1:, 0], rcond=1e-12)[0]
    left = gram[0, 0] - gram[0, 1:] @ free
    assert left > 0.8 * gram[0, 0]


def gain_alone(samples) -> float:
    """The speed's gain by the forward equation alone."""
    table = table_of([drive_of(samples)], world()[1])[0]
    gram, at = table.plain["accel_x"].sum(axis=(0, 1)), table.keys.index("speed.scale") + 1
    return float(gram[0, at] / gram[at, at])


def test_noise_of_the_accelerometer_is_no_gain_where_the_speed_knows_better():
    """It stands in the equation, and would stand in the column that is made of its signal."""
    samples = dict(world()[0].samples)
    rng, accel = np.random.default_rng(4), samples["accel"]
    noise = 1.0 * rng.standard_normal(accel.values.shape)
    samples["accel"] = Series(accel.t, accel.values + noise)
    assert gain_alone(samples) == pytest.approx(gain_alone(world()[0].samples), abs=0.02)


@pytest.mark.parametrize(("changes", "key"), [
    ({"accel.bias.x": 0.2}, "accel.bias.x"),
    ({"gyro.scale.2": 0.03}, "gyro.scale.2"),
    ({"speed.scale": 0.03}, "speed.scale"),
    ({"steering.offset": 0.05}, "steering.offset"),
    ({"mount.turn.z": 0.05}, "mount.turn.z"),
    ({"speed.delay_s": 0.1}, "speed.delay_s"),
    ({"accel.scale.1": 0.04}, "accel.scale.1"),
])  # fmt: skip
def test_a_written_change_is_the_change_that_was_tried(changes, key):
    """The model file with a change, evaluated, gives what the change gave on top of the file."""
    drive, model = world()
    tried = forward().residuals(changes)
    written = extended(model, changes)
    assert value(written, key) != value(model, key) or key.startswith("mount.turn")
    again = Forward(drive_of(drive.samples), written, ROWS).residuals({})
    for name, y in tried.of.items():
        scale = np.std(forward().residuals({}).of[name]) + 1e-6
        assert np.sqrt(np.mean((again.of[name] - y) ** 2)) < 0.1 * scale, name


def test_columns_of_turning_do_not_feel_what_the_file_says_of_the_accelerometer_again():
    """They are made of a rate without any error: a sensitivity that the file states leaves them as
    they are, also the columns of gains and turns, in which it would not drop out."""
    drive, model = world()
    aware = model.with_changes({"gyro.g_sensitivity": [0.02, 0.02, 0.02]})
    rate = np.random.default_rng(6).standard_normal((len(forward().t), 3))
    felt = Forward(drive_of(drive.samples), aware, ROWS)
    for changes in ({}, {"gyro.scale.2": 0.05}, {"mount.turn.x": 0.05}):
        assert np.array(felt.triad("gyro", changes, rate)) == pytest.approx(
            np.array(forward().triad("gyro", changes, rate))
        )


def test_the_effect_of_a_bias_is_its_column():
    drive, model = world()
    table, _ = table_of([drive_of(drive.samples)], model)
    other = hidden_drive(SEED, (Effect("accel_bias", "medium"),), MINUTES)
    biased, _ = table_of([drive_of(other.samples)], model)
    R = mount_of(model)
    change = [other.parameters[f"accel.bias.{i}"] - drive.parameters[f"accel.bias.{i}"]
              for i in range(3)]  # fmt: skip
    keys = [f"accel.bias.{a}" for a in "xyz"]
    found = []
    for t in (table, biased):
        total = t.gram.sum(axis=0)
        weak = np.diag(3.0 / t.tolerance**2)
        index = t.index(keys)
        weak[np.ix_(index, index)] = 0.0
        x = np.linalg.solve(total[1:, 1:] + weak, total[1:, 0])
        found.append(x[index])
    assert found[1] - found[0] == pytest.approx(R @ change, abs=0.02)


# reading -----------------------------------------------------------------------------------------


def test_a_channel_is_read_at_any_delay():
    t = np.arange(0.0, 60.0, 0.01)
    channel = Channel.from_series(Series(t, np.sin(t)))
    at = np.arange(5.0, 50.0, 0.1)
    assert channel.means(at + 0.25) == pytest.approx(np.sin(at + 0.25), abs=2e-3)


def test_equal_values_soon_after_are_duplicates_and_slow_ones_are_not():
    t = np.arange(0.0, 20.0, 0.5)
    x = np.arange(40.0)
    x[20] = x[19]
    twice = [5, 12, 30]
    series = Series(np.insert(t, twice, t[twice] - 0.49), np.insert(x, twice, x[twice] - 1.0))
    found = np.flatnonzero(duplicates(series, 0.5)).tolist()
    assert found == [5, 13, 32], "each where it was put in"


def test_a_clock_that_is_set_and_a_late_frame_send_nothing_twice():
    """The next frame comes a cycle after the second of the two, whatever they say."""
    cycle = np.arange(0.0, 100.0, 0.01)
    set_back = cycle - 0.008 * np.floor(cycle / 5.0 + 1e-9)
    assert (np.diff(set_back) < 0.003).sum() == 19
    assert not duplicates(Series(set_back, np.repeat(np.arange(2500.0), 4)), 0.01).any()
    late = cycle.copy()
    late[50::100] += 0.0085
    x = np.arange(len(late)) * 1.0
    x[51::100] = x[50::100]
    assert not duplicates(Series(late, x), 0.01).any()


def test_who_shares_a_stamp_and_says_something_else_is_kept_out_and_is_no_duplicate():
    """A logger's clock is coarser than the cycle: when each of the two was, nobody knows."""
    t, x = np.arange(0.0, 20.0, 0.5), np.arange(40.0)
    t[20] = t[19]
    assert not duplicates(Series(t, x), 0.5).any()
    assert np.flatnonzero(unusable(Series(t, x), 0.5)).tolist() == [20]
    assert 20.0 not in Channel.from_series(Series(t, x)).values


def test_stops_are_those_that_speed_and_gyroscope_agree_on():
    drive, model = world()
    stops = drive_of(drive.samples).stops
    assert stops
    for stop in stops:
        inside = (drive.t >= stop.start_s) & (drive.t <= stop.stop_s)
        assert np.abs(drive.speed[inside]).max() < 0.3
    turning = dict(drive.samples)
    gyro = turning["gyro"]
    turning["gyro"] = Series(gyro.t, gyro.values + 0.1 * np.sin(3.0 * gyro.t)[:, None])
    assert drive_of(turning).stops == ()
    rest = rest_of([drive_of(drive.samples)], model, 3)
    assert rest is not None
    true = mount_of(model) @ [drive.parameters[f"gyro.bias.{i}"] for i in range(3)]
    assert rest.rate == pytest.approx(true, abs=0.0012)  # it warms up besides


def test_two_stops_that_differ_show_no_zero_more_sharply_than_they_differ():
    """As of a gyroscope that forgets: what it shows at a stop is left of the turn before it."""
    drive, model = world()
    whole = drive_of(drive.samples)
    first = whole.stops[0]
    other = replace(first, gyro=first.gyro + np.radians([0.0, 0.0, 0.4]))
    same = rest_of([replace(whole, stops=(first, first))], model, 3)
    differ = rest_of([replace(whole, stops=(first, other))], model, 3)
    assert same is not None
    assert differ is not None
    assert same.se == pytest.approx(np.radians([0.04] * 3))
    assert np.degrees(np.linalg.norm(differ.se)) > 0.19


# writing -----------------------------------------------------------------------------------------


def test_a_speed_that_leads_makes_all_others_late():
    model = VehicleModel().with_changes({"speed.delay_s": 0.05, "wheel_speeds.delay_s": 0.05})
    after = extended(model, {"speed.delay_s": -0.2})
    assert after.speed.delay_s == 0.0
    assert after.accel.delay_s == pytest.approx(0.15)
    assert after.gyro.delay_s == pytest.approx(0.15)
    assert after.wheel_speeds.delay_s == 0.0, "the wheels are on the same bus"


def test_a_growing_delay_is_counted_from_the_start():
    changes = with_delay_rate({"speed.delay_s": 0.1, "speed.delay_rate": 1e-4}, 1000.0)
    assert changes["speed.delay_s"] == pytest.approx(0.0)


def test_a_turn_and_a_shift_are_rotations_about_the_vehicles_axes():
    model = VehicleModel().with_changes({"mount.yaw_deg": 40.0, "mount.pitch_deg": 10.0})
    turn = np.array([0.02, -0.03, 0.05])
    keys = {f"mount.turn.{a}": float(x) for a, x in zip("xyz", turn, strict=True)}
    after = mount_of(extended(model, keys))
    assert after == pytest.approx(rotation_from_vector(turn) @ mount_of(model), abs=1e-9)
    shifted = with_shifts(model, [(100.0, turn)])
    assert shifted.mount.shifts[0].t_s == 100.0


def test_stops_allow_for_what_the_temperature_may_do():
    """0.07 deg/s at 20 K from where the zero is stated is no error of a correct file; at 0 K it
    is."""
    _, model = world()
    rate = np.radians([0.07, 0.0, 0.0])
    se = np.full(3, 1e-5)
    cold, warm = Rest(rate, se, 3.0, 9, 0.0), Rest(rate, se, 3.0, 9, 20.0)
    assert np.any(np.abs(cold.rate) > cold.allowed(model))
    assert np.all(np.abs(warm.rate) < warm.allowed(model))
    low, high = warm.bounds(model)["gyro.bias.x"]
    assert low < rate[0] < high
    assert high - low > np.radians(2 * 20 * 0.01)


@pytest.mark.parametrize("key", ["speed.delay_s", "accel.delay_s", "gyro.delay_s"])
@pytest.mark.parametrize("change", [-7.0, 2.5, 7.0])
def test_a_delay_that_runs_off_stays_within_what_a_file_may_hold(key: str, change: float):
    model = extended(VehicleModel(), {key: change})
    delays = [getattr(model, name).delay_s for name in ("accel", "gyro", "speed", "steering")]
    assert min(delays) >= 0.0
    assert max(delays) == 2.0
