"""Build an engine from a configuration: router, estimator and output frames."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from msgspec.structs import asdict, astuple, replace

from imucald.can.columns import CAN_EFF_MASK
from imucald.config import LoadedConfig, load_config
from imucald.core.errors import ConfigError, EstimateError
from imucald.inputs.router import Router
from imucald.inputs.wiring import compile_router
from imucald.mount.estimate import MountEstimator
from imucald.runtime.engine import Engine
from imucald.runtime.estimators import against_orientation, estimator_for
from imucald.runtime.input_health import LinkHealth
from imucald.runtime.output.output_frames import OutputFrames
from imucald.runtime.pipeline import Snapshot
from imucald.runtime.segment_samples import SegmentSamples

if TYPE_CHECKING:
    from imucald.model_compensation import ModelCompensation
    from imucald.runtime.consumer import Consumer


def open_config(path: Path, databases: Sequence[Path] = ()) -> LoadedConfig:
    """Load a configuration. `databases` replace the databases that the configuration names. Raises
    ConfigError."""
    loaded = load_config(path)
    if not databases:
        return loaded
    if len(databases) != len(loaded.config.database):
        raise ConfigError(
            f"{path} names {len(loaded.config.database)} database(s), but "
            f"{len(databases)} are given with --database"
        )
    entries = tuple(
        replace(entry, path=str(database.resolve()))
        for entry, database in zip(loaded.config.database, databases, strict=True)
    )
    return loaded.with_databases(entries)


def make_engine(
    loaded: LoadedConfig,
    on_snapshot: Callable[[Snapshot], None] | None = None,
    link_health: Callable[[], LinkHealth] = LinkHealth,
    on_samples: Callable[[SegmentSamples], None] | None = None,
) -> Engine:
    """Return the engine of a configuration. Raises ConfigError with the place of a mistake."""
    config = loaded.config
    router = compile_router(loaded)
    output = OutputFrames(config)
    _refuse_shared_ids(loaded, output, router)
    if (text := against_orientation(config.calibration.mount, config)) is not None:
        raise loaded.error(("calibration", "mount"), text)
    compensation = open_compensation(loaded)
    stated = loaded.keys_in("vehicle")

    def new_estimator() -> MountEstimator:
        try:
            return estimator_for(config, compensation, stated)
        except EstimateError as error:
            raise loaded.error(("calibration", "mount", "std_deg"), str(error)) from None

    rates = [
        f"parallel/{p.name}" for p in config.signals.parallel if p.kind == "angular_rate" and p.z
    ]
    derived = config.signals.speed is None
    return Engine(
        router,
        new_estimator,
        output,
        config.output.status_rate,
        on_snapshot,
        link_health,
        _consumers(loaded, output, router.resolution("gyro")),
        None
        if compensation is None
        else compensation.preprocessing_chain(router.channels, derived, rates),
        on_samples,
    )


def _consumers(loaded: LoadedConfig, output: OutputFrames, gyro_step: float) -> list[Consumer]:
    """Return the consumers of the configuration (such as the attitude).

    Raises ConfigError if an input is missing.
    """
    if output.attitude is None and output.travel is None:
        return []
    from imucald.runtime.consumers import consumers_for  # noqa: PLC0415 - few switch one on

    return consumers_for(loaded, output, gyro_step)


def open_compensation(loaded: LoadedConfig) -> ModelCompensation | None:
    """Read the configuration's model file, if it names one. Raises ConfigError."""
    path, model = loaded.model_path, loaded.config.model
    if path is None or model is None:
        return None
    from imucald.model_compensation import compensation_from_model  # noqa: PLC0415 - 20 ms, not without a model

    if not path.is_file():
        raise loaded.error(("model",), f"{path}: there is no such file")
    found = compensation_from_model(path, model.compensate_suspension)
    return found.with_speed_delay(loaded.config.calibration.speed_delay)


def _refuse_shared_ids(loaded: LoadedConfig, output: OutputFrames, router: Router) -> None:
    taken = dict.fromkeys(astuple(loaded.config.output.ids), "an output frame")
    for index, sensor in enumerate(loaded.config.signals.parallel):
        if sensor.id in taken:
            text = f"0x{sensor.id:X} is already the id of {taken[sensor.id]}; choose another id"
            raise loaded.error(("signals", "parallel", index, "id"), text)
        taken[sensor.id] = f"parallel sensor {sensor.name}"
    ids = asdict(loaded.config.output.ids)
    names = {can_id: f"output '{name}'" for name, can_id in ids.items()}
    names |= {one.id: f"output of '{one.name}'" for one in loaded.config.signals.parallel}
    for can_id in sorted(output.can_ids):
        for route in router.routes:
            if (can_id ^ route.match.can_id) & route.match.full_mask:
                continue
            number = can_id & CAN_EFF_MASK
            mine = names.get(number, "an output frame")
            text = f"0x{number:X} is {mine} and also input message {route.name}: choose another id"
            raise loaded.error(("output", "ids"), text)
