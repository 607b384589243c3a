"""Outside effects of where a signal is taken from, and of which of its values go on."""

from __future__ import annotations

import numpy as np

from benchmarks.diagnosis.outside_effects.levels import set_values
from benchmarks.diagnosis.outside_effects.spells import in_spells
from benchmarks.diagnosis.real_effects import Array, Drive
from imucald.core.samples import GRAVITY, Series

TRACK_M = 1.5


def tyre_difference(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """There is no gyroscope about the upward axis: the unit takes the difference of the left and
    the right wheels' speeds over the track of 1.5 m, and the tyres' radii differ by this share, so
    that it shows a bend that grows with the speed (Gustafsson, Ahlqvist, Forssell, Persson, Sensor
    fusion for accurate computation of yaw rate and absolute velocity, SAE 2001-01-1064: offset of
    the relative tyre radius). 0.003 is 1 mm of rubber on a radius of 0.31 m, as after one new tyre
    or with one that is low: 2.3 deg/s at 20 m/s, a heading that is lost within a minute. Noise of
    the wheels is left out."""
    gyro = s["gyro"]
    v = np.interp(gyro.t, s["speed"].t, np.abs(s["speed"].values))
    rate = rng.choice([-1.0, 1.0]) * size * v / TRACK_M
    set_values(s, "gyro", gyro.values + rate[:, None] * R[2])
    return size


def steered_axle(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is the mean of the two steered wheels, which go a wider way than the rear axle:
    with a wheelbase of size [m] it is the root of v^2 and of (wheelbase * yaw rate)^2 (Rajamani,
    Vehicle Dynamics and Control, 2012, 2.2: kinematic model; tachographs and dongles take what the
    vehicle sends and do not ask of which axle). 5.9 m is a city bus of 12 m: at a corner of 10 m
    radius the speed is 16 % too high. A car's 2.7 m give 4 %, which nobody minds."""
    gyro, t, v = s["gyro"], s["speed"].t, s["speed"].values
    n = max(1, round(0.5 / float(np.median(np.diff(gyro.t)))))
    upward = gyro.values @ R[2]
    upward = np.convolve(upward - np.median(upward), np.ones(n) / n, "same")
    # 0.5 m/s: what the gyroscope shows at a stop turns no wheel.
    across = size * np.interp(t, gyro.t, upward) * (np.abs(v) > 0.5)
    # A wheel is steered by 45 deg at most.
    across = np.minimum(np.abs(across), np.abs(v))
    set_values(s, "speed", np.where(v < 0.0, -1.0, 1.0) * np.hypot(v, across))
    return size


def after_jolts(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """A jolt leaves the accelerometer's zero shifted, by size [m/s^2] after a jolt of 1 g, more
    after a stronger one, to the same side of each axis every time; it comes back within 5 s (Chu,
    Zeroshift of piezoelectric accelerometers in pyroshock measurements, Shock and Vibration
    Bulletin 57, 1987; Walter, Accelerometer zero shift, PCB Piezotronics TN-24: an amplifier that
    is driven into its stops by the resonance comes back with the time constant of its coupling).
    A jolt counts from 0.2 g, or from what one sample in 200 passes where the road is smoother.
    What is shown of a jolt in a log of 10 Hz is a fraction of it, so 1 g shown was some 5 g, and
    0.05 of them, Chu's percents of the peak, are 2.5 m/s^2: a tilt that is wrong by degrees for
    seconds after each pothole."""
    t, x = s["accel"].t, s["accel"].values
    upward = x @ R[2]
    jolt = np.abs(upward - np.median(upward)) / GRAVITY
    jolt = np.where(jolt > min(0.2, float(np.quantile(jolt, 0.995))), jolt, 0.0)
    keep = np.exp(-np.minimum(np.diff(t, prepend=t[0]), 60.0) / 5.0)
    left, zero = 0.0, np.zeros(len(t))
    for k in range(len(t)):
        zero[k] = left * keep[k]
        # Charge that is there already leaves no room for that of a weaker jolt.
        left = max(float(zero[k]), float(jolt[k]))
    set_values(s, "accel", x + size * zero[:, None] * rng.choice([-1.0, 1.0], 3))
    return size


def peaks_kept(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The logger keeps of each span of size [s] not the mean but the peak: of each axis the value
    that is farthest from its mean over the last minute (Extech VB300 manual, 3-axis g-force
    datalogger: the peak of each interval is stored; the same in units that look for harsh braking).
    Spans are centred on the stamps, so nothing is late. 0.5 s is of the order of what such units
    have: in a bend or in braking the peak of the shaking is added to the force, and lever, tilt and
    mount come out too large."""
    t, x = s["accel"].t, s["accel"].values
    step = float(np.median(np.diff(t)))
    half, minute = max(1, round(0.5 * size / step)), max(1, round(60.0 / step))
    sums = np.cumsum(np.concatenate([np.zeros((1, 3)), x]), axis=0)
    ends = np.arange(1, len(t) + 1)
    first = np.maximum(ends - minute, 0)
    off = x - (sums[ends] - sums[first]) / (ends - first)[:, None]
    # Before the first minute is over the mean is that of what there is.
    edges = np.pad(off, ((half, half), (0, 0)), mode="edge")
    spans = np.lib.stride_tricks.sliding_window_view(edges, 2 * half + 1, axis=0)
    at = np.argmax(np.abs(spans), axis=2)
    rows = np.clip(np.arange(len(t))[:, None] + at - half, 0, len(t) - 1)
    set_values(s, "accel", np.take_along_axis(x, rows, axis=0))
    return size


def sent_on_change(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """Each axis of the gyroscope is sent when it has changed by size [rad/s] since it was sent
    last, and the receiver goes on with what came last (OMA LightweightM2M 1.0, 5.1.2, attribute
    Step; IPSO object 3334, Gyrometer; Miskowicz, Send-on-delta concept, Sensors 6, 2006). After a
    bend a rate of up to 2 deg/s can stand on a straight road, so that a heading runs off by 20 deg
    in ten seconds; so coarse a step is chosen where each message costs."""
    x = s["gyro"].values
    shown, last = np.empty_like(x), x[0]
    for k, now in enumerate(x):
        last = np.where(np.abs(now - last) >= size, now, last)
        shown[k] = last
    set_values(s, "gyro", shown)
    return size


def full_queue(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed comes over a cellular link and is stamped where it arrives. While something else
    loads the link, 15 to 40 s at a time, a queue before it fills: the speed is late by up to size
    [s] more, which builds up and goes away within 5 s (Jiang, Wang, Lee, Rhee, Tackling bufferbloat
    in 3G/4G networks, IMC 2012: round trips of one second and more under load; Gettys, Nichols,
    Bufferbloat: dark buffers in the internet, ACM Queue 9, 2011). Less than 0.5 s would be taken
    for the link itself."""
    t = s["speed"].t
    grid = np.arange(t[0], t[-1] + 0.1, 0.1)
    loaded = np.convolve(in_spells(grid, 15.0, rng), np.ones(50) / 50.0)[: len(grid)]
    s["speed"] = Series(t + size * np.interp(t, grid, loaded), s["speed"].values)
    return size


def virtual_gyro(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """There is no gyroscope about the upward axis: the unit makes the yaw rate of steering and
    speed, v * angle / (wheelbase * (1 + (v / characteristic speed)^2)), with a characteristic speed
    of 100 km/h where the car's own is size [m/s]. It shows too much, the more so the faster the
    car is (Mitschke, Wallentowitz, Dynamik der Kraftfahrzeuge, 2004: characteristic speed; van
    Zanten, Bosch ESP systems: 5 years of experience, SAE 2000-01-1633: nominal yaw rate). Cars have
    65 to 100 km/h, less with load in front, more with load behind. With the middle of that, 82.5
    km/h, it shows 1.02 times the rate at 20 km/h and 1.2 times at 90. The steering's lead and noise
    are left out."""
    gyro = s["gyro"]
    v = np.interp(gyro.t, s["speed"].t, np.abs(s["speed"].values))
    gain = (1.0 + (v / size) ** 2) / (1.0 + (v / (100.0 / 3.6)) ** 2)
    upward = gyro.values @ R[2]
    more = (gain - 1.0) * (upward - np.median(upward))
    set_values(s, "gyro", gyro.values + more[:, None] * R[2])
    return size


def rounded_positions(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is the way between two positions 1 s apart, half a second before and after its
    stamp, and positions have five decimals of a degree, size [m] to the north (Google, Encoded
    polyline algorithm format: degrees times 1e5, rounded) and 0.71 of it to the east, as at a
    latitude of 45 deg. What is wrong depends on where the road goes, and what is too much in one
    second is too little in the next. Where there is no gyroscope, the road is straight."""
    t, v = s["speed"].t, s["speed"].values
    heading = np.full(len(t), rng.uniform(0.0, 2.0 * np.pi))
    if "gyro" in s:
        own, upward = s["gyro"].t, s["gyro"].values @ R[2]
        turned = np.cumsum((upward - np.median(upward)) * np.diff(own, prepend=own[0]))
        heading += np.interp(t, own, turned)
    steps = np.column_stack([np.cos(heading), np.sin(heading)]) * v[:, None]
    steps = 0.5 * (steps[1:] + steps[:-1]) * np.diff(t)[:, None]
    place = np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])
    grid = np.array([size, size * np.cos(np.pi / 4.0)])
    place += grid * rng.random(2)
    ends = [np.clip(t + half, t[0], t[-1]) for half in (-0.5, 0.5)]
    before, after = (
        grid * np.round(np.column_stack([np.interp(at, t, axis) for axis in place.T]) / grid)
        for at in ends
    )
    s["speed"] = Series(t, np.linalg.norm(after - before, axis=1) / (ends[1] - ends[0]))
    return size


def by_distance(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is a phone's, whose app asks for a new place only after a way of size [m], and the
    last speed stands until then: for 1.5 s at 20 m/s, for 6 s at 5 m/s, and for the whole of a stop
    (transistorsoft/react-native-background-geolocation, issue 2296: the speed does not come to 0 at
    a traffic light; traccar/traccar, issue 3462: a distance filter drops what says that a device
    stopped). 30 m is what Ikolvi/Tracelet, pull request 336, says is set for vehicles; others set
    10 to 100 m."""
    t, v = s["speed"].t, s["speed"].values
    way = np.concatenate([[0.0], np.cumsum(0.5 * np.abs(v[1:] + v[:-1]) * np.diff(t))])
    last, read = 0, np.zeros(len(t), dtype=int)
    for k in range(len(t)):
        if way[k] - way[last] >= size:
            last = k
        read[k] = last
    s["speed"] = Series(t, v[read])
    return size


def camera_scale(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is that of a single camera, which sees how fast things pass but not how far off
    they are: the scale is made of what the ground or known things look like, and wanders along the
    way by this share rms, from one value to the next over 200 m (Strasdat, Montiel, Davison, Scale
    drift-aware large scale monocular SLAM, RSS 2010). Of the way over 100 to 800 m, methods with
    one camera miss 2.5 to 12 % (Geiger, Lenz, Urtasun, Are we ready for autonomous driving? The
    KITTI vision benchmark suite, CVPR 2012, and its table: MLM-SFM and VISO2-M); 5.5 % is the
    middle of these by ratio."""
    t, v = s["speed"].t, s["speed"].values
    way = np.concatenate([[0.0], np.cumsum(0.5 * np.abs(v[1:] + v[:-1]) * np.diff(t))])
    places = np.arange(0.0, way[-1] + 400.0, 200.0)
    scale = size * np.interp(way, places, rng.standard_normal(len(places)))
    set_values(s, "speed", v * (1.0 + scale))
    return size


def flat_degrees(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is made of a receiver's positions, and a degree to the east is taken to be as long
    as one to the north, which is true at the equator only: what goes east or west comes out longer
    by this share, what goes north or south does not (gis.stackexchange.com, Euclidean distance in
    GPS: 30.7 m a second of latitude and 30.9 m one of longitude, wherever one is;
    MatixYo/ESP32-Plane-Radar, pull request 50: the same 111 km for both, at 36 and 52 deg). It is 1
    / cos(latitude) - 1: 0.24 and 0.64 at these two, 0.41 at 45 deg between them. The user has set
    the gain by the way that the vehicle counts, so that it is right over the log, and the speed
    too low on one road and too high on the next, by where they lead."""
    t, v, gyro = s["speed"].t, s["speed"].values, s["gyro"]
    upward = gyro.values @ R[2]
    turned = np.cumsum((upward - np.median(upward)) * np.diff(gyro.t, prepend=gyro.t[0]))
    heading = rng.uniform(0.0, 2.0 * np.pi) + np.interp(t, gyro.t, turned)
    longer = np.hypot(np.cos(heading), (1.0 + size) * np.sin(heading))
    way = np.abs(v) * np.diff(t, prepend=t[0])
    set_values(s, "speed", v * longer * way.sum() / (longer * way).sum())
    return size


def pitot(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is that of a pitot tube, as race cars have one: what it feels is the air, so that
    the wind is added where the road leads into it and taken off where it follows (AiM and MoTeC
    sell them beside wheel sensors). Over land the wind at 10 m is 3.28 m/s on average (Archer,
    Jacobson, Evaluation of global wind power, Journal of Geophysical Research 110, 2005), and half
    of it, size [m/s], at 1 m over a roughness of 0.1 m, with gusts of 1 / ln(1 / 0.1) = 0.43 of it
    (EN 1991-1-4:2005, 4.3.2 and 4.4). A gust turns into the next within 5 s."""
    t, v, gyro = s["speed"].t, s["speed"].values, s["gyro"]
    upward = gyro.values @ R[2]
    turned = np.cumsum((upward - np.median(upward)) * np.diff(gyro.t, prepend=gyro.t[0]))
    heading = rng.uniform(0.0, 2.0 * np.pi) + np.interp(t, gyro.t, turned)
    grid = np.arange(t[0], t[-1] + 10.0, 5.0)
    gust = np.interp(t, grid, rng.standard_normal(len(grid)))
    wind = size * np.cos(heading) * (1.0 + 0.43 * gust)
    set_values(s, "speed", np.maximum(v + wind, 0.0))
    return size


def fixed_height(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is that of an optical flow sensor below the front bumper, which takes its height
    for fixed (ArduPilot/ardupilot, pull request 21510: FLOW_HEIGHT, the sensor of a rover is a
    fixed height above the ground; PX4/PX4-Flow, issue 109: the flow gives no speed without one).
    In braking the front dives, the ground comes nearer and goes by faster: the height changes by
    this share for each m/s^2. 1.5 deg a g (Gillespie, Fundamentals of Vehicle Dynamics, 1992:
    dive and squat) 2.25 m before the middle are 6 mm of 0.3 m, 0.02."""
    t, v = s["speed"].t, s["speed"].values
    grid = np.arange(t[0], t[-1] + 0.1, 0.1)
    smooth = np.convolve(np.interp(grid, t, v), np.ones(10) / 10.0, "same")
    pull = np.interp(t, grid, np.gradient(smooth, 0.1))
    set_values(s, "speed", v / (1.0 + size * np.clip(pull, -10.0, 10.0)))
    return size


def heading_jumps(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The rate about the upward axis is the difference of two headings 1 s apart, half a second
    before and after its stamp, and a heading goes from 360 degrees to 0: each time that the vehicle
    comes through north, a whole turn, size [rad], is missing or too much for 1 s
    (autowarefoundation/autoware, issue 1132: the rate jumps near a yaw of 180 deg;
    microsoft/AirSim, pull request 2956: the same). All else of such a rate is left as the gyroscope
    has it."""
    own, x = s["gyro"].t, s["gyro"].values
    upward = x @ R[2]
    turned = np.cumsum((upward - np.median(upward)) * np.diff(own, prepend=own[0]))
    heading = rng.uniform(0.0, 2.0 * np.pi) + turned
    before, after = (
        np.floor(np.interp(own + half, own, heading) / (2.0 * np.pi)) for half in (-0.5, 0.5)
    )
    set_values(s, "gyro", x - (size * (after - before))[:, None] * R[2])
    return size


def north_frame(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The accelerometer's values come from a phone's app that writes them along north and east by
    its compass (psiphi75/ahrs, issue 7: accelerometer data while driving, in earth coordinates;
    kylecorry31/andromeda, issue 94), and are turned back by the course of a satellite receiver. The
    car's steel deflects the compass, to one side on one course and to the other on the opposite, so
    that the force forward and the force sideways are turned into each other by up to size [rad],
    by where the road leads (Bowditch, American Practical Navigator, compass errors: semicircular
    deviation; mapillary/mapillary_issues, issue 1451: the magnetic field within the car;
    kriswiner/MPU9250, issue 321: nobody can turn a car about all axes to calibrate it).
    organicmaps/organicmaps, issue 3123, saw 30 deg in a car; 15 deg is what passes for good
    (hemanthrajv/flutter_compass, issue 8)."""
    own, x = s["accel"].t, s["accel"].values
    off = size * np.sin(_heading(s, own, rng, R))[:, None]
    up = (x @ R[2])[:, None] * R[2]
    turned = up + np.cos(off) * (x - up) + np.sin(off) * np.cross(R[2], x)
    set_values(s, "accel", turned)
    return size


def steering_play(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """There is no gyroscope about the upward axis: the unit makes the yaw rate of the angle of the
    steering wheel and the speed (commaai/openpilot, pull request 1426: the yaw rate of some cars
    was such a one), and the steering has play of size [m] at the rim. In a bend the tyres pull the
    gear to one end of its play, so that the wheel is turned further than the tyres are, by half of
    the play to that side, and stays so on the straight until a force of 0.3 m/s^2 to the other side
    (commaai/openpilot, issue 599: play in a damper of the steering shaft). 13 mm at a rim of 0.19 m
    are where a test station rejects a rack and pinion (British manual of yearly inspections, 2.2,
    steering play; 75 mm for other gears). With a ratio of 16 and a wheelbase of 2.7 m that is 0.045
    deg/s for each m/s, 0.9 at 20 m/s. All else of such a rate is left as the gyroscope has it."""
    gyro = s["gyro"]
    n = max(1, round(1.0 / float(np.median(np.diff(gyro.t)))))
    v = np.interp(gyro.t, s["speed"].t, np.abs(s["speed"].values))
    upward = gyro.values @ R[2]
    force = v * np.convolve(upward - np.median(upward), np.ones(n) / n, "same")
    strong = np.abs(force) > 0.3
    last = np.maximum.accumulate(np.where(strong, np.arange(len(force)), 0))
    end = np.convolve(np.sign(force[last]) * strong[last], np.ones(n) / n, "same")
    rate = v * end * 0.5 * size / 0.19 / 16.0 / 2.7
    set_values(s, "gyro", gyro.values + rate[:, None] * R[2])
    return size


def smoothed_fixes(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The speed is the way between a phone's places after a filter that thinks the phone stays
    where it is (stackoverflow.com, question 1134579, Smooth GPS data: KalmanLatLong, a place with
    a variance and no speed). What it shows is the velocity, north and east, through a low-pass of
    size [s]: in bends the parts of it no longer point the same way, and their sum is too short
    (jonasoreland/runnerup, issue 1204: corners are cut, 9.2 km for 10), by a ninth at 0.3 rad/s.
    Stamps have been set back by size, so that nothing is late on average. With Q of 3 m/s, as it is
    copied from there, a place a second and an accuracy of 5 m the filter takes 0.446 of what is new
    each second, which is 1.7 s."""
    t = s["speed"].t
    grid = np.arange(t[0], t[-1] + 0.1, 0.1)
    v, heading = np.interp(grid, t, np.abs(s["speed"].values)), _heading(s, grid, rng, R)
    velocity = np.column_stack([v * np.cos(heading), v * np.sin(heading)])
    keep = float(np.exp(-0.1 / size))
    for k in range(1, len(grid)):
        velocity[k] = keep * velocity[k - 1] + (1.0 - keep) * velocity[k]
    shown = np.interp(t + size, grid, np.linalg.norm(velocity, axis=1))
    set_values(s, "speed", shown)
    return size


def magnetic_turns(s: Drive, size: float, rng: np.random.Generator, R: Array) -> float:
    """The rate about the upward axis is that of a heading which a filter makes of gyroscope and
    compass, and which comes to the compass within 2 s (xioTechnologies/Fusion, issue 214: a gain of
    0.5 a second; the heading is first as the gyroscope has it and then goes to the compass). Iron
    in the car deflects the compass by up to size [rad], to one side on one course and to the other
    on the opposite. So a bend is shown too long or too short by where the road leads, and goes on a
    little where it is over (kriswiner/MPU9250, issue 182: of each quarter turn 10 to 15 deg are
    missing). kriswiner/LSM9DS0, issue 8, saw 20 deg to one side at north, 21 to the other at south
    and 8 between; 15 deg is less than that."""
    own, x = s["gyro"].t, s["gyro"].values
    off = size * np.sin(_heading(s, own, rng, R))
    step = np.diff(own, prepend=own[0])
    keep = np.exp(-step / 2.0)
    followed = off.copy()
    for k in range(1, len(own)):
        followed[k] = keep[k] * followed[k - 1] + (1.0 - keep[k]) * off[k]
    more = np.diff(followed, prepend=followed[0]) / np.maximum(step, 1e-3)
    set_values(s, "gyro", x + more[:, None] * R[2])
    return size


def _heading(s: Drive, t: Array, rng: np.random.Generator, R: Array) -> Array:
    """By the gyroscope, from any course at the first sample on [rad]."""
    own, upward = s["gyro"].t, s["gyro"].values @ R[2]
    turned = np.cumsum((upward - np.median(upward)) * np.diff(own, prepend=own[0]))
    return rng.uniform(0.0, 2.0 * np.pi) + np.interp(t, own, turned)
