"""What a configuration that was read again leaves as it is."""

from __future__ import annotations

from dataclasses import replace

from imucald.config import LoadedConfig
from imucald.mount.estimate import MountEstimator
from imucald.mount.restored import RestoredEstimator
from imucald.runtime.engine import Engine
from imucald.service.calibration_store import saved_information, saved_state, stored_mount


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


def estimates_alike(old: LoadedConfig, new: LoadedConfig) -> bool:
    """Whether the running estimator is the one that the new configuration would make."""
    a, b = old.config, new.config
    return (a.calibration, a.vehicle, a.signals) == (b.calibration, b.vehicle, b.signals)


def behind_the_known(old: MountEstimator, new: MountEstimator) -> MountEstimator:
    """The new estimator, with what the old one knows in front of it as restored."""
    if old.correction is None:
        return new
    saved = saved_state(old, 0.0, 0.0)
    if saved is None:
        return new
    if saved.state not in ("usable", "fine"):
        saved = replace(saved, state="usable", doubted=saved.state != "restored")
    return RestoredEstimator(new, stored_mount(saved, saved_information(old)))
