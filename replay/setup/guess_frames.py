"""Guesses of clocks and frames: stamps, reference sensor, time-out and tolerance."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fbench.replay.contracts.errors import FbenchError
from fbench.replay.data.arrays import Bool, Int64
from fbench.replay.data.rig import LogInfo, Mount, Rig
from fbench.replay.engine.frame_buffer import SyncParams, choose_reference
from fbench.replay.logs.setup import MAX_SKEW_NS
from fbench.replay.setup.guess_sensors import Candidate
from fbench.replay.setup.inspection import Line, Table


@dataclass(frozen=True, eq=False)
class Clocks:
    """How the stamps of the sample have to be read."""

    use_log: bool = False
    why: str = ""
    offsets_ms: Mapping[str, float] = field(default_factory=dict)  # Added to the stamps of a sensor
    notes: Mapping[str, str] = field(default_factory=dict)  # What is odd about the stamps of a sensor

    def stamps_line(self) -> Line | None:
        """Say which stamps count, where it isn't those of the headers."""
        return Line("stamps", "log", self.why, is_guess=True) if self.use_log else None

    def offset_line(self, sensor: str) -> Line | None:
        """Say what is added to the stamps of a sensor."""
        if sensor not in self.offsets_ms:
            return None
        why = "its clock is another; from the times of recording, so up to the delay of its messages"
        return Line("offset_ms", self.offsets_ms[sensor], why, is_guess=True)

    def stamps_ns(self, sensor: Candidate) -> Int64:
        """Stamps of the sample that count (N,)."""
        offset_ns = round(self.offsets_ms.get(sensor.name, 0.0) * 1e6)
        return np.array(
            [(s.log_ns if self.use_log or not s.stamp_ns else s.stamp_ns) + offset_ns for s in sensor.heard.seen],
            np.int64,
        )


def guess_clocks(sensors: Sequence[Candidate], reference: str) -> Clocks:
    """Compare stamps with the times of recording; only differences over a minute say that a clock is another one."""
    zero = [s.name for s in sensors if s.heard.seen and not any(seen.stamp_ns for seen in s.heard.seen)]
    skews = {s.name: _skews(s) for s in sensors if s.name not in zero and s.heard.seen}
    middle = {name: int(np.median(values)) for name, values in skews.items() if len(values)}
    heard = [s for s in sensors if s.heard.seen]
    if heard and len(zero) == len(heard):
        return Clocks(True, "no message has a stamp, so the times of recording are taken")
    notes = dict.fromkeys(zero, "its messages have no stamps: the times of recording are taken")
    drifting = [name for name, values in skews.items() if len(values) and int(np.ptp(values)) > MAX_SKEW_NS]
    apart = {name: skew for name, skew in middle.items() if abs(skew - middle.get(reference, 0)) > MAX_SKEW_NS}
    if drifting:
        return Clocks(True, f"the stamps of {_names(drifting)} jump against the times of recording", notes=notes)
    if apart and zero:
        return Clocks(True, f"stamps of {_names(apart)} are from another clock, {_names(zero)} has none", notes=notes)
    if zero and any(abs(skew) > MAX_SKEW_NS for skew in middle.values()):
        return Clocks(True, f"stamps aren't of the clock of the recording, and {_names(zero)} has none", notes=notes)
    return Clocks(False, "", _offsets_ms(middle, reference), notes)


def _skews(sensor: Candidate) -> Int64:
    """Stamp minus time of recording [ns] (N,)."""
    return np.array([s.stamp_ns - s.log_ns for s in sensor.heard.seen if s.stamp_ns], np.int64)


def _offsets_ms(skews: Mapping[str, int], reference: str) -> dict[str, float]:
    """Move those sensors whose stamps are far from the times of recording to the others; else to the reference."""
    if reference not in skews:
        return {}
    near = {name: skew for name, skew in skews.items() if abs(skew) <= MAX_SKEW_NS}
    target = skews[reference] if reference in near or not near else int(np.median(list(near.values())))
    return {
        name: float(round((target - skew) / 1e6)) for name, skew in skews.items() if abs(skew - target) > MAX_SKEW_NS
    }


def _names(names: Sequence[str] | Mapping[str, int]) -> str:
    return ", ".join(names)


_DEFAULT = SyncParams()
_STEP_MS = 5.0
_MAX_TOLERANCE_MS = 1e9  # As a configuration may have
_MAX_TIMEOUT_MS = 1000.0


def guess_reference(sensors: Sequence[Candidate], metadata: Mapping[str, str]) -> Line:
    """Choose the sensor whose stamps are the instants, as a replay would."""
    mounts = {s.name: Mount(s.kind, np.zeros(3), np.array([0.0, 0, 0, 1])) for s in sensors}
    nums = {s.name: s.heard.num_messages for s in sensors}
    try:
        name = choose_reference(Rig(mounts, {}), LogInfo("", "", metadata), nums, SyncParams())
    except FbenchError:
        return Line("reference", sensors[0].name, "no sensor has messages", is_guess=True)
    if metadata.get("reference") == name:
        return Line("reference", name, "the log's metadata say so")
    chosen = next(s for s in sensors if s.name == name)
    equals = [
        s for s in sensors if s.kind == chosen.kind and 0 < s.heard.num_messages <= 1.1 * chosen.heard.num_messages
    ]
    best = min(equals, key=lambda s: (-(s.heard.median_points or 0), s.name))
    what = f"the slowest, {_rate(best)}; of equals a LiDAR before a camera before a radar, then who has most points"
    return Line("reference", best.name, what)


