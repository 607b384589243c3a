"""The diagnosis: show, name, extend, measure."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imucald.core.errors import ConfigError, EstimateError
from imucald.core.samples import Samples
from imucald.diagnosis.cause import Cause, Variant, catalogue
from imucald.diagnosis.faults import Fault, corrected, extend, find_faults, spoilt
from imucald.diagnosis.forward import Forward
from imucald.diagnosis.gain import gain_of, measure
from imucald.diagnosis.grid import track_from_samples
from imucald.diagnosis.keys import with_values
from imucald.diagnosis.pictures import pictures_of
from imucald.diagnosis.result import Diagnosis, Estimated, FoundCause, Structure
from imucald.diagnosis.roads import RoadFinding, find_roads, road_blocks
from imucald.diagnosis.sanity import against, refuse_unusable, rolling_s
from imucald.diagnosis.search import Search
from imucald.diagnosis.structure import find_structure
from imucald.diagnosis.structure_guard import standing
from imucald.diagnosis.trial import ACCEPT, Found
from imucald.diagnosis.vehicle_gain import mount_errors_deg
from imucald.diagnosis.verdict import look_alikes, losers_of, to_separate, verdict_of
from imucald.model.model import VehicleModel

Progress = Callable[[float, str], None]
BESIDE_ROADS = {"accel_bias": 40.0, "mount_rotation": 40.0, "mount_shift": 40.0}
OTHERS_BESIDE_ROADS = 20.0
"""Log posterior odds that a cause must have on roads that the model does not know: their waves are
longer than the stretches, and their means pass for another level, or for small scales."""
LITTLE_MIN = 10.0
"""With less driving a note says so."""
STEP_SHARE = 0.12
"""Share of the work by which progress moves on with each cause."""


def diagnose(
    drives: Sequence[Samples], model: VehicleModel, progress: Progress | None = None
) -> Diagnosis:
    """Say what the simulation with this model gets wrong beside measured drives of one vehicle.

    drives: SI samples, sensor axes (see `imucald.core.samples`); at least `accel` and `speed`, and
    minutes of them. Raises EstimateError where nothing can be diagnosed.
    """
    if not drives:
        raise EstimateError("diagnosis needs at least one drive")
    tell = progress or _silent
    tell(0.02, "samples and time stamps")
    faults = [_faults(samples, model) for samples in drives]
    causes = catalogue()
    forwards = [
        _forward(i, len(drives), samples, found, model)
        for i, (samples, found) in enumerate(zip(drives, faults, strict=True))
    ]
    names = forwards[0].names
    forwards = [f for f in forwards if f.names == names]
    refuse_unusable(forwards)
    wrong = against(forwards)
    stage = [0.1]

    def tick(text: str) -> None:
        stage[0] = min(stage[0] + STEP_SHARE, 0.8)
        tell(stage[0], text)

    tell(stage[0], "forward model and residuals")
    # Where a sign is wrong every cause would only be fitted to that.
    candidates = [] if wrong else [c for c in causes if not c.nuisance]
    search = Search(forwards, causes, candidates, tick)
    found = search.run()
    tell(0.85, "roads")
    roads = [] if wrong else find_roads(forwards, found.point.values)
    roads = [r for r in roads if r.score > ACCEPT]
    tell(0.88, "structure that is left")
    structure = tuple(wrong or find_structure(search, found))
    kept = standing(search, found, structure)
    if roads:
        kept = [
            v
            for v in kept
            if search.loss(found, v) >= BESIDE_ROADS.get(v.cause, OTHERS_BESIDE_ROADS)
        ]
    if len(kept) < len(found.active):
        found = search.refit(kept, found)
    tell(0.93, "gain")
    faulty = [f for part in faults for f in part]
    recorded = [Forward(track_from_samples(s), model, causes) for s in drives] if faulty else []
    told = _Told(search, found, faulty, roads, [f for f in recorded if f.names == names])
    diagnosis = told.diagnosis(model, structure, len(drives) - len(forwards))
    if not diagnosis.causes:
        return diagnosis
    tell(0.97, "what it is worth to the vehicle")
    try:
        before, after = mount_errors_deg(drives, model, diagnosis.model_after)
    except ConfigError as error:
        note = f"What it is worth to the vehicle is not known: the daemon refuses the {error}."
        return replace(diagnosis, notes=(*diagnosis.notes, note))
    gain = replace(diagnosis.gain, mount_error_deg_before=before, mount_error_deg_after=after)
    return replace(diagnosis, gain=gain)


def _silent(share: float, text: str) -> None:
    """Where no one asks for progress."""


def _faults(samples: Samples, model: VehicleModel) -> list[Fault]:
    return [fault for fault in find_faults(samples, model) if fault.score > ACCEPT]


def _forward(
    i: int, drives: int, samples: Samples, faults: Sequence[Fault], model: VehicleModel
) -> Forward:
    """The drive on the grid, without what is faulty, and what predicts it."""
    try:
        track = track_from_samples(corrected(samples, faults), spoilt(faults))
    except EstimateError as error:
        if drives == 1:
            raise
        raise EstimateError(f"drive {i + 1} of {drives}: {error}") from None
    return Forward(track, model, catalogue())


@dataclass
class _Told:
    """Puts the outcome together."""

    search: Search
    found: Found
    faults: list[Fault]
    roads: list[RoadFinding]
    recorded: list[Forward]
    """The drives with what is faulty in them; empty where nothing is."""

    def diagnosis(
        self, model: VehicleModel, structure: tuple[Structure, ...], absent: int
    ) -> Diagnosis:
        search, found = self.search, self.found
        by_name: Mapping[str, Cause] = {c.name: c for c in catalogue()}
        sets, candidates = look_alikes(search, found)
        told = [self._of_variant(v, by_name) for v in found.active]
        told += [self._of_road(r, by_name) for r in self.roads]
        told += [self._of_fault(fault) for fault in self.faults]
        told = _merged(told)
        scores = {c.name: c.evidence["log_bayes_factor"] for c in told}
        after = self._extended(model, by_name)
        road = road_blocks(search.forwards, self.roads)
        gain, signals = measure(search, found, road, self.recorded)
        return Diagnosis(
            verdict=verdict_of(scores, sets, structure),
            causes=tuple(sorted(told, key=lambda c: -c.evidence["log_bayes_factor"])),
            look_alikes=tuple(sets),
            to_separate=to_separate(sets, by_name),
            signals=signals,
            gain=gain,
            duration_s=float(sum(f.track.duration_s for f in search.forwards)),
            candidates=(*candidates, *losers_of(search, found)),
            structure=structure,
            notes=tuple(self._notes(absent)),
            pictures=pictures_of(search, found, self.roads),
            model_before=model,
            model_after=after,
        )

    def _of_variant(self, variant: Variant, by_name: Mapping[str, Cause]) -> FoundCause:
        search, found = self.search, self.found
        cause = by_name[variant.cause]
        values, std = found.point.values, search.std(found, variant.keys)
        lost = search.loss(found, variant)
        sigma = max(abs(values[k] - search.base[k]) / std[k] for k in variant.keys)
        parameters = cause.report(values, std, variant.keys)
        shown = ", ".join(f"{k} {_plain(p)}" for k, p in parameters.items())
        return FoundCause(
            name=cause.name,
            parameters=parameters,
            signals=tuple(s for s in cause.signals if s in search.forwards[0].names),
            evidence={
                "log_bayes_factor": lost,
                "probability": float(1.0 / (1.0 + np.exp(-min(lost, 50.0)))),
                "sigma": sigma,
            },
            gain={"held_out_log_likelihood": gain_of(search, found, variant.keys)},
            text=f"{cause.sentence} {shown}.",
        )

    def _of_road(self, road: RoadFinding, by_name: Mapping[str, Cause]) -> FoundCause:
        cause = by_name[road.cause]
        return FoundCause(
            name=road.cause,
            parameters={road.key: Estimated(road.rms, road.std, "1")},
            signals=tuple(s for s in cause.signals if s in self.search.forwards[0].names),
            evidence={
                "log_bayes_factor": road.score,
                "probability": float(1.0 / (1.0 + np.exp(-min(road.score, 50.0)))),
                "sigma": abs(road.rms - road.declared) / road.std,
                "coherence": road.coherence,
            },
            gain={"held_out_log_likelihood": 0.0},
            text=f"{cause.sentence} rms {road.rms:.2%}, the model says {road.declared:.2%}.",
        )

    def _of_fault(self, fault: Fault) -> FoundCause:
        names = self.search.forwards[0].names
        touched = tuple(s for s in names if s == fault.signal or s[:-2] == fault.signal)
        return FoundCause(
            name=fault.cause,
            parameters=fault.parameters,
            signals=touched or (fault.signal,),
            evidence={
                "log_bayes_factor": fault.score,
                "probability": float(1.0 / (1.0 + np.exp(-min(fault.score, 50.0)))),
            },
            gain={"held_out_log_likelihood": 0.0},
            text=fault.text,
        )

    def _extended(self, model: VehicleModel, by_name: Mapping[str, Cause]) -> VehicleModel:
        after = model
        for variant in self.found.active:
            after = by_name[variant.cause].extend(after, self.found.point.values, variant.keys)
        for road in self.roads:
            after = with_values(after, {road.key: road.rms})
            after = after.with_changes({f"road.{road.cause.split('_')[1]}": True})
        return extend(after, self.faults)

    def _notes(self, absent: int) -> list[str]:
        notes = []
        names = self.search.forwards[0].names
        scalars = self.search.forwards[0].track.scalars
        if "gyro_x" not in names:
            notes.append("No gyroscope: what leans and what pulls cannot be told apart.")
        if "yaw_rate" not in names:
            notes.append("No steering angle beside a yaw rate: handling was not examined.")
        if "temperature" not in scalars:
            notes.append("No temperature: drift with it was not examined.")
        if absent:
            notes.append(f"{absent} drive(s) with other signals than the first were left out.")
        minutes = rolling_s(self.search.forwards) / 60.0
        if minutes < LITTLE_MIN:
            notes.append(f"Only {minutes:.1f} min of driving: small errors do not show in that.")
        top = min(f.track.top_hz for f in self.search.forwards)
        notes.append(f"Compared up to {top:.2g} Hz, which the slowest input carries.")
        return notes


def _merged(told: Sequence[FoundCause]) -> list[FoundCause]:
    """One entry per cause, also where several signals have it."""
    merged: dict[str, FoundCause] = {}
    for one in told:
        said, before = one, merged.get(one.name)
        if before is not None:
            said = replace(
                said,
                parameters={**before.parameters, **said.parameters},
                signals=tuple(dict.fromkeys((*before.signals, *said.signals))),
                text=before.text if before.text == said.text else f"{before.text} {said.text}",
                evidence=max(before.evidence, said.evidence,
                             key=lambda e: e["log_bayes_factor"]),
                gain={k: v + before.gain.get(k, 0.0) for k, v in said.gain.items()},
            )  # fmt: skip
        merged[said.name] = said
    return list(merged.values())


def _plain(p: Estimated) -> str:
    return f"{p.value:.4g} +- {p.std:.2g} {'' if p.unit == '1' else p.unit}".strip()
