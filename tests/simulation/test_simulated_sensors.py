"""Each sensor error is there, in its size, and nothing else: from the samples' own statistics."""

import numpy as np
import pytest
from scipy.signal import welch

from imucald.core.samples import GRAVITY
from imucald.simulation import VehicleModel, simulate

CLEAN = {
    f"{sensor}.{key}": value
    for sensor in ("accel", "gyro")
    for key, value in {
        "vibration": False,
        "noise_density": 0.0,
        "lsb": 0.0,
        "lowpass_hz": None,
        "jitter_s": 0.0,
        "full_scale": None,
    }.items()
} | {
    f"{signal}.{key}": 0.0
    for signal in ("steering", "yaw_rate", "lateral_accel", "longitudinal_accel")
    for key in ("noise", "lsb", "delay_s", "jitter_s")
}
PARKED = {"route.kind": "parked", "road.grade": False, "road.bank": False}


def run(changes=None, seed=1, minutes=2.0, **more):
    wanted = CLEAN | (changes or {}) | {k.replace("__", "."): v for k, v in more.items()}
    return simulate(VehicleModel().with_changes(wanted), seed, minutes)


def lag_between(a, b, rate):
    """Lag of b behind a [s], by the peak of their cross-correlation, refined by a parabola."""
    a, b = a - a.mean(), b - b.mean()
    reach = int(0.6 * rate)
    c = np.array([np.dot(a[reach:-reach], b[reach + k : len(b) - reach + k])
                  for k in range(-reach, reach)])  # fmt: skip
    k = int(np.argmax(c))
    fine = 0.5 * (c[k - 1] - c[k + 1]) / (c[k - 1] - 2 * c[k] + c[k + 1])
    return (k - reach + fine) / rate


@pytest.mark.parametrize(("sensor", "density"), [("accel", 0.002), ("gyro", 1e-4)])
def test_noise_has_the_stated_density_and_is_white(sensor, density):
    series = run(PARKED, **{f"{sensor}__noise_density": density}, minutes=5.0).samples[sensor]
    for axis in range(3):
        f, p = welch(series.values[:, axis], 100.0, nperseg=512)
        inside = (f > 1.0) & (f < 49.0)
        assert np.sqrt(np.mean(p[inside])) == pytest.approx(density, rel=0.03)
        assert np.mean(p[inside & (f < 10)]) == pytest.approx(np.mean(p[f > 40]), rel=0.12)
    correlation = np.corrcoef(series.values.T)
    assert np.max(np.abs(correlation - np.eye(3))) < 0.03


def test_scale_and_cross_axis_errors_mix_axes_as_stated():
    clean = run(seed=3).samples["accel"]
    scale, cross = (0.01, -0.02, 0.03), (0.001, 0.002, 0.003, 0.004, 0.005, 0.006)
    found = run(seed=3, accel__scale=scale, accel__cross_axis=cross).samples["accel"]
    M, *_ = np.linalg.lstsq(clean.values, found.values, rcond=None)
    expected = [[1.01, 0.001, 0.002], [0.003, 0.98, 0.004], [0.005, 0.006, 1.03]]
    np.testing.assert_allclose(M.T, expected, atol=1e-9)


def test_bias_wanders_with_temperature_and_time():
    warm = {"temperature.start_degc": 5.0, "temperature.rise_k": 30.0, "temperature.lsb": 0.0}
    drive = run(PARKED | warm, minutes=20.0, gyro__bias_temperature=(1e-4, 0.0, -2e-4))
    t, values = drive.samples["gyro"].t, drive.samples["gyro"].values
    expected = 5.0 + 30.0 * (1.0 - np.exp(-t / 600.0)) - 25.0
    np.testing.assert_allclose(values[:, 0], 1e-4 * expected, atol=1e-8)
    np.testing.assert_allclose(values[:, 2], -2e-4 * expected, atol=1e-8)
    heat = drive.samples["temperature"]
    np.testing.assert_allclose(heat.values, 5.0 + 30.0 * (1.0 - np.exp(-heat.t / 600.0)), atol=0.1)
    ends = [run(PARKED, seed, 1.0, accel__bias_walk=0.01).samples["accel"].values[-1, 0]
            for seed in range(40)]  # fmt: skip
    assert np.std(ends) == pytest.approx(0.01 * np.sqrt(60.0), rel=0.3)


def test_g_sensitivity_shows_gravity_in_the_gyro():
    series = run(PARKED, gyro__g_sensitivity=(1e-4, 1e-4, 2e-4), minutes=0.1).samples["gyro"]
    np.testing.assert_allclose(series.values[-1], [0.0, 0.0, 2e-4 * GRAVITY], atol=1e-9)


def test_full_scale_clips_and_the_step_is_kept():
    series = run(accel__full_scale=9.0, accel__lsb=0.125, accel__noise_density=0.01).samples[
        "accel"
    ]
    assert np.max(series.values) == 9.0
    steps = series.values / 0.125
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)


