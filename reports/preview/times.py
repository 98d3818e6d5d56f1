"""When each sensor measured, and when that was recorded."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.arrays import Float64
from fbench.replay.images import Pixels
from fbench.reports.preview import draw
from fbench.reports.preview.colors import QUIET, of_sensor
from fbench.reports.preview.plot import Axes, spanned
from fbench.reports.preview.sample import Material

WIDTH_PX, HEIGHT_PX = 1280, 300
_STEADY_MS, _DRIFT_MS, _EARLY_MS = 5.0, 10.0, 2.0


@dataclass(frozen=True)
class SensorTimes:
    """The times of one sensor; `None` where there are none."""

    sensor: str
    num_messages: int
    num_missing: int
    """Frames without it, of those that were read."""
    reasons: str
    """Why it is missing."""
    shift_ms: tuple[float, float, float] | None
    """Median, least and most of stamp minus the frame's instant [ms]."""
    delay_ms: tuple[float, float, float] | None
    """Median, least and most of log time minus stamp [ms]."""
    remarks: tuple[str, ...]
    """What is odd."""


def sensor_times(material: Material) -> Sequence[SensorTimes]:
    """Times of all sensors and streams of poses, by name."""
    names = sorted({*material.kinds, *material.num_messages})
    delays = {name: _delays(material, name) for name in names}
    usual = [float(np.median(d[:, 1])) for d in delays.values() if len(d)]
    typical = float(np.median(usual)) if usual else 0.0
    return [_times(material, name, delays[name], typical) for name in names]


def time_panel(material: Material) -> Pixels:
    """Draw stamp minus instant, and below it log time minus stamp, over the time of the log."""
    names = sorted({*material.kinds, *material.num_messages})
    shifts = {name: _shifts(material, name) for name in names}
    delays = {name: _delays(material, name) for name in names}
    picture = draw.canvas(WIDTH_PX, 2 * HEIGHT_PX + 18 * (-(-len(names) // 4)) + 10)
    both = [("stamp - instant of the frame [ms]", shifts), ("log time - stamp [ms]", delays)]
    everything = np.concatenate([np.zeros((0, 2)), *shifts.values(), *delays.values()])
    x = spanned(everything[:, 0], 0.1)
    for row, (title, series) in enumerate(both):
        y = spanned(np.concatenate([np.zeros((1, 2)), *series.values()])[:, 1], 10)
        axes = Axes((0, row * HEIGHT_PX, WIDTH_PX, HEIGHT_PX), x, y)
        axes.draw(picture, title, "log time [s]" if row else "", "")
        for number, name in enumerate(names):
            axes.line(picture, _with_gaps(series[name]), of_sensor(number))
            axes.dots(
                picture, series[name], np.full((len(series[name]), 3), of_sensor(number), np.uint8), max(2, 6 - number)
            )
    for number, name in enumerate(names):
        at = (14 + number % 4 * 316, 2 * HEIGHT_PX + 14 + number // 4 * 18)
        draw.write(picture, draw.plain(name), (at[0] + 16, at[1]), of_sensor(number))
        draw.disks(picture, np.array([[at[0] + 6, at[1] - 4]]), np.array([4]), np.array([of_sensor(number)], np.uint8))
    if not len(everything):
        draw.write(picture, "no messages", (WIDTH_PX // 2, HEIGHT_PX // 2), QUIET)
    return picture


def _times(material: Material, name: str, delays: Float64, typical_ms: float) -> SensorTimes:
    shifts = _shifts(material, name)
    why = material.missing.get(name, {})
    remarks: list[str] = []
    if name != material.reference and len(shifts):
        remarks += _shift_remarks(shifts[:, 1])
    if len(delays):
        remarks += _delay_remarks(delays, typical_ms)
    return SensorTimes(
        name, material.num_messages.get(name, 0), sum(why.values()),
        "; ".join(f"{reason} ({num})" for reason, num in why.items()), _spread(shifts), _spread(delays), tuple(remarks),
    )  # fmt: skip


def _shift_remarks(shifts_ms: Float64) -> list[str]:
    middle = float(np.median(shifts_ms))
    low, high = np.quantile(shifts_ms, 0.05), np.quantile(shifts_ms, 0.95)
    if abs(middle) > _STEADY_MS and high - low < 0.5 * abs(middle):
        return [f"always about {middle:+.1f} ms from the frame's instant"]
    if high - low > 4 * _STEADY_MS and _trend_ms(shifts_ms) > 0.5 * (high - low):
        return [f"drifts against the frame's instants, from {shifts_ms[0]:+.1f} to {shifts_ms[-1]:+.1f} ms"]
    return []


def _delay_remarks(delays: Float64, typical_ms: float) -> list[str]:
    middle, remarks = float(np.median(delays[:, 1])), []
    if middle < -_EARLY_MS:
        remarks.append(f"recorded {-middle:.1f} ms before its own stamp: its clock is ahead, or an offset is wrong")
    elif abs(middle - typical_ms) > 100:
        remarks.append(
            f"recorded {middle:.1f} ms after its stamp, others {typical_ms:.1f} ms: a slow sensor or a clock"
        )
    drift = _trend_ms(delays[:, 1])
    if drift > _DRIFT_MS and drift > 3 * float(np.median(np.abs(np.diff(delays[:, 1])))):
        remarks.append(f"its clock drifts by {drift:.1f} ms against the recorder's")
    return remarks


def _trend_ms(values: Float64) -> float:
    """How far the medians of the first and the last third lie apart; 0 with under nine values."""
    third = len(values) // 3
    return abs(float(np.median(values[-third:]) - np.median(values[:third]))) if third >= 3 else 0.0


def _spread(series: Float64) -> tuple[float, float, float] | None:
    if not len(series):
        return None
    values = series[:, 1]
    return float(np.median(values)), float(values.min()), float(values.max())


def _shifts(material: Material, name: str) -> Float64:
    """Seconds since the first instant and stamp minus instant [ms], (N, 2)."""
    start_ns = _start_ns(material)
    rows = [
        ((i.stamp_ns - start_ns) / 1e9, (i.stamps_ns[name] - i.stamp_ns) / 1e6)
        for i in material.instants
        if name in i.stamps_ns
    ]
    return np.array(rows, np.float64).reshape(-1, 2)


def _delays(material: Material, name: str) -> Float64:
    """Seconds since the first instant and log time minus stamp [ms], (N, 2)."""
    start_ns = _start_ns(material)
    rows = [((a.stamp_ns - start_ns) / 1e9, (a.log_ns - a.stamp_ns) / 1e6) for a in material.arrivals.get(name, ())]
    return np.array(rows, np.float64).reshape(-1, 2)


def _start_ns(material: Material) -> int:
    return material.instants[0].stamp_ns if material.instants else 0


def _with_gaps(series: Float64) -> Float64:
    """Break a line where nothing came for five times as long as usual."""
    if len(series) < 3:
        return series
    steps = np.diff(series[:, 0])
    breaks = np.flatnonzero(steps > 5 * np.median(steps)) + 1
    return np.insert(series, breaks, np.nan, axis=0)
