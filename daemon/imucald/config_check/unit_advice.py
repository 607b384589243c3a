"""Advice about a wrong unit if the configuration already states a unit."""

from __future__ import annotations

from collections.abc import Iterable

from imucald.config_check.source import QuantitySource


def unit_advice(sources: Iterable[QuantitySource]) -> dict[str, str]:
    """Return advice for each quantity with a stated unit: the stated unit, the unit in the
    database, and the remedy. The keys are names of axes and of sensors in the configuration, such
    as "accelerometer.x" and "accelerometer".
    """
    made: dict[str, str] = {}
    for source in sources:
        unit = source.wanted.source.unit
        if unit is None:
            continue
        advice = f"'unit: {unit}' is set: correct it"
        if source.signal is not None and source.signal.unit not in ("", unit):
            database = source.signal.unit
            advice = (
                f"'unit: {unit}' is set: remove it (the unit in the database is {database}) "
                "or correct it"
            )
        parts = source.quantity.split(".")
        for i in range(len(parts)):
            made.setdefault(".".join(parts[: i + 1]), advice)
    return made
