"""What a configuration that was read again leaves as it is."""

from __future__ import annotations

from imucald.config import LoadedConfig
from imucald.mount.estimate import MountEstimator
from imucald.mount.mount_in_force import mount_in_force, without_stored
from imucald.mount.restored import RestoredEstimator
from imucald.runtime.engine import Engine
from imucald.service.identity import sensor_sources


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


def keeps_estimator(old: LoadedConfig, new: LoadedConfig) -> bool:
    """Whether the running estimator is the one that the new configuration would make."""
    a, b = old.config, new.config
    return (a.calibration, a.vehicle, a.signals) == (b.calibration, b.vehicle, b.signals)


def keeps_sensors(
    old: LoadedConfig, new: LoadedConfig, old_engine: Engine, new_engine: Engine
) -> bool:
    """Whether all signals come from where they came, and the sensors' mean what they meant."""
    before, now = (
        sensor_sources(loaded.config.signals, engine.router)
        for loaded, engine in ((old, old_engine), (new, new_engine))
    )
    return old.config.signals == new.config.signals and before == now


def behind_the_known(old: MountEstimator, new: MountEstimator) -> MountEstimator:
    """The new estimator, with what the old one knows in front of it as restored; held as it was."""
    stored = mount_in_force(old)
    if stored is None:
        return new
    is_held = isinstance(old, RestoredEstimator) and old.is_held
    return RestoredEstimator(without_stored(new), stored, is_held)
