"""A signal that comes later than the model file says."""

from __future__ import annotations

from collections.abc import Sequence

from imucald.diagnosis.cause import Cause, Parameter, Values, Variant
from imucald.diagnosis.state import State
from imucald.model.model import VehicleModel

INPUTS = ("speed", "steering", "yaw_rate")
OUTPUTS = ("accel", "gyro", "lateral_accel", "longitudinal_accel", "yaw_rate")
NAMES = ("accel", "gyro", "speed", "steering", "yaw_rate", "lateral_accel", "longitudinal_accel")


class SignalDelay(Cause):
    """The frame carries the value of `delay_s` ago."""

    name = "signal_delay"
    parameters = tuple(
        Parameter(f"{name}.delay_s", "s", 0.008, 0.2, 1e-4, -0.8, 2.0, share=0.1, floor=1.2)
        for name in NAMES
    )
    signals = (
        "accel_x", "accel_y", "gyro_x", "gyro_y", "gyro_z", "yaw_rate", "lateral_accel",
        "longitudinal_accel",
    )  # fmt: skip
    seen_by = "brake and steer abruptly several times"
    sentence = "A signal is late against the others."

    def variants(self) -> Sequence[Variant]:
        """One signal late, or both of the inertial sensor's."""
        single = [Variant(self.name, name, (f"{name}.delay_s",)) for name in NAMES]
        return (*single, Variant(self.name, "accel and gyro", ("accel.delay_s", "gyro.delay_s")))

    def inputs(self, s: State, p: Values) -> None:
        """Shift inputs to the time that they speak of."""
        for name in (*INPUTS, "gyro"):
            s.advance[name] = p[f"{name}.delay_s"]

    def response(self, s: State, p: Values) -> None:
        """Delay what is predicted."""
        for name in OUTPUTS:
            if p[f"{name}.delay_s"]:
                s.filtered(name, s.spectrum.delay(p[f"{name}.delay_s"]))

    def extend(self, model: VehicleModel, p: Values, keys: Sequence[str]) -> VehicleModel:
        """Return the model with the delays; what would come early makes all others late."""
        moved = {key: p[key] for key in keys}
        early = max(0.0, *(-value for value in moved.values()))
        changes = {f"{name}.delay_s": getattr(model, name).delay_s + early for name in NAMES}
        changes |= {key: value + early for key, value in moved.items()}
        return model.with_changes(changes)
