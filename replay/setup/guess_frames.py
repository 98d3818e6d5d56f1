"""Guesses of clocks and frames: stamps, reference sensor, time-out and tolerance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fbench.replay.contracts.errors import FbenchError
from fbench.replay.data.arrays import Int64
from fbench.replay.data.rig import LogInfo
from fbench.replay.engine.frame_buffer import SyncParams, choose_reference
from fbench.replay.logs.setup import MAX_SKEW_NS
from fbench.replay.setup.guess_sensors import Candidate
from fbench.replay.setup.inspection import Line, Table, median_step


@dataclass(frozen=True, eq=False)
class Clocks:
    """How the stamps of the sample have to be read."""

    log_why: str = ""  # Why log times are used; empty: stamps are
    offsets_ms: Mapping[str, float] = field(default_factory=dict)  # Added to the stamps of a sensor
    notes: Mapping[str, str] = field(default_factory=dict)  # What is odd about the stamps of a sensor

    def stamps_ns(self, sensor: Candidate) -> Int64:
        """Stamps of the sample that count (N,)."""
        offset_ns = round(self.offsets_ms.get(sensor.name, 0.0) * 1e6)
        stamps = [s.log_ns if self.log_why or not s.stamp_ns else s.stamp_ns for s in sensor.sampled.samples]
        return np.array(stamps, np.int64) + offset_ns


def guess_clocks(sensors: Sequence[Candidate], reference: str) -> Clocks:
    """Compare stamps with the times of recording; only differences over a minute say that a clock is another one."""
    sampled = [s for s in sensors if s.sampled.samples]
    # Stamps minus times of recording [ns].
    skews = {s.name: [m.stamp_ns - m.log_ns for m in s.sampled.samples if m.stamp_ns] for s in sampled}
    zero = [name for name, values in skews.items() if not values]
    skews = {name: values for name, values in skews.items() if values}
    if zero and not skews:
        return Clocks("no message has a stamp: recording times are used")
    middle = {name: int(np.median(np.array(values, np.int64))) for name, values in skews.items()}
    notes = dict.fromkeys(zero, "its messages have no stamps: recording times are used")
    drifting = [name for name, values in skews.items() if max(values) - min(values) > MAX_SKEW_NS]
    apart = [name for name, skew in middle.items() if abs(skew - middle.get(reference, 0)) > MAX_SKEW_NS]
    without, why = ", ".join(zero), ""
    if drifting:
        why = f"the stamps of {', '.join(drifting)} jump relative to the recording times"
    elif apart and zero:
        why = f"stamps of {', '.join(apart)} come from another clock, and {without} has no stamps"
    elif zero and any(abs(skew) > MAX_SKEW_NS for skew in middle.values()):
        why = f"stamps don't come from the recording clock, and {without} has no stamps"
    if why or reference not in middle:
        return Clocks(why, notes=notes)
    # Sensors whose stamps are far from the times of recording are moved to the others; else to the reference.
    near = {name: skew for name, skew in middle.items() if abs(skew) <= MAX_SKEW_NS}
    target = middle[reference] if reference in near or not near else int(np.median(list(near.values())))
    far = {name: skew for name, skew in middle.items() if abs(skew - target) > MAX_SKEW_NS}
    return Clocks(offsets_ms={name: float(round((target - skew) / 1e6)) for name, skew in far.items()}, notes=notes)


_DEFAULT = SyncParams()
_STEP_MS = 5.0
_MAX_TOLERANCE_MS = 1e9  # As a configuration may have
_MAX_TIMEOUT_MS = 1000.0


def guess_reference(sensors: Sequence[Candidate], metadata: Mapping[str, str]) -> Line:
    """Choose the sensor whose stamps are the instants, as a replay would."""
    kinds, nums = {s.name: s.kind for s in sensors}, {s.name: s.sampled.num_messages for s in sensors}
    try:
        name = choose_reference(kinds, LogInfo("", "", metadata), nums, SyncParams())
    except FbenchError:
        return Line("reference", sensors[0].name, "no sensor has messages", is_guess=True)
    if metadata.get("reference") == name:
        return Line("reference", name, "from the log's metadata")
    equals = [s for s in sensors if s.kind == kinds[name] and 0 < nums[s.name] <= 1.1 * nums[name]]
    best = min(equals, key=lambda s: (-(s.sampled.median_points or 0), s.name))
    rate = best.sampled.rate_text or "rate unknown"
    what = f"the slowest, {rate}; ties: LiDAR, camera, radar, then the most points"
    return Line("reference", best.name, what)


def frames_table(sensors: Sequence[Candidate], reference: Line, clocks: Clocks) -> Table:
    """Write `[frames]`."""
    chosen = next(s for s in sensors if s.name == reference.value)
    others = [s for s in sensors if s is not chosen]
    stamps = np.sort(clocks.stamps_ns(chosen), kind="stable")
    period_ns = median_step(stamps) or chosen.sampled.period_ns
    default_ms = _DEFAULT.tolerance_ns / 1e6
    tolerance = Line("tolerance_ms", default_ms, "default: the period is unknown", is_guess=True)
    if period_ns is not None:
        half_ms = round(min(max(period_ns / 2e6, 1.0), _MAX_TOLERANCE_MS), 1)
        tolerance = Line("tolerance_ms", half_ms, f"half the period of the reference, {period_ns / 1e6:.1f} ms")
    lines = [reference, _timeout_line(chosen, others, clocks, period_ns), tolerance]
    if period_ns is not None and 2 * period_ns > _DEFAULT.max_gap_ns:
        lines.append(Line("max_gap_s", round(4 * period_ns / 1e9, 1), "four periods of the reference", is_guess=True))
    if clocks.log_why:
        lines.append(Line("stamps", "log", clocks.log_why, is_guess=True))
    return Table(("frames",), tuple(lines))


def _timeout_line(chosen: Candidate, others: Sequence[Candidate], clocks: Clocks, period_ns: int | None) -> Line:
    """The time-out with which 99 % of the frames are complete that have all sensors at all, with a margin."""
    default_ms = _DEFAULT.timeout_ns / 1e6
    if not others:
        return Line("timeout_ms", default_ms, "default: nothing to wait for")
    waits, num = _waits_ns(chosen, others, clocks, _DEFAULT.tolerance_ns if period_ns is None else period_ns // 2)
    if not len(waits):
        return Line("timeout_ms", default_ms, "default: no sampled frame has all sensors", is_guess=True)
    late_ms = float(np.quantile(waits, 0.99)) / 1e6
    wanted = float(np.ceil(1.2 * late_ms / _STEP_MS) * _STEP_MS)
    what = f"{late_ms:.1f} ms after the reference's message, 99 % of {len(waits)} sampled frames are complete"
    what += f"; {num - len(waits)} lack one" if num > len(waits) else ""
    if wanted > _MAX_TIMEOUT_MS:
        return Line("timeout_ms", _MAX_TIMEOUT_MS, f"{what}, too long to wait for", is_guess=True)
    return Line("timeout_ms", max(wanted, default_ms), what, is_guess=len(waits) < 0.5 * num)


def _waits_ns(chosen: Candidate, others: Sequence[Candidate], clocks: Clocks, tolerance_ns: int) -> tuple[Int64, int]:
    """How long after the reference the last sensor came [ns], in frames that have all; and the number of frames."""
    waits: list[int] = []
    num = 0
    for window in sorted({s.window for s in chosen.sampled.samples}):
        stamps, logs = _times_in(window, chosen, clocks)
        inside, known, last = np.ones(len(stamps), bool), np.ones(len(stamps), bool), logs
        for other in others:
            theirs, arrived = _times_in(window, other, clocks)
            if not len(theirs):
                known[:] = False
                continue
            inside &= (stamps >= theirs[0] - _DEFAULT.tolerance_ns) & (stamps <= theirs[-1] + _DEFAULT.tolerance_ns)
            right = np.clip(np.searchsorted(theirs, stamps), 0, len(theirs) - 1)
            left = np.maximum(right - 1, 0)
            nearest = np.where(np.abs(theirs[left] - stamps) <= np.abs(theirs[right] - stamps), left, right)
            known &= np.abs(theirs[nearest] - stamps) <= tolerance_ns
            last = np.maximum(last, arrived[nearest])
        num += int(np.count_nonzero(inside))  # not those at the borders of a window, where messages lie outside
        waits += (last - logs)[known & inside].tolist()
    return np.array(waits, np.int64), num


def _times_in(window: int, sensor: Candidate, clocks: Clocks) -> tuple[Int64, Int64]:
    rows = np.array([s.window == window for s in sensor.sampled.samples], bool)
    stamps = clocks.stamps_ns(sensor)[rows]
    logs = np.array([s.log_ns for s in sensor.sampled.samples], np.int64)[rows]
    order = np.argsort(stamps, kind="stable")
    return stamps[order], logs[order]