@pytest.mark.parametrize("delay", [0.0, 0.12, 0.3])
def test_speed_is_late_by_its_delay(delay):
    drive = run(speed__delay_s=delay, speed__jitter_s=0.0, speed__noise_mps=0.0, seed=2)
    grid = np.arange(5.0, 118.0, 0.02)
    truth = np.interp(grid, drive.truth.t, np.abs(drive.truth.speed))
    shown = np.interp(grid, drive.samples["speed"].t, drive.samples["speed"].values)
    found = lag_between(np.gradient(truth), np.gradient(shown), 50.0)
    assert found == pytest.approx(delay, abs=0.004)


@pytest.mark.parametrize("channel", ["steering", "yaw_rate", "accel", "gyro"])
def test_other_signals_are_late_by_theirs(channel):
    changes = {f"{channel}.delay_s": 0.2, f"{channel}.lowpass_hz": None}
    late, prompt = run(changes, seed=5), run({f"{channel}.lowpass_hz": None}, seed=5)
    grid = np.arange(5.0, 118.0, 0.01)

    def column(drive):
        series = drive.samples[channel]
        values = series.values if series.values.ndim == 1 else series.values[:, 2]
        return np.gradient(np.interp(grid, series.t, values))

    assert lag_between(column(prompt), column(late), 100.0) == pytest.approx(0.2, abs=0.003)


def test_lowpass_passes_slow_motion_and_halves_the_power_at_its_corner():
    rough = {"grid_hz": 1000.0, "accel.rate_hz": 500.0, "road.roughness_n0": 1e-3}
    open_, low = (run(rough, 4, 1.0, accel__lowpass_hz=hz).samples["accel"] for hz in (None, 10.0))
    (f, wide), (_, narrow) = (welch(s.values[:, 2], 500.0, nperseg=1024) for s in (open_, low))
    gain = narrow / wide
    assert np.mean(gain[(f > 0.4) & (f < 2.0)]) == pytest.approx(1.0, abs=0.05)
    assert np.interp(10.0, f, gain) == pytest.approx(0.5, abs=0.1)
    assert np.interp(40.0, f, gain) < 0.01


def test_speed_has_scale_dead_band_and_steps():
    drive = run(speed__scale=0.02, speed__lsb=0.25, speed__dead_band_mps=1.5, speed__jitter_s=0.0)
    series = drive.samples["speed"]
    truth = np.interp(series.t, drive.truth.t, np.abs(drive.truth.speed))
    steady = truth > 3.0
    assert np.mean(series.values[steady] / truth[steady]) == pytest.approx(1.02, abs=0.002)
    moving = series.values[series.values > 0.0]
    assert moving.min() >= 1.5 - 0.25
    np.testing.assert_allclose(moving / 0.25, np.rint(moving / 0.25), atol=1e-9)
    assert np.all(series.values >= 0.0)


def test_wheels_differ_in_a_turn_by_the_track_and_slip_under_drive():
    quiet = {"wheel_speeds.noise_mps": 0.0, "wheel_speeds.lsb": 0.0, "wheel_speeds.jitter_s": 0.0}
    drive = run(quiet, seed=6, wheel_speeds__slip_per_mps2=0.0)
    series, truth = drive.samples["wheel_speeds"], drive.truth
    rate = np.interp(series.t, truth.t, truth.yaw_rate)
    forward = np.interp(series.t, truth.t, truth.speed) > 2.0
    across = (series.values[:, 3] - series.values[:, 2])[forward]
    np.testing.assert_allclose(across, 1.53 * rate[forward], atol=0.02)
    # A front wheel runs on the wider arc: at least as fast as the rear axle's middle on average.
    front = series.values[:, :2].mean(axis=1)[forward]
    rear = series.values[:, 2:].mean(axis=1)[forward]
    assert np.all(front - rear > -0.01)
    slipping = run(quiet, seed=6, wheel_speeds__slip_per_mps2=0.01).samples["wheel_speeds"]
    gained = slipping.values[:, 0] / np.maximum(series.values[:, 0], 1.0) - 1.0
    force = np.interp(series.t, truth.t, truth.reference_force[:, 0])
    launch = forward & (force > 0.5) & (series.values[:, 0] > 3.0)
    np.testing.assert_allclose(gained[launch], 0.01 * force[launch], rtol=0.1, atol=1e-3)


def test_wheels_disagree_while_the_brakes_are_controlled():
    event = {"wheel_speeds.slip_events": ({"start_s": 60.0, "duration_s": 2.0},)}
    drive = run(event, seed=1, route__standing_first_s=0.0)
    series = drive.samples["wheel_speeds"]
    spread = np.ptp(series.values, axis=1) / np.maximum(series.values.max(axis=1), 1.0)
    inside = (series.t > 60.0) & (series.t < 62.0)
    assert np.mean(spread[inside]) > 0.1
    assert np.mean(spread[~inside]) < 0.05


