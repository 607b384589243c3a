"""The engine processes received frames and returns the frames to send. The engine combines router,
pipeline and output. The engine has no I/O and reads no clock.

The live daemon passes frames one by one (`frame`), and replay passes chunks of columns (`columns`).
Both methods give the same frames in the same order, unless a clock was set back by less than a
second (see `TimeBase.is_live`). An engine may use both methods in turn.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns
from imucald.core.arrays import distinct
from imucald.core.rotations import times_level
from imucald.inputs.column_samples import Routed
from imucald.inputs.rate_guard import Spaced, guarded_cycle
from imucald.inputs.router import Router, Sample
from imucald.motion.sample_health import SampleHealth
from imucald.motion.ticks import TICK_RATE, tick_index
from imucald.mount.estimate import Correction, MountEstimator
from imucald.runtime.consumer import Consumer, ConsumerGroup
from imucald.runtime.input_health import MISSING_TICKS, InputWatch, LinkHealth, health_at
from imucald.runtime.output.output_columns import (
    OutPart,
    corrected_count,
    corrected_parts,
    frames_part,
    merged,
)
from imucald.runtime.output.output_frames import STATUS_FRAMES, Health, OutputFrames
from imucald.runtime.output.output_message import OutFrame
from imucald.runtime.pipeline import Pipeline, Snapshot
from imucald.runtime.segment_samples import SegmentSamples, corrected_samples
from imucald.runtime.timebase import TimeBase, TimeSegment

if TYPE_CHECKING:
    from imucald.model_compensation.preprocessing import PreprocessingChain

Turned = tuple[float, float, float] | None
"""A sample in vehicle axes; None before there is a correction."""


class Engine:
    """Processes the frames of one sensor on one bus.

    on_snapshot: called with every snapshot of the estimate (for the terminal and for saved states).
    link_health: returns the health of the link for each health frame. consumers: calculations on
    the same samples. new_estimator: function that creates an estimator that has learnt nothing; it
    starts with the mount of the configuration, if there is one.
    preprocessing: removes the signal effects that a model file states. on_samples: called by
    `columns` with the uncorrected and corrected samples of every segment.
    """

    def __init__(
        self,
        router: Router,
        new_estimator: Callable[[], MountEstimator],
        output: OutputFrames,
        status_rate: int = 1,
        on_snapshot: Callable[[Snapshot], None] | None = None,
        link_health: Callable[[], LinkHealth] = LinkHealth,
        consumers: Sequence[Consumer] = (),
        preprocessing: PreprocessingChain | None = None,
        on_samples: Callable[[SegmentSamples], None] | None = None,
    ) -> None:
        self.router = router
        self.output = output
        self.preprocessing = preprocessing
        ticks = None if preprocessing is None else preprocessing.ticks
        health = SampleHealth(router.measured_axes)
        self.new_estimator = new_estimator
        self.pipeline = Pipeline(new_estimator(), round(TICK_RATE / status_rate), ticks, health)
        self.timebase = TimeBase()
        self._group = ConsumerGroup(consumers)
        self.sent = 0
        """Number of frames returned so far."""
        self._on_snapshot = on_snapshot
        self._on_samples = on_samples
        self._link_health = link_health
        self._spaced = {
            c: Spaced(guarded_cycle(router.cycles(c))) for c in output.triads
        }  # frames not available: one a cycle
        self._late = {c: Spaced(guarded_cycle(router.cycles(c))) for c in output.triads}
        self._late_status = Spaced(1.0 / status_rate)
        self._watch = InputWatch(router.channels)

    @property
    def model_key(self) -> str:
        """Key that identifies the model file's effect on the estimate; "" without a model file."""
        return "" if self.preprocessing is None else self.preprocessing.estimate_key

    @property
    def consumers(self) -> tuple[Consumer, ...]:
        """The consumers of this engine (such as the attitude)."""
        return self._group.all

    @property
    def consumer_group(self) -> ConsumerGroup:
        """The consumers as a group that also counts failed calculations."""
        return self._group

    def go_on_from(
        self,
        former: Engine,
        estimator: MountEstimator,
        keeps_consumers: bool = False,
        is_same_bus: bool = True,
    ) -> None:
        """Replace another engine between two frames. Only parts whose inputs have changed restart.

        estimator: the estimator to use. The estimator of the former engine is allowed only if all
        inputs are the same. keeps_consumers: if True, the consumers of the former engine are used.
        is_same_bus: if False, every input counts as changed, even with the same identifiers.
        """
        before = former.pipeline
        same = self.router.same_sources(former.router) if is_same_bus else frozenset()
        self.timebase, self.sent = former.timebase, former.sent
        if is_same_bus:
            self.router.go_on_from(former.router, same)
        self.output.go_on_from(former.output)
        self._watch.go_on_from(former._watch, same, before.k)
        for channel, spaced in former._spaced.items():
            if channel in self._spaced and self._spaced[channel].cycle == spaced.cycle:
                self._spaced[channel] = spaced
        if estimator is before.estimator:
            before.status_ticks = self.pipeline.status_ticks
            self.pipeline = before
        else:
            self.pipeline.replace(estimator, afresh=True)
            self.pipeline.go_on_from(before, same)
        if same != self.router.channels | former.router.channels:
            return
        mine, known = self.preprocessing, former.preprocessing
        if mine is not None and known is not None and mine.is_like(known):
            self.preprocessing = known
        if keeps_consumers and estimator is before.estimator:
            self._group = former._group
            self.output.attitude = former.output.attitude
            self.output.travel = former.output.travel

    # one frame -----------------------------------------------------------------------------

    def frame(
        self, stamp: float, can_id: int, data: bytes, late: float | None = None
    ) -> list[OutFrame]:
        """Process one received frame. Return the frames to send.

        stamp: reception time [s], wall clock. can_id: with the flag for 29 bits. late: None, or (if
        the frame is too old to be corrected) the present time of a clock that is never set [s]. The
        estimator learns from late frames too. During a burst of late frames, the frames *not
        available* and the newest status are sent at their usual rate.
        """
        t, gap = self.timebase.stream_time(stamp)
        out: list[OutFrame] = []
        k = tick_index(t)
        if k > self.pipeline.k or gap:
            out += self._advance(k, gap, late)
        samples, rejected, spoilt = self.router.frame(t, can_id, data)
        pipeline = self.pipeline
        health = pipeline.health
        for channel, values in samples:
            health.add_sample(channel, values)
        if self.preprocessing is not None:
            samples, refused = self.preprocessing.frame(t, samples, self.router.rejected)
            rejected += refused
            spoilt += refused
        for channel in spoilt:
            pipeline.reject(channel)
        self._watch.count_rejections(k, self.router.rejected.total())
        if self._group:
            self._group.feed(t, samples, pipeline.correction, health.faults)
        correction, watched = pipeline.correction, self._watch.last
        for channel, values in samples:
            pipeline.add_sample(t, channel, values)
            if channel in watched:
                watched[channel] = k
        turned = self._turned(t, samples, correction)
        if late is not None:
            out += self._not_available({*turned, *rejected}, self._late, late)
        else:
            if turned:
                out += self._corrected_frames(turned)
            if rejected:
                out += self._not_available(set(rejected) - turned.keys(), self._spaced, t)
        self.sent += len(out)
        return out

    def _turned(
        self, t: float, samples: Sequence[Sample], correction: Correction | None
    ) -> dict[str, Turned]:
        """Return the samples of one frame in vehicle axes, by channel. A sample is None if there is
        no correction.
        """
        triads, planar = self.output.triads, self.output.planar
        turned: dict[str, Turned] = {}
        for channel, values in samples:
            if channel in triads:
                turned[channel] = (
                    None if correction is None else correction.applied(channel, values)
                )
        if self.preprocessing is not None and turned:
            turned = self.preprocessing.corrected(t, turned)
        if planar and correction is not None:
            turned |= {c: times_level(correction.rotation, v) for c, v in samples if c in planar}
        return turned

    def _corrected_frames(self, turned: Mapping[str, Turned]) -> list[OutFrame]:
        """Return the frames of corrected samples. The frame of a faulty sensor has the values *not
        available*.
        """
        output, faults, quality = self.output, self.pipeline.health.faults, self.pipeline.quality
        out: list[OutFrame] = []
        for channel in output.triads:
            if channel in turned:
                is_faulty = faults and output.sensor_of[channel] in faults
                sent = None if is_faulty else turned[channel]
                out.append(output.corrected(channel, sent, quality))
        return out

    def _not_available(
        self, channels: Collection[str], spaced: Mapping[str, Spaced], now: float
    ) -> list[OutFrame]:
        """Return frames *not available* for samples that were rejected or are late, at most one per
        channel and cycle."""
        output = self.output
        due = [c for c in output.triads if c in channels and spaced[c].passes(now)]
        return [output.corrected(channel, None, 0) for channel in due]

    def idle(self, elapsed: float) -> list[OutFrame]:
        """End the ticks that have passed while no configured frame arrived for `elapsed` [s].
        Return the frames to send."""
        k = tick_index(self.timebase.idle(elapsed))
        out = self._advance(k, False)
        self.sent += len(out)
        return out

    def _advance(self, k: int, gap: bool, late: float | None = None) -> list[OutFrame]:
        """End all ticks before k. Return the status frames, followed by the frames of the
        consumers.

        late: as in `frame`; the consumers then send nothing.
        """
        pipeline = self.pipeline
        first = pipeline.k
        snapshots = pipeline.gap(k) if gap else pipeline.advance(k)
        if gap and self.preprocessing is not None:
            self.preprocessing.gap()
        out = self._statuses(snapshots if late is None else self._newest(snapshots, late))
        if self._group:
            out += self._group.end_ticks(first, k, snapshots, late is not None)
            if gap:
                self._group.gap()
        return out

    def heartbeat(self) -> list[OutFrame]:
        """Return the status frames for a silent bus: no frame was received yet, or none for a long
        time.
        """
        health = self._watch.all_missing(self._link_health())
        out = self.output.status(self.pipeline.estimator.estimate(), False, health)
        self.sent += len(out)
        return out

    # starting again ------------------------------------------------------------------------

    def restart_calibration(self) -> MountEstimator:
        """Forget the estimate and start again. All counters continue. Return the former estimator.
        The known limits of the sensors' ranges are forgotten too.
        """
        self.pipeline.health.forget_rails()
        return self.pipeline.replace(self.new_estimator(), afresh=True)

    def resume_calibration(self, former: MountEstimator) -> None:
        """Use an estimator again that `restart_calibration` returned. The estimator continues with
        its former state."""
        former.gap()
        self.pipeline.replace(former)

    # columns -------------------------------------------------------------------------------

    def columns(self, frames: FrameColumns, keep: bool = True) -> FrameColumns | None:
        """Process a chunk of frames. Return the frames to send (None with keep=False)."""
        parts = [
            part
            for segment in self.timebase.segments(frames.t)
            for part in self._segment(segment, frames, keep)
        ]
        if not keep:
            return None
        return merged(parts, frames)

    def _after_gap(self, segment: TimeSegment, keep: bool) -> Iterator[OutPart]:
        """Begin a new segment after a jump of time. Yield the frames that are due."""
        base, first = segment.start, self.pipeline.k
        snapshots = self.pipeline.gap(tick_index(float(segment.t[0])))
        if self.preprocessing is not None:
            self.preprocessing.gap()
        if keep:
            yield from self._status_parts(snapshots, lambda _: base, np.zeros(0))
        else:
            self._hand_on(snapshots)
        out = self._group.end_ticks(first, self.pipeline.k, snapshots)
        yield from self._frame_parts(out, base)
        self._group.gap()

    def _segment(self, segment: TimeSegment, frames: FrameColumns, keep: bool) -> Iterator[OutPart]:
        base = segment.start
        if segment.gap:
            yield from self._after_gap(segment, keep)
        whole = base == 0 and segment.stop == len(frames)
        chunk = frames if whole else frames.take(slice(base, segment.stop))
        routed = self.router.columns(segment.t, chunk)
        watched, refused = routed.samples, routed.rejected
        if self.preprocessing is not None:
            routed = self.preprocessing.columns(routed, segment.t, self.router.rejected)
        ticks = cache(lambda: np.floor(segment.t * TICK_RATE).astype(np.int64))
        times = {c: segment.t[rows] for c, rows in routed.rejected_values.items()}
        first = self.pipeline.k
        wanted = keep or bool(self._group) or self._on_snapshot is not None
        corrections, snapshots = self.pipeline.run(
            routed.samples, times, float(segment.t[-1]), wanted, watched
        )
        if not wanted:
            self.sent += STATUS_FRAMES * self.pipeline.snapshots_due(first)
        events = np.floor(routed.events * TICK_RATE)
        if keep:
            yield from self._status_parts(
                snapshots,
                lambda k: base + int(np.searchsorted(ticks(), k, side="right")),
                events,
                routed,
            )
        else:
            self._hand_on(snapshots)
        last = tick_index(float(segment.t[-1]))
        self._watch.take_columns(routed, events, last, self.router.rejected.total())
        if self._group:
            parts = self._group.columns(routed, corrections, snapshots, ticks(), base)
            yield from self._counted(parts)
        lost = self._lost_rows(routed, segment.t)
        corrected = cache(
            lambda: corrected_samples(routed, corrections, ticks(), self.output, self.preprocessing)
        )
        if self._on_samples is not None:
            self._on_samples(SegmentSamples(segment, chunk.t, watched, refused, corrected))
        if keep:
            yield from self._counted(corrected_parts(self.output, corrected(), lost, base))
        else:
            self.sent += sum(corrected_count(routed, c) + len(lost[c]) for c in lost)

    def _lost_rows(self, routed: Routed, t: NDArray[np.float64]) -> dict[str, NDArray[np.int64]]:
        """Return, by channel, the rows for which a frame *not available* is sent."""
        lost: dict[str, NDArray[np.int64]] = {}
        for channel in self.output.triads:
            series, bad = routed.samples.get(channel), routed.rejected.get(channel)
            if bad is None:
                lost[channel] = np.zeros(0, np.int64)
                continue
            rows = distinct(bad)
            if series is not None:
                rows = rows[~np.isin(rows, series.row)]
            lost[channel] = rows[self._spaced[channel].among(t[rows])]
        return lost

    def _counted(self, parts: Iterable[OutPart]) -> Iterator[OutPart]:
        for part in parts:
            self.sent += len(part.row)
            yield part

    def _frame_parts(self, out: list[OutFrame], row: int) -> Iterator[OutPart]:
        return self._counted([frames_part(out, row)] if out else [])

    def _status_parts(
        self,
        snapshots: list[Snapshot],
        row_of: Callable[[int], int],
        events: NDArray[np.float64],
        routed: Routed | None = None,
    ) -> Iterator[OutPart]:
        """Yield the status frames of snapshots. Each contains the health at the time of its
        snapshot, not at the end of the chunk."""
        watch, before = self._watch, self._watch.rejected
        for snapshot in snapshots:
            k = snapshot.k
            seen = int(events.searchsorted(k, side="right"))  # rejections up to the snapshot
            is_near = seen > 0 and bool(events[seen - 1] > k - MISSING_TICKS)
            last = watch.last_until(k, routed)
            out = self._status(snapshot, before + seen, is_near or watch.is_recent(k), last)
            yield from self._frame_parts(out, row_of(k))

    def _hand_on(self, snapshots: Sequence[Snapshot]) -> None:
        """Process snapshots without encoding their frames."""
        self.sent += STATUS_FRAMES * len(snapshots)
        if self._on_snapshot is not None:
            for snapshot in snapshots:
                self._on_snapshot(snapshot)

    # status --------------------------------------------------------------------------------

    def health(self) -> Health:
        """Return the present content of the health frame. Before the first configured frame, all
        inputs are reported as missing.
        """
        link, rejecting = self._link_health(), self._watch.is_recent(self.pipeline.k)
        if not self.timebase.started:
            return self._watch.all_missing(link, rejecting)
        return self._watch.health(self.pipeline.k, link, self.pipeline.health.unfit)

    def _newest(self, snapshots: Sequence[Snapshot], now: float) -> Sequence[Snapshot]:
        """Return the newest of the late snapshots if its status frames may be sent now. The rate of
        status frames is limited by the clock `now` [s]."""
        due = snapshots[-1:] if snapshots and self._late_status.passes(now) else []
        if self._on_snapshot is not None:
            for snapshot in snapshots[: len(snapshots) - len(due)]:
                self._on_snapshot(snapshot)
        return due

    def _statuses(self, snapshots: Sequence[Snapshot]) -> list[OutFrame]:
        watch = self._watch
        out: list[OutFrame] = []
        for snapshot in snapshots:
            out += self._status(snapshot, watch.rejected, watch.is_recent(snapshot.k), watch.last)
        return out

    def _status(
        self, snapshot: Snapshot, rejected: int, is_rejecting: bool, last: Mapping[str, int]
    ) -> list[OutFrame]:
        if self._on_snapshot is not None:
            self._on_snapshot(snapshot)
        link = self._link_health()
        health = health_at(snapshot.k, last, is_rejecting, rejected, link, snapshot.faults)
        return self.output.status(snapshot.estimate, snapshot.usable, health)
