"""Frames in, frames out: router, pipeline and output put together. No I/O, no clock.

The live daemon feeds frames one by one (`frame`), replay feeds chunks of columns (`columns`). Both
give the same frames in the same order; the two may be mixed on one engine.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from imucald.can.columns import FrameColumns
from imucald.core.errors import EstimateError
from imucald.core.rotations import times, times_columns, times_level, times_level_columns
from imucald.inputs.rate_guard import Spaced, guarded_cycle
from imucald.inputs.router import Routed, Router, Sample
from imucald.motion.sample_health import Faults, SampleHealth
from imucald.motion.ticks import TICK_RATE, tick_index
from imucald.mount.estimate import Correction, MountEstimator
from imucald.runtime.consumer import Consumer, events_of, in_order
from imucald.runtime.output.output_columns import (
    OutPart,
    corrected_count,
    merged,
)
from imucald.runtime.output.output_frames import STATUS_FRAMES, Health, OutputFrames
from imucald.runtime.output.output_message import OutFrame
from imucald.runtime.pipeline import Pipeline, Snapshot, TickCorrections
from imucald.runtime.segment_samples import CorrectedSamples, SegmentSamples
from imucald.runtime.timebase import TimeBase, TimeSegment

if TYPE_CHECKING:
    from imucald.model_compensation.preprocessing import PreprocessingChain

MISSING_TICKS = 10
"""An input that gave no sample for so many ticks is missing: one second."""

Turned = tuple[float, float, float] | None
"""A sample in vehicle axes; None: no correction yet."""
_SENSORS = {"accel": "accelerometer_missing", "gyro": "gyroscope_missing", "speed": "speed_missing"}


@dataclass(frozen=True)
class LinkHealth:
    """What only the bus link knows; all zero in replay."""

    lost: int = 0
    frames_lost: bool = False
    id_conflict: bool = False
    send_failed: bool = False


class Engine:
    """One sensor on one bus.

    on_snapshot: called with every snapshot of the estimate (for terminals and state files).
    link_health: asked whenever a health frame is made.
    consumers: run beside, on the same samples.
    new_estimator: makes the estimator of `restart_calibration`.
    preprocessing: takes out of the signals what a model file knows of them.
    on_samples: called by `columns` with the samples of every segment, as they came and corrected.
    """

    def __init__(
        self,
        router: Router,
        estimator: MountEstimator,
        output: OutputFrames,
        status_rate: int = 1,
        on_snapshot: Callable[[Snapshot], None] | None = None,
        link_health: Callable[[], LinkHealth] = LinkHealth,
        consumers: Sequence[Consumer] = (),
        new_estimator: Callable[[], MountEstimator] | None = None,
        preprocessing: PreprocessingChain | None = None,
        on_samples: Callable[[SegmentSamples], None] | None = None,
    ) -> None:
        self.router = router
        self.output = output
        self.preprocessing = preprocessing
        ticks = None if preprocessing is None else preprocessing.ticks
        health = SampleHealth(router.measured_axes)
        self.pipeline = Pipeline(estimator, round(TICK_RATE / status_rate), ticks, health)
        self.timebase = TimeBase()
        self.consumers = tuple(consumers)
        self._consumed = frozenset(c for one in self.consumers for c in one.channels)
        self.sent = 0
        """Frames given out."""
        self._on_snapshot = on_snapshot
        self._on_samples = on_samples
        self._link_health = link_health
        self._new_estimator = new_estimator
        self._spaced = {
            c: Spaced(guarded_cycle(router.cycles(c))) for c in output.triads
        }  # frames not available: one a cycle
        self._watched = {c: 0 for c in _SENSORS if c in router.channels}  # tick of last sample
        self._rejected_total = 0
        self._rejections: deque[int] = deque()  # ticks of the last second's rejections

    @property
    def model_key(self) -> str:
        """Names what a model changes of the estimate; "" without one."""
        return "" if self.preprocessing is None else self.preprocessing.estimate_key

    # one frame -----------------------------------------------------------------------------

    def frame(self, stamp: float, can_id: int, data: bytes) -> list[OutFrame]:
        """Take one frame; return the frames to send.

        stamp: reception time [s], wall clock. can_id with the flag for 29 bits.
        """
        t, gap = self.timebase.stream_time(stamp)
        out: list[OutFrame] = []
        k = tick_index(t)
        if k > self.pipeline.k or gap:
            out += self._advance(k, gap)
        samples, rejected = self.router.frame(t, can_id, data)
        pipeline = self.pipeline
        health = pipeline.health
        for channel, values in samples:
            health.add(channel, values)
        if self.preprocessing is not None:
            samples, refused = self.preprocessing.frame(t, samples, self.router.rejected)
            rejected += refused
        for channel in rejected:
            pipeline.reject(channel)
        self._count_rejections(k)
        if self.consumers:
            self._feed_consumers(t, samples)
        correction, triads = pipeline.correction, self.output.triads
        for channel, values in samples:
            pipeline.add(t, channel, values)
            if channel in self._watched:
                self._watched[channel] = k
        turned = self._turned(t, samples, correction)
        if turned:
            out += self._corrected_frames(turned)
        for channel in triads if rejected else ():
            if channel in rejected and channel not in turned and self._spaced[channel].passes(t):
                out.append(self.output.corrected(channel, None, 0))
        self.sent += len(out)
        return out

    def _turned(
        self, t: float, samples: Sequence[Sample], correction: Correction | None
    ) -> dict[str, Turned]:
        """Samples of one frame in vehicle axes, by channel; None where there is no correction."""
        triads, planar = self.output.triads, self.output.planar
        turned: dict[str, Turned] = {}
        for channel, values in samples:
            if channel in triads:
                turned[channel] = None if correction is None else times(correction, values)
        if self.preprocessing is not None and turned:
            turned = self.preprocessing.corrected(t, turned)
        if planar and correction is not None:
            turned |= {c: times_level(correction, v) for c, v in samples if c in planar}
        return turned

    def _corrected_frames(self, turned: Mapping[str, Turned]) -> list[OutFrame]:
        """Frames of corrected samples; *not available* where a sensor is not fit to be used."""
        output, faults, quality = self.output, self.pipeline.health.faults, self.pipeline.quality
        out: list[OutFrame] = []
        for channel in output.triads:
            if channel in turned:
                is_faulty = faults and output.sensor_of[channel] in faults
                sent = None if is_faulty else turned[channel]
                out.append(output.corrected(channel, sent, quality))
        return out

    def idle(self, elapsed: float) -> list[OutFrame]:
        """No frame of ours came for `elapsed` seconds: close the ticks that have passed."""
        k = tick_index(self.timebase.idle(elapsed))
        out = self._advance(k, False)
        self.sent += len(out)
        return out

    def _advance(self, k: int, gap: bool) -> list[OutFrame]:
        """Close all ticks before k: status frames, then those of the consumers."""
        pipeline = self.pipeline
        first = pipeline.k
        snapshots = pipeline.gap(k) if gap else pipeline.advance(k)
        if gap and self.preprocessing is not None:
            self.preprocessing.gap()
        out = self._statuses(snapshots)
        if self.consumers:
            out += self._consumer_ticks(first, k, snapshots)
            if gap:
                for consumer in self.consumers:
                    consumer.gap()
        return out

    def _consumer_ticks(
        self, first: int, stop: int, snapshots: Sequence[Snapshot]
    ) -> list[OutFrame]:
        taken = {snapshot.k: snapshot.estimate for snapshot in snapshots}
        out: list[OutFrame] = []
        for k in range(first, stop):
            for consumer in self.consumers:
                if k in taken:
                    consumer.mounted(taken[k])
                out += consumer.tick(k)
        return out

    def _feed_consumers(self, t: float, samples: Sequence[Sample]) -> None:
        correction = self.pipeline.correction
        for channel, values in in_order(samples):
            for consumer in self.consumers:
                if channel in consumer.channels:
                    consumer.sample(t, channel, values, correction)

    def heartbeat(self) -> list[OutFrame]:
        """Status frames while no stream time passes: nothing was heard yet, or not for long."""
        pipeline = self.pipeline
        link = self._link_health()
        out = self.output.status(
            pipeline.estimator.estimate(),
            False,
            self._health(dict.fromkeys(self._watched, True), False, self._rejected_total, link, {}),
        )
        self.sent += len(out)
        return out

    def _count_rejections(self, k: int) -> None:
        total = self.router.rejected.total()
        if total > self._rejected_total:
            self._rejections.append(k)
            self._rejected_total = total

    # starting again ------------------------------------------------------------------------

    def restart_calibration(self) -> MountEstimator:
        """Forget the estimate and begin anew; all counters go on. Return the former estimator.

        Raises EstimateError where the engine was made without `new_estimator`.
        """
        if self._new_estimator is None:
            raise EstimateError("this engine cannot make a new estimator")
        return self.pipeline.replace(self._new_estimator())

    def resume_calibration(self, former: MountEstimator) -> None:
        """Take back an estimator that `restart_calibration` returned, as it was then."""
        former.gap()
        self.pipeline.replace(former)

    # columns -------------------------------------------------------------------------------

    def columns(self, frames: FrameColumns, keep: bool = True) -> FrameColumns | None:
        """Take a chunk of frames; return the frames to send (None with keep=False)."""
        parts = [
            part
            for segment in self.timebase.segments(frames.t)
            for part in self._segment(segment, frames, keep)
        ]
        if not keep:
            return None
        return merged(parts, frames)

    def _after_gap(self, segment: TimeSegment, keep: bool) -> Iterator[OutPart]:
        """Nothing is known of the time before the segment."""
        base, first = segment.start, self.pipeline.k
        snapshots = self.pipeline.gap(tick_index(float(segment.t[0])))
        if self.preprocessing is not None:
            self.preprocessing.gap()
        yield from self._status_parts(snapshots, lambda _: base, np.zeros(0), None, keep)
        out = self._consumer_ticks(first, self.pipeline.k, snapshots)
        yield from self._frame_parts(out, base)
        for consumer in self.consumers:
            consumer.gap()

    def _segment(self, segment: TimeSegment, frames: FrameColumns, keep: bool) -> Iterator[OutPart]:
        base = segment.start
        if segment.gap:
            yield from self._after_gap(segment, keep)
        whole = base == 0 and segment.stop == len(frames)
        chunk = frames if whole else frames.take(slice(base, segment.stop))
        routed = self.router.columns(segment.t, chunk)
        watched = routed.samples
        if self.preprocessing is not None:
            routed = self.preprocessing.columns(routed, segment.t, self.router.rejected)
        ticks = np.floor(segment.t * TICK_RATE).astype(np.int64)
        times = {c: segment.t[rows] for c, rows in routed.rejected.items()}
        first = self.pipeline.k
        wanted = keep or bool(self.consumers) or self._on_snapshot is not None
        corrections, snapshots = self.pipeline.run(
            routed.samples, times, float(segment.t[-1]), wanted, watched
        )
        if not wanted:
            self.sent += STATUS_FRAMES * self.pipeline.snapshots_due(first)
        events = np.floor(routed.events * TICK_RATE)
        yield from self._status_parts(
            snapshots,
            lambda k: base + int(np.searchsorted(ticks, k, side="right")),
            events,
            routed,
            keep,
        )
        self._rejected_total = self.router.rejected.total()
        recent = sorted(set(events[events > ticks[-1] - 2 * MISSING_TICKS].tolist()))
        self._rejections.extend(map(int, recent))
        for channel in self._watched:
            if channel in routed.samples:
                last = float(routed.samples[channel].t[-1])
                self._watched[channel] = tick_index(last)
        if self.consumers:
            yield from self._consumer_parts(routed, corrections, snapshots, ticks, base)
        lost = self._lost_rows(routed, segment.t)
        corrected = cache(lambda: self._corrected(routed, corrections, ticks))
        if self._on_samples is not None:
            self._on_samples(SegmentSamples(segment, chunk.t, watched, corrected))
        if keep:
            yield from self._corrected_parts(corrected(), base, lost)
        else:
            self.sent += sum(corrected_count(routed, c) + len(lost[c]) for c in lost)

    def _lost_rows(self, routed: Routed, t: NDArray[np.float64]) -> dict[str, NDArray[np.int64]]:
        """By channel the rows that are answered by a frame that says *not available*."""
        lost: dict[str, NDArray[np.int64]] = {}
        for channel in self.output.triads:
            series, bad = routed.samples.get(channel), routed.rejected.get(channel)
            if bad is None:
                lost[channel] = np.zeros(0, np.int64)
                continue
            rows = np.unique(bad) if series is None else np.setdiff1d(bad, series.row)
            lost[channel] = rows[self._spaced[channel].among(t[rows])]
        return lost

    def _corrected_parts(
        self,
        corrected: Mapping[str, CorrectedSamples],
        base: int,
        lost: Mapping[str, NDArray[np.int64]],
    ) -> Iterator[OutPart]:
        for order, channel in enumerate(self.output.triads):
            found = corrected.get(channel)
            bad = lost[channel]
            if found is None:
                if not len(bad):
                    continue
                row, turned = np.zeros(0, np.int64), np.zeros((0, 3))
                quality = np.zeros(0, np.uint8)
            else:
                row, turned, quality = found.row, found.values, found.quality
            if len(bad):
                row = np.concatenate([row, bad])
                by_row = np.argsort(row, kind="stable")
                row = row[by_row]
                turned = np.concatenate([turned, np.full((len(bad), 3), np.nan)])[by_row]
                quality = np.concatenate([quality, np.zeros(len(bad), np.uint8)])[by_row]
            can_id, data = self.output.corrected_columns(channel, turned, quality)
            # not-available frames of a row come after its corrected ones, as in `frame`
            missing = np.isin(row, bad)
            rank = np.where(missing, len(self.output.triads), 0) + order + 1
            yield OutPart(base + row, rank, np.full(len(row), can_id, np.uint32), data)
            self.sent += len(row)

    def _corrected(
        self, routed: Routed, corrections: TickCorrections, ticks: NDArray[np.int64]
    ) -> dict[str, CorrectedSamples]:
        """Corrected samples by channel; not a number where there is no correction."""
        found = {c: routed.samples[c] for c in self.output.triads if c in routed.samples}
        tick = {c: ticks[series.row] - corrections.first for c, series in found.items()}
        turned = {
            channel: times_columns(corrections.rotations[tick[channel]], series.values)
            for channel, series in found.items()
        }
        if self.preprocessing is not None:
            turned = self.preprocessing.corrected_columns(found, turned)
        for channel in self.output.planar & found.keys():
            rotations = corrections.rotations[tick[channel]]
            turned[channel] = times_level_columns(rotations, found[channel].values)
        corrected: dict[str, CorrectedSamples] = {}
        for channel, series in found.items():
            values, quality = turned[channel], corrections.quality[tick[channel]]
            unfit = corrections.unfit.get(self.output.sensor_of[channel])
            if unfit is not None:
                faulty = unfit[tick[channel]]
                values = np.where(faulty[:, None], np.nan, values)
                quality = np.where(faulty, 0, quality).astype(np.uint8)
            corrected[channel] = CorrectedSamples(series.t, values, series.row, quality)
        return corrected

    def _consumer_parts(
        self,
        routed: Routed,
        corrections: TickCorrections,
        snapshots: Sequence[Snapshot],
        ticks: NDArray[np.int64],
        base: int,
    ) -> Iterator[OutPart]:
        """Consumers take samples one by one here too; their frames stand as status frames do."""
        rotations = corrections.corrections
        k = first = corrections.first
        due = {snapshot.k: snapshot for snapshot in snapshots}

        def close(k: int) -> Iterator[OutPart]:
            out = self._consumer_ticks(k, k + 1, [due[k]] if k in due else ())
            row = base + int(np.searchsorted(ticks, k, side="right"))
            return self._frame_parts(out, row)

        for row, t, channel, values in events_of(routed.samples, self._consumed):
            tick = int(ticks[row])
            while k < tick:
                yield from close(k)
                k += 1
            for consumer in self.consumers:
                if channel in consumer.channels:
                    consumer.sample(t, channel, values, rotations[tick - first])
        while k < int(ticks[-1]):
            yield from close(k)
            k += 1

    def _frame_parts(self, out: list[OutFrame], row: int) -> Iterator[OutPart]:
        """Frames that come before those of a row's samples."""
        if out:
            yield OutPart(
                np.full(len(out), row),
                np.zeros(len(out), np.int64),
                np.array([can_id for can_id, _ in out], dtype=np.uint32),
                np.frombuffer(b"".join(data for _, data in out), np.uint8).reshape(len(out), -1),
            )
            self.sent += len(out)

    def _status_parts(
        self,
        snapshots: list[Snapshot],
        row_of: Callable[[int], int],
        events: NDArray[np.float64],
        routed: Routed | None,
        keep: bool,
    ) -> Iterator[OutPart]:
        """Status frames with the health as it was at each snapshot, not at the chunk's end."""
        if not keep:
            self._tell(snapshots)
            return
        before = self._rejected_total
        for snapshot in snapshots:
            seen = events[events <= snapshot.k]
            recent = bool(np.any(seen > snapshot.k - MISSING_TICKS)) or self._recent(snapshot.k)
            last = {c: self._last_sample(c, snapshot.k, routed) for c in self._watched}
            out = self._status(snapshot, before + len(seen), recent, last)
            yield OutPart(
                np.full(len(out), row_of(snapshot.k)),
                np.zeros(len(out), np.int64),  # one frame may close many ticks: as they come
                np.array([can_id for can_id, _ in out], dtype=np.uint32),
                np.frombuffer(b"".join(data for _, data in out), np.uint8).reshape(len(out), -1),
            )
            self.sent += len(out)

    def _tell(self, snapshots: Sequence[Snapshot]) -> None:
        """Hand snapshots on where nobody takes the frames that they would be sent in."""
        self.sent += STATUS_FRAMES * len(snapshots)
        if self._on_snapshot is not None:
            for snapshot in snapshots:
                self._on_snapshot(snapshot)

    def _last_sample(self, channel: str, k: int, routed: Routed | None) -> int:
        """Tick of the channel's last sample up to the end of tick k."""
        series = routed.samples.get(channel) if routed is not None else None
        if series is None:
            return self._watched[channel]
        n = int(np.searchsorted(np.floor(series.t * TICK_RATE), k, side="right"))
        return tick_index(float(series.t[n - 1])) if n else self._watched[channel]

    # status --------------------------------------------------------------------------------

    def health(self) -> Health:
        """What a health frame would say now; before the first frame of ours all is missing."""
        k, silent = self.pipeline.k, not self.timebase.started
        missing = {c: silent or k - last >= MISSING_TICKS for c, last in self._watched.items()}
        faults = self.pipeline.health.faults
        link = self._link_health()
        return self._health(missing, self._recent(k), self._rejected_total, link, faults)

    def _statuses(self, snapshots: list[Snapshot]) -> list[OutFrame]:
        out: list[OutFrame] = []
        for snapshot in snapshots:
            recent = self._recent(snapshot.k)
            out += self._status(snapshot, self._rejected_total, recent, self._watched)
        return out

    def _recent(self, k: int) -> bool:
        while self._rejections and self._rejections[0] <= k - MISSING_TICKS:
            self._rejections.popleft()
        return bool(self._rejections) and self._rejections[0] <= k

    def _status(
        self, snapshot: Snapshot, rejected: int, recent: bool, last: dict[str, int]
    ) -> list[OutFrame]:
        if self._on_snapshot is not None:
            self._on_snapshot(snapshot)
        missing = {c: snapshot.k - k >= MISSING_TICKS for c, k in last.items()}
        health = self._health(missing, recent, rejected, self._link_health(), snapshot.faults)
        return self.output.status(snapshot.estimate, snapshot.usable, health)

    @staticmethod
    def _health(
        missing: Mapping[str, bool],
        recent: bool,
        rejected: int,
        link: LinkHealth,
        faults: Mapping[str, Faults],
    ) -> Health:
        return Health(
            **{_SENSORS[c]: is_missing for c, is_missing in missing.items()},
            accelerometer_faulty="accel" in faults,
            gyroscope_faulty="gyro" in faults,
            magnetometer_faulty="mag" in faults,
            input_rejected=recent,
            rejected=rejected,
            frames_lost=link.frames_lost,
            id_conflict=link.id_conflict,
            send_failed=link.send_failed,
            lost=link.lost,
        )
