"""One form on one drive: the log written, replayed as `imucald replay` does, held against truth."""

from __future__ import annotations

import hashlib
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.integrity.bases import MOVING_MPS, Base
from benchmarks.integrity.judge import INTERVAL
from benchmarks.signal_forms.bus import Bus, pieces
from benchmarks.signal_forms.drives import OWN_STEPS, Put, base_of
from benchmarks.signal_forms.forms import FORMS, Form
from imucald.can.logs.log_reader import CandumpWriter, LogReader
from imucald.config import LoadedConfig, load_config
from imucald.config_check.checker import Check
from imucald.core.errors import ImucaldError
from imucald.core.rotations import vector_from_rotation
from imucald.motion.ticks import TICK_S
from imucald.mount.estimate import MountState
from imucald.mount.hysteresis import GOOD
from imucald.mount.mount_words import is_move
from imucald.mount.signal_blocks import SignalBlock
from imucald.runtime.engine import Engine
from imucald.runtime.pipeline import Snapshot
from imucald.runtime.replay import Replay
from imucald.runtime.session import make_engine

Array = NDArray[np.float64]

AT_MINUTES = (2.0, 5.0, 10.0)
"""Intervals are held against the truth then, and at the end."""
PIECE_S = 60.0
TROUBLES = {MountState.SUSPECT: "suspect", MountState.RECALIBRATING: "recalibrating"}


@dataclass
class Watch:
    """What a replay says second by second, and how much of the drive it learns from."""

    base: Base
    bad: dict[str, float] = field(default_factory=dict)
    """First time of each bad state [s], and of a mount that was good and then only levelled."""
    was_good: bool = False
    moves: list[dict[str, Any]] = field(default_factory=list)
    said: dict[str, dict[str, Any]] = field(default_factory=dict)
    learnt: int = 0
    """Ticks of driving that something was learnt from."""
    until: float = 0.0
    """Time of the last whole block [s]: what comes after it nobody has looked at yet."""
    last: Snapshot | None = None
    kinds: dict[str, int] = field(default_factory=dict)
    """Why not, as far as the block's own flags say it: force, speed, forbidden."""

    def snapshot(self, snapshot: Snapshot) -> None:
        """Take a snapshot."""
        estimate, t = snapshot.estimate, snapshot.t
        if estimate.state in TROUBLES:
            self.bad.setdefault(TROUBLES[estimate.state], round(t, 1))
        self.was_good |= estimate.state in GOOD
        if self.was_good and estimate.state == MountState.LEVELLED:
            self.bad.setdefault("lost", round(t, 1))
        shifts = estimate.details.get("shifts", ())
        if isinstance(shifts, list):
            self.moves = [shift for shift in shifts if is_move(shift)]
        for minutes in AT_MINUTES:
            if abs(t - 60.0 * minutes) < 0.05:
                self.said[f"{minutes:g} min"] = said(self.base, snapshot)
        self.last = snapshot

    def at_end(self) -> None:
        """The last snapshot is the end's."""
        if self.last is not None:
            self.said["end"] = said(self.base, self.last)

    def drives(self, t: Array) -> NDArray[np.bool_]:
        """Whether the vehicle drives at times (N,)."""
        speed = self.base.samples["speed"]
        return np.asarray(np.interp(t, speed.t, np.abs(speed.values)) > MOVING_MPS)

    def block(self, p: SignalBlock) -> None:
        """Count a block's ticks of driving, by the truth's speed."""
        drives = self.drives(p.t)
        self.until = float(p.t[-1])
        use = p.learn & p.ok_force & p.ok_speed
        self.learnt += int((drives & use).sum())
        reasons = {
            "no force": ~p.ok_force,
            "no speed": p.ok_force & ~p.ok_speed,
            "forbidden": p.ok_force & p.ok_speed & ~p.learn,
        }
        for name, flags in reasons.items():
            self.kinds[name] = self.kinds.get(name, 0) + int((drives & flags).sum())


def said(base: Base, snapshot: Snapshot) -> dict[str, Any]:
    """Error and stated deviation about the vehicle's x, y, z [deg]; None where nothing is said."""
    estimate = snapshot.estimate
    R, std = estimate.R_vehicle_from_sensor, estimate.std
    if R is None or std is None:
        return {}
    error = np.degrees(vector_from_rotation(base.R_vehicle_from_sensor @ R.T))
    own = np.hypot(np.degrees(np.array(std)), base.reference_std)
    known = np.isfinite(own) & np.array(base.axes)
    return {
        "state": estimate.state.name.lower(),
        "error": [round(float(e), 3) if k else None for e, k in zip(error, known, strict=True)],
        "std": [round(float(s), 3) if k else None for s, k in zip(own, known, strict=True)],
    }


def holds(one: Mapping[str, Any]) -> list[bool | None]:
    """Of x, y, z whether the 95 % interval holds; None where it is not known."""
    pairs = zip(one.get("error", ()), one.get("std", ()), strict=True)
    return [None if e is None else abs(e) <= INTERVAL * s for e, s in pairs]


