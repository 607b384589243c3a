"""Orders of people about the mount: reset, hold, release, set, and the calibration by a diagnostic
tester.

The control socket and the diagnostics on the bus use the same implementation. Every order is logged
with the person who gave it. Nothing here opens a file: the service stores the results.
"""

from __future__ import annotations

from typing import Final, Protocol

import numpy as np

from imucald.config import LoadedConfig
from imucald.config.calibration import KnownMount
from imucald.core.angles import DEG_PER_RAD
from imucald.core.errors import EstimateError, ImucaldError
from imucald.mount.estimate import MountEstimator
from imucald.mount.mount_in_force import held, released, without_stored
from imucald.mount.restored import RestoredEstimator
from imucald.runtime.engine import Engine
from imucald.runtime.estimators import against_orientation, known_mount

TESTER: Final = "a tester on the bus"

FirstTimes = tuple[float | None, float | None]
"""Stream times [s] at which a mount first became usable and first became fine; None if it did
not."""


class OrderError(ImucaldError):
    """An order that cannot be carried out now; the text gives the reason and the remedy."""


class OrderedService(Protocol):
    """The service that runs the calibration. A reload replaces its engine and its configuration."""

    @property
    def engine(self) -> Engine:
        """The engine that runs now."""
        ...

    @property
    def loaded(self) -> LoadedConfig:
        """The present configuration."""
        ...

    def forget_state(self) -> str:
        """Forget the saved state. Return the reason if the disk cannot be changed now, or ""."""
        ...

    def save_state(self) -> str:
        """Save the present mount, also if it is held. Return the reason if the disk cannot be
        written, or ""."""
        ...

    def log_order(self, who: str, text: str) -> None:
        """Log an order and the person who gave the order."""
        ...


