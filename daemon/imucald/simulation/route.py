"""The route of a drive: a path with curvature, target speed and stops, drawn from a seed.

The path is a list of nodes along the distance. Lengths, radii and speeds are typical of European
roads: city blocks of 130-540 m at 30 and 50 km/h, country roads at 70-100 km/h, motorways.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imucald.core.arrays import Array
from imucald.model.vehicle import DriveRoute
from imucald.simulation.filters import generator

COARSE_FROM_MPS = 14.0
"""Speed below which nodes are 0.5 m apart [m/s]. Above this speed, nodes are 1 m apart."""
LANE_WIDTH_M = 3.5
MIN_STOP_S = 1.5
"""Shortest duration of a stop [s]. In a shorter stop, the speed would not reach zero, because the
jerk is limited."""


@dataclass(frozen=True)
class Path:
    """Nodes of a path, all (N,). `step`: distance to the next node [m]."""

    step: Array
    curvature: Array
    """Curvature [1/m], positive to the left when driving forward."""
    target_mps: Array
    lateral_mps2: Array
    launch_mps2: Array
    braking_mps2: Array
    stop_s: Array
    """Standing time at the node [s]; 0 without a stop."""
    direction: Array
    """Direction of driving: +1 forward, -1 in reverse."""
    banked: Array
    """1 on superelevated curves (outside cities), 0 on other roads."""


class RouteBuilder:
    """Collects pieces of road until the drive is long enough."""

    def __init__(self, route: DriveRoute, seed: int) -> None:
        self._route = route
        self._rng = generator(seed, "route")
        self._columns: list[list[Array]] = [[] for _ in range(9)]
        self._near_side = -1.0 if route.driving_side == "right" else 1.0
        self.least_time_s = route.standing_first_s

    @property
    def is_empty(self) -> bool:
        """True if the route is still empty."""
        return not self._columns[0]

    def uniform(self, low: float, high: float) -> float:
        """Draw a uniformly distributed number."""
        return float(self._rng.uniform(low, high))

    def effort(self, bounds: tuple[float, float]) -> float:
        """Draw an acceleration. Most values are small, few are large, as in logs of real
        drivers."""
        return bounds[0] + (bounds[1] - bounds[0]) * float(self._rng.beta(1.1, 2.5))

    def chance(self, probability: float) -> bool:
        """Draw a decision: True with this probability."""
        return bool(self._rng.random() < probability)

    def side(self) -> float:
        """Draw left (+1) or right (-1)."""
        return 1.0 if self.chance(0.5) else -1.0

    def piece(
        self,
        length: float,
        speed: float,
        curvature: Callable[[Array], Array] | None = None,
        stop_s: float = 0.0,
        direction: float = 1.0,
        banked: bool = False,
    ) -> None:
        """Add a piece of road. curvature: function of the share (0 to 1) of the length of the
        piece."""
        route = self._route
        speed *= route.speed_factor
        step = 1.0 if speed >= COARSE_FROM_MPS else 0.5
        n = max(2, round(length / step))
        share = (np.arange(n) + 0.5) / n
        stops = np.zeros(n)
        stops[-1] = 0.0 if stop_s <= 0.0 else max(stop_s, MIN_STOP_S)
        columns = (
            np.full(n, length / n),
            np.zeros(n) if curvature is None else curvature(share),
            np.full(n, speed),
            np.full(n, self.effort(route.lateral_mps2)),
            np.full(n, self.effort(route.launch_mps2)),
            np.full(n, self.effort(route.braking_mps2)),
            stops,
            np.full(n, direction),
            np.full(n, float(banked)),
        )
        for column, values in zip(self._columns, columns, strict=True):
            column.append(values)
        self.least_time_s += length / speed + float(stops[-1])

    def path(self) -> Path:
        """Return all pieces joined."""
        return Path(*(np.concatenate(column) for column in self._columns))

    def stop_time(self) -> float:
        """Draw the duration of a stop. The duration is log-normal, as for waits at traffic
        lights."""
        mean = self._route.stop_mean_s
        return float(np.clip(self._rng.lognormal(math.log(mean) - 0.32, 0.8), 2.0, 90.0))

    def bend(
        self, radius: float, angle: float, speed: float, side: float, banked: bool = False
    ) -> None:
        """Add a bend of an angle [rad] with transition curves at its ends. The bend is driven at
        `speed` or slower."""
        ease = min(max(0.5 * radius * angle, 0.5 * speed), radius * angle)
        length = radius * angle + ease

        def curvature(share: Array) -> Array:
            into = np.clip(np.minimum(share, 1.0 - share) * length / ease, 0.0, 1.0)
            return side / radius * 0.5 * (1.0 - np.cos(np.pi * into))

        self.piece(length, speed, curvature, banked=banked)

    def lane_change(self, speed: float, side: float) -> None:
        """Add a lane change that takes 4 to 6 seconds."""
        length = speed * self.uniform(4.0, 6.0)
        height = side * 2.0 * math.pi * LANE_WIDTH_M / length**2
        self.piece(length, speed, lambda share: height * np.sin(2.0 * np.pi * share))

    def straight(self, length: float, speed: float, banked: bool = False) -> None:
        """Add a straight road."""
        self.piece(length, speed, banked=banked)

    def stop(self, duration: float, speed: float = 8.0) -> None:
        """Add a stop at the end of a short straight."""
        self.piece(4.0, speed, stop_s=duration)

    def junction_turn(self) -> None:
        """Add a turn at a junction, sometimes after a stop to give way."""
        left = self.chance(0.5)
        if self.chance(0.35):
            self.stop(self.uniform(MIN_STOP_S, 6.0))
        far = left == (self._near_side < 0.0)
        radius = self.uniform(10.0, 16.0) if far else self.uniform(6.5, 10.0)
        angle = math.radians(self.uniform(70.0, 110.0))
        self.bend(radius, angle, 9.0, 1.0 if left else -1.0)

    def roundabout(self) -> None:
        """Add a roundabout: a turn towards the kerb, a turn around the island, and a turn towards
        the kerb again."""
        near = self._near_side
        radius = self.uniform(11.0, 20.0)
        if self.chance(0.3):
            self.stop(self.uniform(MIN_STOP_S, 4.0))
        self.bend(self.uniform(12.0, 20.0), math.radians(self.uniform(30.0, 45.0)), 9.0, near)
        around = math.radians(float(self._rng.choice([70.0, 170.0, 250.0])) + self.uniform(-15, 15))
        self.bend(radius, around, 9.0, -near)
        self.bend(self.uniform(12.0, 20.0), math.radians(self.uniform(30.0, 45.0)), 9.0, near)

    def reverse_manoeuvre(self) -> None:
        """Add a manoeuvre in reverse in a bend, with a stop before and after it."""
        self.stop(self.uniform(2.0, 5.0), 5.0)
        side, radius = self.side(), self.uniform(6.0, 12.0)
        length = self.uniform(5.0, 11.0)
        self.piece(
            length,
            self.uniform(1.2, 2.2),
            lambda share: side / radius * np.sin(np.pi * share) ** 2,
            stop_s=self.uniform(1.5, 4.0),
            direction=-1.0,
        )
        self.bend(self.uniform(7.0, 12.0), math.radians(self.uniform(30.0, 80.0)), 5.0, -side)

    def city_block(self) -> None:
        """Add a city block and the event at the end of the block."""
        speed = float(self._rng.choice([8.3, 13.9], p=[0.35, 0.65])) * self.uniform(0.88, 1.1)
        self.straight(self.uniform(70.0, 300.0), speed)
        if self.chance(0.30):
            self.bend(self.uniform(35.0, 200.0), self.uniform(0.15, 0.7), speed, self.side())
        if self.chance(0.12):
            self.lane_change(speed, self.side())
        if self.chance(0.25):
            self.straight(self.uniform(15.0, 50.0), speed * self.uniform(0.35, 0.75))
        self.straight(self.uniform(60.0, 240.0), speed)
        event = float(self._rng.random())
        if event < 0.26:
            self.stop(self.stop_time(), speed)
        elif event < 0.56:
            self.junction_turn()
        elif event < 0.64:
            self.roundabout()
        if self._route.reversing and self.chance(0.02):
            self.reverse_manoeuvre()

    def country_road(self, length: float) -> None:
        """Add a country road with bends. The road ends at a roundabout, a junction or a stop."""
        done = 0.0
        while done < length:
            speed = self.uniform(18.0, 27.0)
            straight = self.uniform(80.0, 450.0)
            self.straight(straight, speed, banked=True)
            radius, angle = self.uniform(90.0, 500.0), self.uniform(0.15, 0.9)
            self.bend(radius, angle, speed, self.side(), banked=True)
            if self.chance(0.2):
                self.straight(self.uniform(60.0, 200.0), speed * self.uniform(0.5, 0.8), True)
            done += straight + radius * angle
        event = float(self._rng.random())
        if event < 0.4:
            self.roundabout()
        elif event < 0.7:
            self.junction_turn()
        else:
            self.stop(self.stop_time(), 14.0)

    def motorway(self, length: float) -> None:
        """Add slip roads and a segment of motorway with lane changes and slow traffic."""
        near = self._near_side
        self.bend(self.uniform(45.0, 90.0), self.uniform(1.2, 3.5), 16.0, near, banked=True)
        done, cruise = 0.0, self.uniform(27.0, 34.0)
        self.straight(200.0, 24.0)
        self.lane_change(26.0, -near)
        while done < length:
            segment = self.uniform(300.0, 1200.0)
            self.straight(segment, cruise, banked=True)
            if self.chance(0.6):
                self.lane_change(cruise, self.side())
            if self.chance(0.6):
                angle = self.uniform(0.05, 0.35)
                self.bend(self.uniform(700.0, 2500.0), angle, cruise, self.side(), banked=True)
            if self.chance(0.25):
                slow = self.uniform(100.0, 500.0)
                self.straight(slow, cruise * self.uniform(0.45, 0.8), banked=True)
                segment += slow
            cruise = float(np.clip(cruise + self.uniform(-2.5, 2.5), 25.0, 35.0))
            done += segment
        self.lane_change(24.0, near)
        self.bend(self.uniform(45.0, 90.0), self.uniform(0.8, 2.0), 16.0, near, banked=True)


def build_path(route: DriveRoute, seed: int, duration_s: float) -> Path | None:
    """Return a path that takes at least duration_s; None for a parked vehicle."""
    builder = RouteBuilder(route, seed)
    if route.kind == "parked":
        return None
    if route.kind == "mixed":
        builder.straight(builder.uniform(15.0, 60.0), 8.3)
    while builder.least_time_s < duration_s or builder.is_empty:
        _KINDS[route.kind](builder, route)
    return builder.path()


def _mixed(builder: RouteBuilder, _route: DriveRoute) -> None:
    draw = builder.uniform(0.0, 1.0)
    for _ in range(round(builder.uniform(3.0, 7.0))):
        builder.city_block()
    if draw < 0.5:
        builder.country_road(builder.uniform(700.0, 2500.0))
    elif draw < 0.8:
        builder.motorway(builder.uniform(2000.0, 5500.0))


def _straight_only(builder: RouteBuilder, _route: DriveRoute) -> None:
    speed = builder.uniform(8.0, 22.0)
    builder.straight(builder.uniform(80.0, 300.0), speed)
    if builder.chance(0.4):
        builder.straight(builder.uniform(30.0, 80.0), speed * builder.uniform(0.4, 0.7))
    builder.stop(builder.stop_time(), speed)


def _circles(builder: RouteBuilder, route: DriveRoute) -> None:
    radius = route.circle_radius_m
    builder.piece(
        2.0 * math.pi * radius * 40.0,
        0.95 * math.sqrt(route.lateral_mps2[0] * radius) / route.speed_factor,
        lambda share: np.full(len(share), 1.0 / radius),
    )


_KINDS: dict[str, Callable[[RouteBuilder, DriveRoute], None]] = {
    "mixed": _mixed,
    "city": lambda builder, _route: builder.city_block(),
    "motorway": lambda builder, _route: builder.motorway(builder.uniform(20_000.0, 60_000.0)),
    "straight_only": _straight_only,
    "circles": _circles,
}