# one run -----------------------------------------------------------------------------------------


def run(base: Base, put: Put, form: Form, with_check: bool = False) -> dict[str, Any]:
    """Put a form on a drive; what came of it."""
    rng = np.random.default_rng(_seed(f"{put.key} {form.name}"))
    samples = {c: s for c, s in base.samples.items() if c not in form.without}
    samples = form.samples(samples, rng)
    layout = form.layout.with_steps(OWN_STEPS.get(put.name, {}))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        bus = Bus(layout, samples, base.side, folder)
        frames = form.frames(bus.frames(samples), rng)
        log, config = folder / "drive.log", folder / "car.yaml"
        with CandumpWriter(log) as writer:
            for piece in pieces(frames, PIECE_S):
                writer.write_columns(piece)
        config.write_text(bus.configuration(form.counters), "utf-8")
        try:
            loaded = load_config(config)
            found = replayed(base, loaded, log)
            if with_check or form.tells:
                found["check"] = checked(loaded, log)
        except ImucaldError as error:
            return {"refused": str(error).replace(f"{folder}/", "")}
    return found


def _seed(text: str) -> int:
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8], "big")


def replayed(base: Base, loaded: LoadedConfig, log: Path) -> dict[str, Any]:
    """Replay a log as `imucald replay` does, and watch it."""
    watch = Watch(base)
    engine = make_engine(loaded, watch.snapshot)
    _watch_blocks(engine, watch)
    router = engine.router
    reader = LogReader([log], router.matches, cycles=router.stated_cycles)
    summary = Replay(engine, reader).run()
    watch.at_end()
    driving = int(watch.drives(np.arange(0.0, watch.until, TICK_S)).sum())
    details = summary["details"]
    return {
        "usable_s": summary["first_usable_s"],
        "fine_s": summary["first_fine_s"],
        "state": summary["state"],
        "waiting_for": summary["waiting_for"],
        "bad": watch.bad,
        "moves": watch.moves,
        "said": watch.said,
        "driving_s": driving / 10.0,
        "not_learnt_s": max(driving - watch.learnt, 0) / 10.0,
        "why": {name: n / 10.0 for name, n in watch.kinds.items() if n},
        "named_s": named_seconds(details),
        "frozen_ticks": details.get("frozen_ticks", {}),
        "not_learnt_from": details.get("not_learnt_from"),
        "faults": details.get("faults", []),
        "health": summary["signal_health"]["events"][:10],
        "rejected": summary["frames"]["rejected"],
        "frames": summary["frames"]["read"],
    }


def _watch_blocks(engine: Engine, watch: Watch) -> None:
    """See every block that the estimator learns from; what it says of itself is judged by that."""
    maker = engine.pipeline.estimator._signals
    made = maker.block

    def block() -> SignalBlock:
        p: SignalBlock = made()
        watch.block(p)
        return p

    maker.block = block


def named_seconds(details: Mapping[str, Any]) -> float:
    """Seconds of `details.not_learnt_from` that are named with a signal and a cause."""
    found = details.get("not_learnt_from") or ()
    return sum(float(one["seconds"]) for one in found if one.get("signal") and one.get("cause"))


def checked(loaded: LoadedConfig, log: Path) -> dict[str, Any]:
    """What `imucald check` says: whether it can be used; errors, warnings and notes in words."""
    check = Check(loaded)
    reader = LogReader([log])
    for chunk in reader:
        check.feed(chunk)
    found = check.findings()
    return {
        "usable": not any(f.level == "error" for f in found),
        "texts": [
            f"{f.level}: {f.quantity}: {f.text}" for f in found if f.level in ("error", "warning")
        ],
    }


# all forms on one drive --------------------------------------------------------------------------


def outcomes(job: tuple[Put, tuple[str, ...], bool]) -> list[dict[str, Any]]:
    """Every wanted form on a drive, with what its twin gave; [] where the drive is not there."""
    put, names, with_check = job
    bases: dict[str, Base | None] = {}
    twins: dict[tuple[str, frozenset[str]], dict[str, Any]] = {}
    found = []
    for form in FORMS:
        if form.name not in names:
            continue
        key = repr(sorted(form.changes.items()))
        if key not in bases:
            bases[key] = base_of(put, form.changes)
        base = bases[key]
        if base is None:
            return []
        if not form.fits(base, put.is_constant):
            continue
        lacking = (form.without if form.own_twin else frozenset()) & frozenset(base.samples)
        if (key, lacking) not in twins:
            twins[key, lacking] = run(
                base, put, Form("unspoilt", form.twin, without=lacking), with_check
            )
        twin = twins[key, lacking]
        got = twin if form.is_unspoilt else run(base, put, form, with_check)
        found.append(
            {
                "form": form.name,
                "drive": put.key,
                "group": put.group,
                "twin_usable_s": twin.get("usable_s"),
                "twin_bad": twin.get("bad", {}),
                "twin_moves": len(twin.get("moves", ())),
                **got,
            }
        )
    return found
