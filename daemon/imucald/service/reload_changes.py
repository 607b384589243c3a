"""What a configuration that was read again leaves as it is."""

from __future__ import annotations

from imucald.config import LoadedConfig
from imucald.mount.estimate import MountEstimator
from imucald.mount.estimator import FullEstimator
from imucald.mount.mount_in_force import mount_in_force, without_stored
from imucald.mount.restored import RestoredEstimator
from imucald.runtime.engine import Engine
from imucald.service.service_options import ServiceOptions


def listens_otherwise(
    old: LoadedConfig, new: LoadedConfig, old_engine: Engine, new_engine: Engine
) -> bool:
    """Whether another bus, other inputs or other outputs are configured."""
    return (
        old.config.bus != new.config.bus
        or old.config.diagnostics != new.config.diagnostics
        or set(old_engine.router.matches) != set(new_engine.router.matches)
        or old_engine.output.can_ids != new_engine.output.can_ids
    )


def is_same_bus(old: LoadedConfig, new: LoadedConfig, options: ServiceOptions) -> bool:
    """Whether the same bus is listened to: on another one sits another sensor."""

    def names(loaded: LoadedConfig) -> tuple[str, str]:
        bus = loaded.config.bus
        return options.interface or bus.interface, options.channel or bus.channel

    return names(old) == names(new)


def keeps_estimator(
    old: LoadedConfig, new: LoadedConfig, old_engine: Engine, new_engine: Engine
) -> bool:
    """Whether the running estimator is the one that the new configuration would make.

    Not where a database gives a signal another meaning: what is known of the sensor's health is
    then of another one, and nothing is good before this one has been seen. Limits of what is
    believed change no number, and take nothing from what was learnt, standing faults among it.
    """
    a, b = old.config, new.config
    before, now = old_engine.router, new_engine.router
    is_same = (a.calibration, a.vehicle) == (b.calibration, b.vehicle)
    return is_same and now.same_sources(before) == before.channels | now.channels


def keeps_consumers(
    old: LoadedConfig, new: LoadedConfig, old_engine: Engine, new_engine: Engine
) -> bool:
    """Whether what runs next to the calibration is what the new configuration would make."""
    a, b = (
        (c.attitude, c.travel_direction, c.signals, c.output.ids, c.output.checksum)
        for c in (old.config, new.config)
    )
    return a == b and old_engine.model_key == new_engine.model_key


def take_usual_signals(old: Engine, estimator: MountEstimator, new: Engine) -> None:
    """Let a new estimator know how long signals that stay usually keep a value.

    One that is stuck since before the reload would never show it.
    """
    former, made = without_stored(old.pipeline.estimator), without_stored(estimator)
    if made is not former and isinstance(former, FullEstimator) and isinstance(made, FullEstimator):
        made.take_usual_signals(former, new.router.same_sources(old.router))


def behind_the_known(old: MountEstimator, new: MountEstimator) -> MountEstimator:
    """The new estimator, with what the old one knows in front of it as restored; held as it was."""
    stored = mount_in_force(old)
    if stored is None:
        return new
    is_held = isinstance(old, RestoredEstimator) and old.is_held
    return RestoredEstimator(without_stored(new), stored, is_held)
