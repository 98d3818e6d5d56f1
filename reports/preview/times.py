"""Plots, and the times at which each sensor measured and was recorded."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from fbench.replay.data.arrays import Float64
from fbench.replay.data.images import Pixels
from fbench.reports.preview import draw
from fbench.reports.preview.draw import GRID, INK, QUIET, Color, Colors, of_sensor
from fbench.reports.preview.sample import Material

WIDTH_PX, HEIGHT_PX = 1280, 300
_MARGIN = (58, 30, 14, 34)  # Left, top, right and bottom [px]
_STEADY_MS, _DRIFT_MS, _EARLY_MS = 5.0, 10.0, 2.0


@dataclass(frozen=True)
class Axes:
    """A rectangle of a picture that shows a range of numbers."""

    rect: tuple[int, int, int, int]  # Left, top, width and height [px], margins for labels included
    x: tuple[float, float]
    y: tuple[float, float]

    def to_picture(self, xy: Float64) -> Float64:
        """Move (N, 2) numbers into the picture."""
        left, top, width, height = self._inner
        share_x = (xy[:, 0] - self.x[0]) / (self.x[1] - self.x[0])
        share_y = (xy[:, 1] - self.y[0]) / (self.y[1] - self.y[0])
        return np.stack([left + share_x * width, top + (1 - share_y) * height], axis=1)

    def draw(self, picture: Pixels, title: str, x_name: str, y_name: str) -> None:
        """Draw frame, grid, numbers and names."""
        import cv2

        left, top, width, height = self._inner
        for value in ticks(*self.x, max(3, width // 65)):
            line, text = self.to_picture(np.array([[value, self.y[0]], [value, self.y[1]]])), f"{value:g}"
            draw.path(picture, line, GRID)
            draw.write(picture, text, (line[0, 0] - draw.text_size(text)[0] / 2, top + height + 14), QUIET)
        for value in ticks(*self.y, max(2, height // 40)):
            line, text = self.to_picture(np.array([[self.x[0], value], [self.x[1], value]])), f"{value:g}"
            draw.path(picture, line, QUIET if value == 0 else GRID)
            draw.write(picture, text, (left - 6 - draw.text_size(text)[0], line[0, 1] + 4), QUIET)
        cv2.rectangle(picture, (left, top), (left + width, top + height), QUIET, 1)
        draw.write(picture, title, (left, top - 17), INK)
        draw.write(picture, y_name, (left + 4, top - 3), QUIET)
        draw.write(picture, x_name, (left + width - draw.text_size(x_name)[0], top + height + 29), QUIET)

    def line(self, picture: Pixels, xy: Float64, color: Color, thickness: int = 1) -> None:
        """Join numbers (N, 2) by a line; it is broken where one isn't finite."""
        draw.path(picture, self.to_picture(self._bound(xy)), color, thickness)

    def dots(self, picture: Pixels, xy: Float64, colors: Colors, radius: int = 2) -> None:
        """Mark numbers (N, 2); those outside are marked at the border."""
        xy = self._bound(xy[np.isfinite(xy).all(axis=1)])
        draw.disks(picture, self.to_picture(xy), np.full(len(xy), radius), colors)

    def _bound(self, xy: Float64) -> Float64:
        return np.clip(xy, [self.x[0], self.y[0]], [self.x[1], self.y[1]])

    @property
    def _inner(self) -> tuple[int, int, int, int]:
        left, top, right, bottom = _MARGIN
        x, y, width, height = self.rect
        return x + left, y + top, width - left - right, height - top - bottom


def ticks(low: float, high: float, num: int) -> list[float]:
    """About `num` round numbers in a range: multiples of 1, 2 or 5 times a power of ten."""
    rough = (high - low) / num
    power = 10.0 ** np.floor(np.log10(rough))
    step = power * next(m for m in (1, 2, 5, 10) if m * power >= rough * 0.999)
    first, last = int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9))
    return [float(round(i * step, 9)) + 0.0 for i in range(first, last + 1)]


def span_axes(values: Float64, least: float) -> tuple[float, float]:
    """A range around all finite values, at least `least` wide, with a margin."""
    finite = values[np.isfinite(values)]
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 0.0)
    pad = max(0.08 * (high - low), (least - (high - low)) / 2)
    return low - pad, high + pad


@dataclass(frozen=True)
class SensorTimes:
    """The times of one sensor; `None` where there are none."""

    sensor: str
    num_messages: int
    num_missing: int  # Frames without it, of those that were read
    reasons: str  # Why it is missing
    shift_ms: tuple[float, float, float] | None  # Median, least and most of stamp minus the frame's instant [ms]
    delay_ms: tuple[float, float, float] | None  # Median, least and most of log time minus stamp [ms]
    remarks: tuple[str, ...]  # What is odd


