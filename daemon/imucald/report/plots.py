"""Pictures of the residual of one signal as SVG: over time, over its main input, and over
frequency."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from imucald.core.arrays import Array
from imucald.diagnosis.result import SignalPicture
from imucald.report.decimation import clearest_segment, envelope, log_bins, trend
from imucald.report.numbers import unit_text
from imucald.report.svg_figures import drawn, legend, without_name_space

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    Dashes = str | tuple[int, tuple[float, float]]

BEFORE, AFTER, MEASURED, FLOOR = "#D55E00", "#0072B2", "#222222", "#6B6B6B"
"""Colours: vermilion, blue, nearly black, grey. These colours are distinguishable with any colour
blindness (Okabe and Ito)."""

MINUTES_FROM_S = 300.0
"""Time axes above this length are in minutes [s]."""
DECADES = 6
"""Number of decades of a spectrum that are shown, from its highest value downwards."""
FEW_DECADES = 60.0
"""A logarithmic axis has ticks at 2 and 5 too if the ratio of its ends is below this value."""
RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
EXTREME = 99.7
"""This percentile of the residual's size determines the range of the axis. Single spikes may be
outside the picture."""


def time_picture(p: SignalPicture) -> str:
    """Draw the residual before and after the extension over time: range and mean in short
    segments."""
    return _picture(_draw_time, p, (9.6, 2.5))


def segment_picture(p: SignalPicture) -> str:
    """Draw measured and predicted signal in the segment with the largest reduction of the
    residual."""
    return _picture(_draw_stretch, p, (9.6, 2.5))


def driver_picture(p: SignalPicture) -> str:
    """Draw the residual over the input signal with which it correlates most: mean and spread in
    bins."""
    return _picture(_draw_driver, p, (4.7, 2.9))


def spectrum_picture(p: SignalPicture) -> str:
    """Draw the spectrum of the residual before and after the extension."""
    return _picture(_draw_spectrum, p, (4.7, 2.9))


def _picture(
    draw: Callable[[Axes, SignalPicture], None], p: SignalPicture, size: tuple[float, float]
) -> str:
    return without_name_space(drawn(lambda figure: draw(figure.add_subplot(), p), size))


@dataclass(frozen=True)
class _Curve:
    name: str
    predicted: Array
    density: Array
    colour: str
    mark: str
    dashes: Dashes
    shade: float


def _curves(p: SignalPicture) -> list[_Curve]:
    """Return the curves before and after the extension; only one curve if the model was not
    extended."""
    before = _Curve("before", p.predicted_before, p.spectrum_before, BEFORE, "s", (0, (5, 2)), 0.28)
    after = _Curve("after", p.predicted_after, p.spectrum_after, AFTER, "o", "solid", 0.4)
    if not is_extended(p):
        return [replace(after, name="")]
    return [before, after]


def is_extended(p: SignalPicture) -> bool:
    """Return whether the extended model changes the prediction of this signal."""
    return not np.array_equal(p.predicted_before, p.predicted_after, equal_nan=True)


def _draw_time(axes: Axes, p: SignalPicture) -> None:
    factor = _time_axis(axes, p.t)
    for order, curve in enumerate(_curves(p), 1):
        band = envelope(p.t, p.measured - curve.predicted, 420)
        t, colour = factor * band.t, curve.colour
        axes.fill_between(t, band.low, band.high, color=colour, alpha=curve.shade, lw=0,
                          zorder=order)  # fmt: skip
        axes.plot(t, band.mean, color=colour, lw=1.1, zorder=order + 2, label=curve.name)
    axes.axhline(0.0, color=FLOOR, lw=0.7)
    _limit(axes, [p.measured - curve.predicted for curve in _curves(p)])
    axes.margins(x=0.005)
    axes.set_ylabel(f"residual [{unit_text(p.unit)}]")
    legend(axes)


def _draw_stretch(axes: Axes, p: SignalPicture) -> None:
    before, after = p.measured - p.predicted_before, p.measured - p.predicted_after
    rows = clearest_segment(p.t, before, after, 45.0)
    t = p.t[rows]
    axes.plot(t, p.measured[rows], color=MEASURED, lw=1.0, label="measured")
    known = np.isfinite(p.measured[rows])
    for curve in _curves(p):
        predicted = np.where(known, curve.predicted[rows], np.nan)
        axes.plot(t, predicted, color=curve.colour, lw=1.2, ls=curve.dashes,
                  label=f"predicted {curve.name}".strip())  # fmt: skip
    axes.margins(x=0.005)
    axes.xaxis.set_major_formatter(FuncFormatter(_clock_text))
    axes.set_xlabel("time [min:s]")
    axes.set_ylabel(f"[{unit_text(p.unit)}]")
    legend(axes)


def _draw_driver(axes: Axes, p: SignalPicture) -> None:
    for curve in _curves(p):
        line = trend(p.driver, p.measured - curve.predicted, 24, 12)
        axes.fill_between(line.x, line.low, line.high, color=curve.colour, alpha=0.2, lw=0)
        axes.plot(line.x, line.mean, color=curve.colour, lw=1.2, marker=curve.mark, ms=3,
                  label=curve.name)  # fmt: skip
    axes.axhline(0.0, color=FLOOR, lw=0.7)
    axes.set_xlabel(unit_text(p.driver_name))
    axes.set_ylabel(f"residual [{unit_text(p.unit)}]")
    legend(axes)


def _draw_spectrum(axes: Axes, p: SignalPicture) -> None:
    for curve in _curves(p):
        line = log_bins(p.frequency, curve.density, 160)
        axes.plot(*line, color=curve.colour, lw=1.2, ls=curve.dashes,
                  label=curve.name or "residual")  # fmt: skip
    if any(len(line.get_xdata()) for line in axes.lines):  # type: ignore[arg-type]
        for axis, scale in ((axes.xaxis, axes.set_xscale), (axes.yaxis, axes.set_yscale)):
            scale("log")
            axis.set_major_formatter(FuncFormatter(_power_text))
            axis.set_minor_formatter(NullFormatter())
        _trim_depth(axes)
        for axis, (low, high) in ((axes.xaxis, axes.get_xlim()), (axes.yaxis, axes.get_ylim())):
            if high < FEW_DECADES * low:
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.set_xlabel("frequency [Hz]")
    axes.set_ylabel(f"density [({unit_text(p.unit)})²/Hz]")
    legend(axes)


def _time_axis(axes: Axes, t: Array) -> float:
    """Label the time axis. Return the factor that converts seconds to the unit of the axis."""
    known = t[np.isfinite(t)]
    long = len(known) > 0 and float(np.ptp(known)) > MINUTES_FROM_S
    axes.set_xlabel("time [min]" if long else "time [s]")
    return 1.0 / 60.0 if long else 1.0


def _limit(axes: Axes, residuals: list[Array]) -> None:
    every = np.abs(np.concatenate(residuals))
    every = every[np.isfinite(every)]
    size = 1.15 * float(np.percentile(every, EXTREME)) if len(every) else 0.0
    if size > 0.0:
        axes.set_ylim(-size, size)


def _trim_depth(axes: Axes) -> None:
    """Limit the axis of a spectrum to `DECADES` below the highest value. Smaller values, at
    frequencies above the sensor's bandwidth, contain no information."""
    low, high = axes.get_ylim()
    tops = [np.max(line.get_ydata()) for line in axes.lines if len(line.get_ydata())]  # type: ignore[arg-type]
    if tops:
        high = 2.0 * float(max(tops))
        axes.set_ylim(max(low, high * 10.0**-DECADES), high)


def _power_text(x: float, _: object) -> str:
    """Return a number as text: `0.02`, `10`, or a power of ten with superscript digits (without
    matplotlib's formula text)."""
    if x <= 0.0:
        return ""
    power = math.floor(math.log10(x) + 1e-9)
    if -3 < power < 4:
        return f"{x:g}"
    factor = round(x / 10.0**power)
    return ("" if factor == 1 else f"{factor}·") + "10" + str(power).translate(RAISED)


def _clock_text(seconds: float, _: object) -> str:
    """Return a time as text, such as `23:06`, with tenths of a second if the segment is short."""
    sign, seconds = ("-" if seconds < 0 else ""), abs(round(seconds, 1))
    minutes, rest = divmod(seconds, 60.0)
    return (
        f"{sign}{minutes:.0f}:{rest:02.0f}"
        if rest % 1 == 0
        else f"{sign}{minutes:.0f}:{rest:04.1f}"
    )
