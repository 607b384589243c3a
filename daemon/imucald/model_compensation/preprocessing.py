"""All corrections by a model file in one engine: samples, columns and ticks, with counts of refused
samples."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from imucald.core.arrays import Array
from imucald.inputs.column_samples import ColumnSamples, Routed
from imucald.inputs.router import Sample
from imucald.model.section import Vector3
from imucald.model_compensation.lever_arm_and_suspension import Corrected, VehicleCorrection
from imucald.model_compensation.sensors import SensorCorrection
from imucald.model_compensation.tick_preprocessing import TickPreprocessing

REFUSED = "out_of_range"
"""Reason under which refused samples are counted."""


@dataclass
class PreprocessingChain:
    """Removes the known errors of the model file, between router and output.

    name: name of the model file. estimate_key: equal keys give equal estimates of the mount.
    vehicle, ticks: corrections; None for a correction that changes no signal. used: names of the
    terms that are removed. notes: parts of the model file that are not used.
    """

    name: str
    estimate_key: str
    sensors: SensorCorrection
    vehicle: VehicleCorrection | None
    ticks: TickPreprocessing | None
    used: tuple[str, ...]
    notes: tuple[str, ...]

    def is_like(self, other: PreprocessingChain) -> bool:
        """True if both objects change the same signals in the same way."""
        mine = self.name, self.estimate_key, self.used, self.notes
        return mine == (other.name, other.estimate_key, other.used, other.notes)

    def words(self) -> str:
        """Return one line of text with the model file and the terms that are removed."""
        return f"model {self.name}: corrects {', '.join(self.used) or 'nothing'}"

    def summary(self) -> dict[str, Any]:
        """Return the model file and the removed terms as plain data for JSON."""
        return {
            "file": self.name,
            "taken_out": list(self.used),
            "not_used": list(self.notes),
        }

    def gap(self) -> None:
        """Restart after a jump of time. The pipeline itself restarts the ticks."""
        self.sensors.gap()
        if self.vehicle is not None:
            self.vehicle.gap()

    # one frame -----------------------------------------------------------------------------

    def frame(
        self, t: float, samples: list[Sample], rejected: Counter[str]
    ) -> tuple[list[Sample], list[str]]:
        """Return the samples of one frame without the known errors, and the channels with a refused
        sample."""
        if not samples:
            return samples, []
        out, refused = self.sensors.frame(t, samples)
        if refused:
            rejected[REFUSED] += len(refused)
        return out, refused

    def corrected(self, t: float, turned: dict[str, Vector3 | None]) -> dict[str, Vector3 | None]:
        """Return the corrected samples of one frame, in vehicle axes."""
        return turned if self.vehicle is None else self.vehicle.frame(t, turned)

    # columns -------------------------------------------------------------------------------

    def columns(self, routed: Routed, t: Array, rejected: Counter[str]) -> Routed:
        """Return columns of samples without the known errors. t: stream times of all rows [s]."""
        order = {channel: series.row for channel, series in routed.samples.items()}
        taken = self.sensors.columns(routed.samples, order)
        if not taken:
            return routed
        samples = dict(routed.samples)
        rows, values = dict(routed.rejected), dict(routed.rejected_values)
        events = [routed.events]
        for channel, one in taken.items():
            series, good = routed.samples[channel], ~one.refused
            if good.all():
                samples[channel] = ColumnSamples(series.t, one.values, series.row)
                continue
            bad = series.row[one.refused]
            rejected[REFUSED] += len(bad)
            events.append(t[bad])
            for of in (rows, values):
                of[channel] = np.sort(np.concatenate([of.get(channel, bad[:0]), bad]))
            samples[channel] = ColumnSamples(series.t[good], one.values[good], series.row[good])
            if not good.any():
                del samples[channel]
        return Routed(samples, rows, values, np.sort(np.concatenate(events)))

    def corrected_columns(
        self, samples: Mapping[str, ColumnSamples], turned: Mapping[str, Array]
    ) -> dict[str, Array]:
        """Return corrected samples (N, 3) by channel, in vehicle axes."""
        if self.vehicle is None:
            return dict(turned)
        columns = {c: Corrected(s.row, s.t, turned[c]) for c, s in samples.items()}
        return self.vehicle.columns(columns)
