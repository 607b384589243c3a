"""`imucald.diagnose`: compare the simulation with measured drives and find causes of errors."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from imucald import __version__
from imucald.api.blas_threads import on_one_thread
from imucald.api.configuration import Configuration, PathLike
from imucald.api.html import html_table
from imucald.api.logs import pieces
from imucald.api.run import Progress
from imucald.can.logs.recording_files import same_recording
from imucald.core.errors import ConfigError, EstimateError, ImucaldError
from imucald.core.text import counted, duration
from imucald.diagnosis.baseline import baseline_model
from imucald.diagnosis.diagnose import diagnose as diagnosed
from imucald.diagnosis.recording import Recording, is_same_recording, read_samples
from imucald.diagnosis.result import Diagnosis
from imucald.model.model import VehicleModel, load_model
from imucald.report.model_changes import model_changes, value_text
from imucald.report.wording import for_prediction_only, verdict

FEW_REJECTED = 1e-4
"""Share of frames that may be rejected without a note, for example one or two damaged lines."""
Share = Callable[[float, str], None]
"""Callback for progress. Arguments: the share done (0 to 1) and the name of the current step."""


@dataclass(frozen=True, eq=False, repr=False)
class DiagnosisResult:
    """The result of a diagnosis of drives.

    logs: the log files of the drives. verdict: "found", "ambiguous", "unknown" or "nothing".
    causes: names of the certain causes, see docs/diagnosis.md. headline: the verdict as a sentence.
    notes: further remarks for the user. complete: False if the time limit ended the search.
    problems: the first bad lines.
    """

    logs: tuple[str, ...]
    verdict: str
    causes: tuple[str, ...]
    headline: str
    notes: tuple[str, ...]
    complete: bool
    problems: tuple[str, ...]
    diagnosis: Diagnosis
    """The complete diagnosis, for internal use."""
    durations_s: tuple[float, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the output of `imucald diagnose --json`, as plain data."""
        found = self.diagnosis
        changes = model_changes(found.model_before, found.model_after)
        return {
            **found.as_json(),
            "logs": list(self.logs),
            "model_changes": {c.key: {"before": c.before, "after": c.after} for c in changes},
        }

    def model_text(self) -> str:
        """Return the extended model file (YAML). The header of the text states its origin."""
        found = self.diagnosis
        head = [f"VehicleModel file written by imucald diagnose {__version__} from:"]
        head += [
            f"  {Path(log).name} ({duration(length)})"
            for log, length in zip(self.logs, self.durations_s, strict=True)
        ]
        head.append(self.headline)
        changes = model_changes(found.model_before, found.model_after)
        head += [f"  {c.key}: {value_text(c.before)} -> {value_text(c.after)}" for c in changes]
        if not changes:
            head.append("  no key was changed")
        elif why := for_prediction_only(found):
            head.append(f"For prediction only: {why}.")
        lines = ("".join(c if c.isprintable() else "?" for c in line) for line in head)
        return "".join(f"# {line}\n" for line in lines) + found.model_after.to_yaml()

    def write_model(self, path: PathLike) -> Path:
        """Write the extended model file, for the configuration's key `model:`; return its path.

        Raises ImucaldError if the file cannot be written.
        """
        file = Path(path)
        try:
            file.write_text(self.model_text(), encoding="utf-8")
        except OSError as error:
            reason = error.strerror or error
            raise ImucaldError(f"{file}: cannot be written: {reason}") from None
        return file

    def __repr__(self) -> str:
        causes = ", ".join(self.causes) or "none"
        return (
            f"Diagnosis of {counted(len(self.logs), 'drive')}: {self.headline}\n  causes: {causes}"
        )

    def _repr_html_(self) -> str:
        """Return the HTML that a notebook shows."""
        rows = ([cause.name, cause.text] for cause in self.diagnosis.causes)
        return html_table((self.headline, ""), rows)


def diagnose(
    config: Configuration | PathLike,
    logs: PathLike | Sequence[PathLike],
    *,
    model: PathLike | None = None,
    time_limit_s: float | None = None,
    progress: Share | None = None,
    reading: Progress | None = None,
    strict: bool = False,
) -> DiagnosisResult:
    """Compare the simulation with measured drives of one vehicle and report errors of the model.

    The result is the same as the result of `imucald diagnose`.

    config: a configuration, or the name of its file. logs: one log per drive; the sensor must have
    the same mount in all drives. model: the model file to test. Without a model file, a default car
    is tested, with the values of the configuration and the mount that is found in the drives.
    time_limit_s: limit of processor time [s], after which the findings so far are reported; the
    default is 40 s per hour of driving, at least 30 s. progress: called with the share done and the
    current step. reading: called with the bytes read. strict: the first bad line raises LogError.

    Raises ConfigError for the configuration, the model file, or a log given twice. Raises LogError
    for a log that cannot be read, has no usable frame, or contains the same drive as another log.
    Raises ImucaldError if no diagnosis is possible.
    """
    config = Configuration.of(config)
    names = [str(log) for log in pieces(logs)]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise ConfigError(f"{', '.join(sorted(twice))} is given twice; give each log once")
    vehicle = load_model(Path(model)) if model is not None else None
    recordings = [read_samples(config.loaded, [name], reading, strict) for name in names]
    return diagnosis_of(config, names, recordings, vehicle, time_limit_s, progress)


@on_one_thread
def diagnosis_of(
    config: Configuration,
    logs: Sequence[str],
    recordings: Sequence[Recording],
    model: VehicleModel | None,
    time_limit_s: float | None,
    progress: Share | None = None,
) -> DiagnosisResult:
    """Diagnose drives that have been read; see `diagnose`."""
    _refuse_same(logs, recordings)
    drives = [recording.samples for recording in recordings]
    notes = [note for recording in recordings for note in _reading_notes(recording)]
    try:
        if model is None:
            if progress is not None:
                progress(0.0, "baseline model")
            model = baseline_model(config.loaded, recordings)
        found = diagnosed(drives, model, progress, time_limit_s)
    except EstimateError as error:
        if not notes:
            raise
        raise EstimateError(f"{error} ({'; '.join(notes)})") from None
    found = replace(found, notes=(*found.notes, *notes))
    return DiagnosisResult(
        logs=tuple(logs),
        verdict=found.verdict,
        causes=tuple(cause.name for cause in found.causes),
        headline=verdict(found).headline,
        notes=found.notes,
        complete=found.complete,
        problems=tuple(text for recording in recordings for text in recording.problems),
        diagnosis=found,
        durations_s=tuple(recording.duration_s for recording in recordings),
    )


def _refuse_same(logs: Sequence[str], recordings: Sequence[Recording]) -> None:
    """Raise LogError if two logs contain the same drive, because its evidence would count twice."""
    drives = list(zip(logs, recordings, strict=True))
    for (one, first), (other, second) in itertools.combinations(drives, 2):
        if is_same_recording(first, second):
            raise same_recording(other, one)


def _reading_notes(recording: Recording) -> list[str]:
    """Return notes on problems while a log was read."""
    notes = []
    bad = sum(recording.rejected.values())
    if bad > FEW_REJECTED * recording.frames_read:
        reasons = ", ".join(f"{reason} {n}" for reason, n in recording.rejected.items())
        notes.append(f"{recording.name}: {bad} frames or samples were rejected ({reasons})")
    if recording.gaps:
        times = ", ".join(f"{t:.0f}" for t in recording.gaps[:5])
        more = ", ..." if len(recording.gaps) > 5 else ""
        notes.append(
            f"{recording.name}: frames are missing or the clock jumps before {times}{more} s"
        )
    return notes