def _rate(sensor: Candidate) -> str:
    period_ns = sensor.heard.period_ns
    return "rate unknown" if period_ns is None else f"{1e9 / period_ns:.1f} Hz"


def frames_table(sensors: Sequence[Candidate], reference: Line, clocks: Clocks) -> Table:
    """Write `[frames]`."""
    chosen = next(s for s in sensors if s.name == reference.value)
    others = [s for s in sensors if s is not chosen]
    period_ns = _stamp_period_ns(clocks.stamps_ns(chosen)) or chosen.heard.period_ns
    lines = [reference, _timeout(chosen, others, clocks, period_ns), _tolerance(period_ns)]
    if period_ns is not None and 2 * period_ns > _DEFAULT.max_gap_ns:
        lines.append(Line("max_gap_s", round(4 * period_ns / 1e9, 1), "four periods of the reference", is_guess=True))
    stamps = clocks.stamps_line()
    return Table(("frames",), tuple(lines if stamps is None else [*lines, stamps]))


def _stamp_period_ns(stamps: Int64) -> int | None:
    steps = np.sort(np.diff(np.sort(stamps, kind="stable")), kind="stable")
    return int(steps[len(steps) // 2]) or None if len(steps) else None


def _tolerance(period_ns: int | None) -> Line:
    if period_ns is None:
        return Line("tolerance_ms", _DEFAULT.tolerance_ns / 1e6, "the default: the period isn't known", is_guess=True)
    return Line(
        "tolerance_ms",
        round(min(max(period_ns / 2e6, 1.0), _MAX_TOLERANCE_MS), 1),
        f"half the period of the reference, {period_ns / 1e6:.1f} ms",
    )


def _timeout(chosen: Candidate, others: Sequence[Candidate], clocks: Clocks, period_ns: int | None) -> Line:
    """The time-out with which 99 % of the frames are complete that have all sensors at all, with a margin."""
    default_ms = _DEFAULT.timeout_ns / 1e6
    tolerance_ns = _DEFAULT.tolerance_ns if period_ns is None else period_ns // 2
    waits, num = _waits_ns(chosen, others, clocks, tolerance_ns)
    if not others:
        return Line("timeout_ms", default_ms, "the default: nothing to wait for")
    if not len(waits):
        return Line("timeout_ms", default_ms, "the default: no frame of the sample has all sensors", is_guess=True)
    late_ms = float(np.quantile(waits, 0.99)) / 1e6
    wanted = float(np.ceil(1.2 * late_ms / _STEP_MS) * _STEP_MS)
    what = f"{late_ms:.1f} ms after the reference's message 99 % of {len(waits)} sampled frames have all sensors"
    what += f"; {num - len(waits)} lack one" if num > len(waits) else ""
    if wanted > _MAX_TIMEOUT_MS:
        return Line("timeout_ms", _MAX_TIMEOUT_MS, f"{what}, too long to wait for", is_guess=True)
    return Line("timeout_ms", max(wanted, default_ms), what, is_guess=len(waits) < 0.5 * num)


def _waits_ns(chosen: Candidate, others: Sequence[Candidate], clocks: Clocks, tolerance_ns: int) -> tuple[Int64, int]:
    """How long after the reference the last sensor came [ns], for each frame that has all; and how many there are."""
    windows = sorted({s.window for s in chosen.heard.seen})
    waits: list[int] = []
    num = 0
    for window in windows:
        stamps, logs = _in_window(chosen, clocks, window)
        arrivals = [_arrivals(stamps, other, clocks, window, tolerance_ns) for other in others]
        known = np.all([a >= 0 for a in arrivals], axis=0) if arrivals else np.ones(len(stamps), bool)
        inside = _inside(stamps, others, clocks, window)
        num += int(np.count_nonzero(inside))
        rows = np.flatnonzero(known & inside)
        last = np.max(arrivals, axis=0) if arrivals else logs
        waits += np.maximum(last[rows] - logs[rows], 0).tolist()
    return np.array(waits, np.int64), num


def _in_window(sensor: Candidate, clocks: Clocks, window: int) -> tuple[Int64, Int64]:
    """Stamps and times of recording in a window, by stamp."""
    rows = np.array([s.window == window for s in sensor.heard.seen], bool)
    stamps = clocks.stamps_ns(sensor)[rows]
    logs = np.array([s.log_ns for s in sensor.heard.seen], np.int64)[rows]
    order = np.argsort(stamps, kind="stable")
    return stamps[order], logs[order]


def _inside(stamps: Int64, others: Sequence[Candidate], clocks: Clocks, window: int) -> Bool:
    """Which instants (N,) aren't at the borders of a window, where messages lie outside."""
    inside = np.ones(len(stamps), bool)
    for other in others:
        theirs, _ = _in_window(other, clocks, window)
        if len(theirs):
            inside &= (stamps >= theirs[0] - _DEFAULT.tolerance_ns) & (stamps <= theirs[-1] + _DEFAULT.tolerance_ns)
    return inside


def _arrivals(stamps: Int64, other: Candidate, clocks: Clocks, window: int, tolerance_ns: int) -> Int64:
    """When the message of another sensor that is nearest to each instant (N,) arrived [ns], -1 where none is near."""
    theirs, logs = _in_window(other, clocks, window)
    if not len(theirs):
        return np.full(len(stamps), -1)
    right = np.clip(np.searchsorted(theirs, stamps), 0, len(theirs) - 1)
    left = np.maximum(right - 1, 0)
    nearest = np.where(np.abs(theirs[left] - stamps) <= np.abs(theirs[right] - stamps), left, right)
    return np.where(np.abs(theirs[nearest] - stamps) <= tolerance_ns, logs[nearest], -1)
