"""Read the corrected frames on a bus. All checks that docs/output-frames.md requires are made."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from imucald.can.columns import CAN_EFF_FLAG, CAN_EFF_MASK, CAN_SFF_MASK, IdMatch
from imucald.can.e2e.protection import MessageChecker
from imucald.config import Config, LoadedConfig
from imucald.core.angles import DEG_PER_RAD
from imucald.core.errors import DecodeError
from imucald.inputs.wiring import compile_router
from imucald.runtime.output.output_frames import OutputFrames

Triple = tuple[float, float, float]
Attitude = tuple[float, float, float | None]

STALE_S = 0.5
"""Time without a good frame after which a value counts as not available [s]: five periods of 10
Hz."""
RESTORED, USABLE, FINE = 1, 2, 3
GOOD = frozenset({USABLE, FINE})
"""Qualities of frames whose values are sent to receivers."""
CHANNELS = {"accel": "acceleration", "gyro": "angular_rate"}
"""Channels of the engine, and their names in a feed."""
ATTITUDE = "attitude"


class VectorMeans:
    """The means of vectors since the last call of `means`, by name."""

    def __init__(self, names: Iterable[str]) -> None:
        self._sums: dict[str, list[float]] = {name: [0, 0.0, 0.0, 0.0] for name in names}
        self._lowest: dict[str, int] = {}
        self.quality: dict[str, int] = {}
        """Lowest quality among the vectors in each mean, by name."""
        self._newest: dict[str, Triple] = {}
        self._times = dict.fromkeys(self._sums, float("-inf"))
        self._ended: set[str] = set()

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the vectors: "acceleration", "angular_rate"."""
        return tuple(self._sums)

    def add_vector(self, name: str, t: float, values: Sequence[float], quality: int = 0) -> None:
        """Add a good vector at time t [s] (same clock as for `means`)."""
        n, x, y, z = self._sums[name]
        self._lowest[name] = min(quality, self._lowest[name]) if n else quality
        self._sums[name] = [n + 1, x + values[0], y + values[1], z + values[2]]
        self._times[name] = t
        self._ended.discard(name)

    def end(self, name: str) -> None:
        """Register that the sender marked a vector as not available."""
        self._newest.pop(name, None)
        self._ended.add(name)

    def means(self, now: float) -> Mapping[str, Triple | None]:
        """Return the means since the last call, by name; None means not available.

        If no vector arrived since the last call, the previous mean is returned until it is too old
        or `end` is called.
        """
        for name, (n, x, y, z) in self._sums.items():
            if n:
                self._newest[name] = x / n, y / n, z / n
                self.quality[name] = self._lowest[name]
            self._sums[name] = [0, 0.0, 0.0, 0.0]
        found = {
            name: self._newest.get(name) if now - t <= STALE_S else None
            for name, t in self._times.items()
        }
        for name in self._ended:
            self._newest.pop(name, None)
        return found


class CorrectedFrames(VectorMeans):
    """Means of the corrected samples in m/s^2 and deg/s, and the newest attitude.

    accepted: accepted qualities; frames with other qualities are ignored. Checksum, counter, length
    and *not available* are checked.
    """

    def __init__(self, config: Config, accepted: Iterable[int] = GOOD) -> None:
        output = OutputFrames(config)
        self._accepted = frozenset(accepted)
        messages = {
            name: output.message_of(channel)
            for channel, name in CHANNELS.items()
            if channel in output.triads
        }
        super().__init__(messages)
        if output.attitude is not None:
            messages[ATTITUDE] = output.attitude.angles
        self._by_id = {
            message.can_id: (name, message, MessageChecker(message.protection))
            for name, message in messages.items()
        }
        self._attitude: tuple[float, Attitude] = (float("-inf"), (0.0, 0.0, None))

    @property
    def matches(self) -> list[IdMatch]:
        """Filters of the wanted frames."""
        return [IdMatch(i, CAN_EFF_MASK if i & CAN_EFF_FLAG else CAN_SFF_MASK) for i in self._by_id]

    def take_frame(self, t: float, can_id: int, data: bytes) -> None:
        """Process a frame that was received at t [s]. The clock must be the same as for `means`."""
        if can_id not in self._by_id:
            return
        name, message, checker = self._by_id[can_id]
        if checker.check(t, data) is not None:
            return
        try:
            x, y, z, quality = message.values(data)
        except DecodeError:
            return
        if name == ATTITUDE:
            if x is not None and y is not None:
                self._attitude = t, (x, y, z)
        elif (
            x is None or y is None or z is None or quality is None or quality not in self._accepted
        ):
            self.end(name)
        else:
            self.add_vector(name, t, (x, y, z), int(quality))

    def attitude(self, now: float) -> Attitude | None:
        """Return roll, pitch and heading [deg] of the vehicle; None means not available."""
        t, angles = self._attitude
        return angles if now - t <= STALE_S else None


class RawSamples(VectorMeans):
    """Means of the raw samples, in the sensor's own axes, in m/s^2 and deg/s.

    Raises ConfigError if the databases of the configuration cannot be read.
    """

    def __init__(self, loaded: LoadedConfig) -> None:
        self._router = compile_router(loaded)
        there = self._router.channels
        super().__init__(name for channel, name in CHANNELS.items() if channel in there)

    @property
    def matches(self) -> list[IdMatch]:
        """Filters of the wanted frames."""
        return self._router.matches

    def take_frame(self, t: float, can_id: int, data: bytes) -> None:
        """Process a frame that was received at t [s]. The clock must be the same as for `means`."""
        for channel, values in self._router.frame(t, can_id, data)[0]:
            if channel == "accel":
                self.add_vector(CHANNELS[channel], t, values)
            elif channel == "gyro":
                self.add_vector(CHANNELS[channel], t, [v * DEG_PER_RAD for v in values])