def test_yaw_rate_and_steering_have_offset_scale_and_ratio():
    drive = run(yaw_rate__offset=0.02, yaw_rate__scale=0.05, steering__offset=0.1, seed=7)
    truth = drive.truth
    r = drive.samples["yaw_rate"]
    body = np.interp(r.t, truth.t, truth.rate[:, 2])
    slope, offset = np.polyfit(body, r.values, 1)
    assert slope == pytest.approx(1.05, abs=0.01)
    assert offset == pytest.approx(0.02, abs=5e-4)
    s = drive.samples["steering"]
    wheel = np.interp(s.t, truth.t, truth.steer)
    slope, offset = np.polyfit(wheel, s.values, 1)
    assert slope == pytest.approx(drive.model.chassis.steering_ratio, rel=1e-3)
    assert offset == pytest.approx(0.1, abs=1e-3)


def test_frames_are_lost_dropped_out_and_stuck_where_asked():
    changes = {
        "speed.loss": 0.1,
        "accel.dropouts": ({"start_s": 30.0, "duration_s": 5.0},),
        "steering.stuck": ({"start_s": 40.0, "duration_s": 10.0},),
    }
    samples = run(changes, minutes=2.0).samples
    assert len(samples["speed"].t) == pytest.approx(0.9 * 120 * 50, rel=0.03)
    t = samples["accel"].t
    assert not np.any((t > 30.001) & (t < 34.999))
    assert np.max(np.diff(t)) == pytest.approx(5.0, abs=0.02)
    inside = (samples["steering"].t > 40.01) & (samples["steering"].t < 49.99)
    assert inside.sum() > 900
    assert np.ptp(samples["steering"].values[inside]) == 0.0


@pytest.mark.parametrize("name", ["speed", "wheel_speeds"])
def test_a_stuck_speed_repeats_itself_exactly_and_leaves_all_else_as_it_is(name: str) -> None:
    noise = {f"{name}.noise_mps": 0.05, f"{name}.lsb": 0.0}
    stuck = {f"{name}.stuck": ({"start_s": 40.0, "duration_s": 10.0},)}
    sound, held = run(noise).samples[name], run(noise | stuck).samples[name]
    inside = (held.t > 40.05) & (held.t < 49.95)
    assert np.all(np.ptp(held.values[inside], axis=0) == 0.0)
    assert np.all(np.ptp(sound.values[inside], axis=0) > 0.1), "noise and driving"
    outside = (held.t < 39.9) | (held.t > 50.1)
    assert np.array_equal(held.values[outside], sound.values[outside])


def test_clocks_drift_and_frames_are_late_but_in_order():
    samples = run({"accel.clock_drift_ppm": 500.0, "speed.jitter_s": 0.002}, minutes=5.0).samples
    period = np.median(np.diff(samples["accel"].t))
    assert period == pytest.approx(0.01 * 1.0005, rel=2e-6)
    assert np.all(np.diff(samples["speed"].t) >= 0.0)
    assert np.std(np.diff(samples["speed"].t)) == pytest.approx(0.002 * np.sqrt(2.0), rel=0.1)


def test_flags_say_reverse_and_brake():
    for seed in range(30):
        drive = run(seed=seed, minutes=6.0, route__kind="city")
        if np.any(drive.truth.speed < -0.5):
            break
    else:
        pytest.fail("no drive in reverse in thirty")
    for name, flag in (("reverse", drive.truth.speed < 0.0),):
        series = drive.samples[name]
        assert set(np.unique(series.values)) == {0.0, 1.0}
        true = np.interp(series.t - 0.02, drive.truth.t, flag.astype(float))
        assert np.mean(np.abs(true - series.values)) < 0.01
    brake = drive.samples["brake"]
    accel = np.interp(brake.t, drive.truth.t, drive.truth.acceleration * np.sign(drive.truth.speed))
    assert np.mean(brake.values[accel < -0.8]) > 0.95
    assert np.mean(brake.values[accel > 0.2]) < 0.05


def test_magnetometer_turns_with_the_heading():
    changes = {"mag.enabled": True, "mag.noise_t": 0.0, "mag.lsb": 0.0, "heading.enabled": True}
    drive = run(changes, seed=8, mount__yaw_deg=30.0, heading__noise=0.0)
    mag, truth = drive.samples["mag"], drive.truth
    heading = np.interp(mag.t, truth.t, truth.heading)
    # Compass of a sensor turned 30 degrees to the left: its x axis points left of the nose.
    compass = np.arctan2(mag.values[:, 1], mag.values[:, 0])
    error = np.angle(np.exp(1j * (compass - heading + np.radians(30.0))))
    assert np.max(np.abs(error)) < np.radians(10.0)
    assert abs(np.median(error)) < np.radians(4.0)
    shown = drive.samples["heading"]
    true = np.interp(shown.t, truth.t, truth.heading)
    assert np.max(np.abs(np.angle(np.exp(1j * (shown.values - true))))) < 0.05


def test_signals_can_be_absent():
    absent = ("gyro", "speed", "steering", "yaw_rate", "reverse")
    samples = run({f"{name}.enabled": False for name in absent}, minutes=0.1).samples
    assert not set(absent) & set(samples)
    assert {"accel", "wheel_speeds", "brake"} <= set(samples)