class MountOrders:
    """Carries out orders. In all methods, `who` is a text about the person who gave the order
    ("root (pid 812)")."""

    def __init__(self, service: OrderedService) -> None:
        self._service = service
        self._former: tuple[object, MountEstimator, FirstTimes] | None = None

    @property
    def is_held(self) -> bool:
        """True if the mount is held and nothing is learnt."""
        return self._held is not None

    @property
    def _held(self) -> RestoredEstimator | None:
        estimator = self._estimator
        is_held = isinstance(estimator, RestoredEstimator) and estimator.is_held
        return estimator if is_held else None  # type: ignore[return-value]

    @property
    def _estimator(self) -> MountEstimator:
        return self._service.engine.pipeline.estimator

    def reset(self, who: str) -> str:
        """Forget the learnt mount and the saved mount, and start again. The order cannot be
        undone."""
        self._former = None
        self._service.engine.restart_calibration()
        not_yet = self._service.forget_state()
        stated = self._service.loaded.config.calibration.mount is not None
        begun = "started again from the mount of the configuration" if stated else "started again"
        text = f"reset: the learnt mount is forgotten; the calibration {begun}"
        return self._logged(who, text + _not_on_the_disk(not_yet))

    def hold(self, who: str) -> str:
        """Hold the present mount: the estimator does not change it. Raises OrderError if there is
        no mount."""
        if self.is_held:
            raise OrderError("the mount is held already")
        kept = held(self._estimator)
        if kept is None:
            state = self._estimator.state.name.lower()
            text = f"there is no mount to hold yet (state {state}): drive until it is usable"
            raise OrderError(f"{text}, or state the mount (imucald set-mount)")
        text = (
            "hold: the mount is kept and nothing is learnt until the hold is released "
            "(imucald release)"
        )
        return self._logged(who, text + _not_saved(self._put(kept)))

    def release(self, who: str) -> str:
        """End the hold of the mount: the estimator may change it again. Raises OrderError if no
        mount is held, or if the configuration holds the mount.
        """
        kept = self._held
        if kept is None:
            raise OrderError("the mount is not held: it is being learnt")
        self._refuse_where_configured()
        not_yet = self._put(released(kept, self._learning()))
        return self._logged(who, "release: the mount is learnt again" + _not_saved(not_yet))

    def set_mount(self, mount: KnownMount, who: str) -> str:
        """Use a mount that a person states. Raises OrderError if its deviations are too large."""
        self._refuse_where_configured()
        if (text := against_orientation(mount, self._service.loaded.config)) is not None:
            raise OrderError(f"this mount {text}")
        learning = self._learning()
        try:
            stored = known_mount(mount, learning.estimate().targets)
        except EstimateError as error:
            raise OrderError(f"a standard deviation of {error}") from None
        not_yet = self._service.forget_state()
        not_saved = self._put(RestoredEstimator(learning, stored, is_held=mount.hold))
        x, y, z = (2.0 * float(s) * DEG_PER_RAD for s in np.sqrt(np.diag(stored.covariance)))
        angles = f"roll {mount.roll_deg:+g}, pitch {mount.pitch_deg:+g}, yaw {mount.yaw_deg:+g} deg"
        within = f"±{x:.2g}, ±{y:.2g}, ±{z:.2g} deg (95 %) about the vehicle's x, y, z"
        end = "and held" if mount.hold else "until the drive confirms it"
        text = f"set-mount: {angles}, {within}, in force {end}"
        return self._logged(who, text + (_not_on_the_disk(not_yet) or _not_saved(not_saved)))

    # a tester's calibration, which can be taken back ----------------------------------------

    def begin(self, who: str) -> None:
        """Start the calibration again, and keep the former estimator for `return_to_former`."""
        pipeline = self._service.engine.pipeline
        first = pipeline.first_usable, pipeline.first_fine
        self._former = self._settings(), self._service.engine.restart_calibration(), first
        self._logged(who, "the calibration is started again")

    def return_to_former(self, who: str) -> bool:
        """Use the former estimator again. Return False if there is none, or if the settings have
        changed since then."""
        if self._former is None or self._former[0] != self._settings():
            return False
        _, estimator, first = self._former
        self._service.engine.resume_calibration(estimator)
        pipeline = self._service.engine.pipeline
        pipeline.first_usable, pipeline.first_fine = first
        self._former = None
        self._logged(who, "the former calibration is in use again")
        return True

    def accept(self) -> None:
        """Drop the former estimator."""
        self._former = None

    # ----------------------------------------------------------------------------------------

    def _settings(self) -> object:
        """Return all settings that an estimator depends on. A reload of the file may change these
        settings."""
        config = self._service.loaded.config
        return config.signals, config.calibration, config.vehicle

    def _learning(self) -> MountEstimator:
        return without_stored(self._service.engine.new_estimator())

    def _put(self, estimator: MountEstimator) -> str:
        """Replace the estimator. Return the reason if the new mount cannot be saved now, or ""."""
        self._former = None
        self._service.engine.pipeline.replace(estimator)
        return self._service.save_state()

    def _refuse_where_configured(self) -> None:
        mount = self._service.loaded.config.calibration.mount
        if mount is not None and mount.hold:
            file = self._service.loaded.path
            text = f"{file} states the mount and holds it ('calibration: mount: hold: true')"
            raise OrderError(
                f"{text}; change it in the file, then reload (systemctl reload imucald@can0, "
                "or SIGHUP)"
            )

    def _logged(self, who: str, text: str) -> str:
        self._service.log_order(who, text)
        return text


def _not_on_the_disk(reason: str) -> str:
    return _unsaved(reason, "bring the former mount back", "remove the saved state")


def _not_saved(reason: str) -> str:
    return _unsaved(reason, "undo this order", "save it")


def _unsaved(reason: str, danger: str, remedy: str) -> str:
    if not reason:
        return ""
    text = f"; NOT SAVED YET ({reason}): a restart would {danger}"
    return f"{text}. imucald tries to {remedy} every 10 s"