def sensor_times(material: Material) -> Sequence[SensorTimes]:
    """Times of all sensors and streams of poses, by name."""
    shifts_of, delays = _measure(material)
    usual = [float(np.median(d[:, 1])) for d in delays.values() if len(d)]
    typical_ms, times = float(np.median(usual)) if usual else 0.0, []
    for name, shifts in shifts_of.items():
        why = material.missing.get(name, {})
        remarks = _shift_remarks(shifts[:, 1]) if name != material.reference and len(shifts) else []
        remarks += _delay_remarks(delays[name], typical_ms) if len(delays[name]) else []
        reasons = "; ".join(f"{reason} ({num})" for reason, num in why.items())
        shift_ms, delay_ms = (
            (float(np.median(ms)), float(ms.min()), float(ms.max())) if len(ms) else None
            for ms in (shifts[:, 1], delays[name][:, 1])
        )
        num = material.num_messages.get(name, 0)
        times.append(SensorTimes(name, num, sum(why.values()), reasons, shift_ms, delay_ms, tuple(remarks)))
    return times


def time_panel(material: Material) -> Pixels:
    """Draw stamp minus instant, and below it log time minus stamp, over the time of the log."""
    shifts, delays = _measure(material)
    names = list(shifts)
    picture = draw.canvas(WIDTH_PX, 2 * HEIGHT_PX + 18 * (-(-len(names) // 4)) + 10)
    both = [("stamp - instant of the frame [ms]", shifts), ("log time - stamp [ms]", delays)]
    everything = np.concatenate([np.zeros((0, 2)), *shifts.values(), *delays.values()])
    x = span_axes(everything[:, 0], 0.1)
    for row, (title, series) in enumerate(both):
        y = span_axes(np.concatenate([np.zeros((1, 2)), *series.values()])[:, 1], 10)
        axes = Axes((0, row * HEIGHT_PX, WIDTH_PX, HEIGHT_PX), x, y)
        axes.draw(picture, title, "log time [s]" if row else "", "")
        for number, name in enumerate(names):
            line, color = series[name], of_sensor(number)
            axes.line(picture, _with_gaps(line), color)
            axes.dots(picture, line, np.full((len(line), 3), color, np.uint8), max(2, 6 - number))
    for number, name in enumerate(names):
        at = (14 + number % 4 * 316, 2 * HEIGHT_PX + 14 + number // 4 * 18)
        draw.write(picture, draw.plain(name), (at[0] + 16, at[1]), of_sensor(number))
        draw.disks(picture, np.array([[at[0] + 6, at[1] - 4]]), np.array([4]), np.array([of_sensor(number)], np.uint8))
    if not len(everything):
        draw.write(picture, "no messages", (WIDTH_PX // 2, HEIGHT_PX // 2), QUIET)
    return picture


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
        after = f"{middle:.1f} ms after its stamp, others {typical_ms:.1f} ms"
        remarks.append(f"recorded {after}: a slow sensor or a clock")
    drift = _trend_ms(delays[:, 1])
    if drift > _DRIFT_MS and drift > 3 * float(np.median(np.abs(np.diff(delays[:, 1])))):
        remarks.append(f"its clock drifts by {drift:.1f} ms against the recorder's")
    return remarks


def _trend_ms(values: Float64) -> float:
    """How far the medians of the first and the last third lie apart; 0 with under nine values."""
    third = len(values) // 3
    return abs(float(np.median(values[-third:]) - np.median(values[:third]))) if third >= 3 else 0.0


def _measure(material: Material) -> tuple[dict[str, Float64], dict[str, Float64]]:
    """By sensor and stream of poses, sorted: seconds since the first instant and (N, 2) stamp minus instant [ms]; the
    same and log time minus stamp [ms].
    """
    start_ns = material.instants[0].stamp_ns if material.instants else 0

    def series(both_ns: Iterable[tuple[int, int]]) -> Float64:
        return np.array([((at - start_ns) / 1e9, by / 1e6) for at, by in both_ns], np.float64).reshape(-1, 2)

    shifts, delays = dict[str, Float64](), dict[str, Float64]()
    for name in sorted({*material.kinds, *material.num_messages}):
        own = ((i.stamp_ns, i.stamps_ns[name] - i.stamp_ns) for i in material.instants if name in i.stamps_ns)
        shifts[name] = series(own)
        delays[name] = series((at, log_ns - at) for at, log_ns in material.arrivals.get(name, ()))
    return shifts, delays


def _with_gaps(series: Float64) -> Float64:
    """Break a line where nothing came for five times as long as usual."""
    if len(series) < 3:
        return series
    steps = np.diff(series[:, 0])
    breaks = np.flatnonzero(steps > 5 * np.median(steps)) + 1
    return np.insert(series, breaks, np.nan, axis=0)
