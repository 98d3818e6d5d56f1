"""Reasons why sensors aren't in frames, and which of them are in hardly any."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from fbench.replay.data.arrays import Int64
from fbench.replay.data.scores import format_count
from fbench.replay.engine.frame_buffer import Arrivals, FrameBuffer, SyncParams

LEAST_SHARE = 0.1
"""A sensor that is in a smaller share of the frames isn't one that results could rest on."""
LEAST_FRAMES = 10  # Of a part of a log; fewer frames say nothing about a sensor
_NEAR = 0.51  # Beyond so many periods another message of the sensor is nearer
_FAR_NS = 1_000_000_000  # A message stamped so far from where it arrived is of another clock
_SHIFT_NS = 2_000_000_000  # Nobody waits longer for a message; rather its stamps are wrong
_STEADY = 0.2  # Of a shift that is one: so little of it varies

Kind = Literal["late", "early", "off", "never"]


class Absence(NamedTuple):
    """Why a frame lacks a sensor."""

    kind: Kind
    """`late`: its message came after the release, `early`: too long before; `off`: its stamp was too far away; `never`:
    nothing came that could have been meant.
    """
    ns: int = 0  # By how much; where `off`, stamp minus instant

    def __str__(self) -> str:
        return "never came" if self.kind == "never" else f"{self.kind} by {abs(self.ns) / 1e6:.1f} ms"


class Absences:
    """Finds reasons from the messages that came and are in no frame, when the whole log is known."""

    def __init__(self, buffer: FrameBuffer, params: SyncParams) -> None:
        self._buffer, self._params, self._counts = buffer, params, buffer.counts
        self._sorted: dict[str, tuple[Int64, Int64]] = {}

    def find(self, sensor: str, index: int, stamp_ns: int) -> Absence:
        """Say why a frame lacks a sensor that wasn't skipped."""
        late_ms = self._counts.late_ms.get((index, sensor))
        if late_ms is not None:
            return Absence("late", round(late_ms * 1e6))
        arrivals, (stamps, logs) = self._counts.arrivals[sensor], self._unused_times(sensor)
        if not len(stamps):
            return Absence("never")
        opened_ns, limit_ns = self._buffer.opened_ns[index], _near_ns(arrivals, self._params)
        row = _nearest(stamps, stamp_ns)
        away_ns = int(stamps[row]) - stamp_ns
        if abs(away_ns) > limit_ns:
            # One that came with the frame, but says that it was measured at another time.
            row = int(np.argmin(np.abs(logs - opened_ns)))
            away_ns = int(stamps[row]) - stamp_ns
            is_shifted = abs(int(logs[row]) - opened_ns) <= limit_ns and abs(away_ns) > _FAR_NS
            return Absence("off", away_ns) if is_shifted else Absence("never")
        late_ns = int(logs[row]) - opened_ns - self._params.timeout_ns
        if late_ns > 0:
            return Absence("late", late_ns)
        early_ns = opened_ns - int(logs[row])
        return Absence("early", early_ns) if early_ns > self._params.max_gap_ns else Absence("off", away_ns)

    def _unused_times(self, sensor: str) -> tuple[Int64, Int64]:
        """Stamps, ascending, and log times of the messages in no frame."""
        if sensor not in self._sorted:
            arrivals = self._counts.arrivals[sensor]
            stamps, logs = (np.array(a, np.int64) for a in (arrivals.unused_stamp_ns, arrivals.unused_log_ns))
            order = np.argsort(stamps, kind="stable")
            self._sorted[sensor] = stamps[order], logs[order]
        return self._sorted[sensor]


def _near_ns(arrivals: Arrivals, params: SyncParams) -> int:
    if arrivals.num < 2 or arrivals.last_ns == arrivals.first_ns:
        return params.max_gap_ns
    return min(round(_NEAR * (arrivals.last_ns - arrivals.first_ns) / (arrivals.num - 1)), params.max_gap_ns)


def _nearest(ascending: Int64, value: int) -> int:
    right = int(np.searchsorted(ascending, value))
    around = [row for row in (right - 1, right) if 0 <= row < len(ascending)]
    return min(around, key=lambda row: abs(int(ascending[row]) - value))


@dataclass(frozen=True)
class Shortage:
    """A sensor that came, or should have, and is in hardly any frame."""

    sensor: str
    text: str
    advice: str
    is_silent: bool = False  # Whether the log has no message of it
    shift_ns: int | None = None  # What added to its stamps would mend it, where that is so
    late_ns: int | None = None  # How much longer frames would have to wait for all of them, where that would mend it


def require_any(found: Mapping[str, Shortage], kinds: Mapping[str, str]) -> list[Shortage]:
    """Return those that matter of the shortages of sensors with these kinds. A sensor of which the log has no message
    at all may be missing where others go on: a camera beside LiDARs and radars, or any beside one that measures depth.
    """
    good = {kind for name, kind in kinds.items() if name not in found}
    goes_on = bool(good - {"camera"} if set(kinds.values()) - {"camera"} else good)
    return [one for _, one in sorted(found.items()) if not (one.is_silent and goes_on)]


def find_shortage(
    sensor: str, num_frames: int, absences: Sequence[Absence], num_skipped: int, arrivals: Arrivals, params: SyncParams
) -> Shortage | None:
    """Judge a sensor by why the frames lack it, `num_skipped` of them because its message couldn't be used; `None`
    where enough frames have it.
    """
    num_absent = len(absences) + num_skipped
    num_present = num_frames - num_absent
    if num_present >= LEAST_SHARE * num_frames:
        return None
    share = f"is in {num_present} of {num_frames} frames"
    counted = Counter(absence.kind for absence in absences)
    num, kind = max(((counted[kind], kind) for kind in ("late", "early", "off", "never")), key=lambda item: item[0])
    if num_skipped > num:
        return Shortage(sensor, f"{share}: {num_skipped} of its messages can't be used", _leave_out(sensor))
    if not arrivals.num:
        return Shortage(sensor, f"{share}: the log has no message of it", _leave_out(sensor), is_silent=True)
    came = f"{share}, although {format_count(arrivals.num, 'message')} of it came"
    amounts = np.sort(np.array([a.ns for a in absences if a.kind == kind], np.int64), kind="stable")
    middle, low, high = (int(amounts[round(q * (len(amounts) - 1))]) for q in (0.5, 0.1, 0.9))
    if kind == "late":
        wait_ms = -(-(params.timeout_ns + int(amounts[-1])) // 1_000_000)
        advice = f"--timeout-ms {wait_ms} would wait for all of them"
        if middle > _SHIFT_NS:
            advice = f"its clock may be behind: try --offset {sensor}={middle / 1e6:.0f}, or --stamps log"
        were = "frame was" if num == 1 else "frames were"
        text = f"{came}: {num} {were} released {_ms(middle)} too soon for it"
        if middle > _SHIFT_NS:
            return Shortage(sensor, text, advice, shift_ns=middle)
        return Shortage(sensor, text, advice, late_ns=int(amounts[-1]))
    if kind == "early":
        advice = f"its clock may be ahead: try --offset {sensor}={-middle / 1e6:.0f}, or --stamps log"
        text = f"{came}: {_ms(middle)} before the frames that they are stamped for"
        return Shortage(sensor, text, advice, shift_ns=-middle)
    if kind == "off":
        side = "before" if middle < 0 else "after"
        limit = f"tolerance {_ms(params.tolerance_ns)}"
        text = f"{came}: they are stamped {_ms(abs(middle))} {side} the frames' instants ({limit})"
        if abs(middle) > _SHIFT_NS or high - low <= _STEADY * abs(middle):
            advice = f"if its clock is shifted, give --offset {sensor}={-middle / 1e6:.0f}"
            return Shortage(sensor, text, advice, shift_ns=-middle)
        wanted_ms = -(-int(np.abs(amounts).max()) // 1_000_000)
        return Shortage(sensor, text, f"--tolerance-ms {wanted_ms} would take all of them")
    span_s = (arrivals.last_ns - arrivals.first_ns) / 1e9
    text = f"{came}, over {span_s:.1f} s"
    return Shortage(sensor, text, f"--reference {sensor} makes a frame of each; {_leave_out(sensor)}")


def _leave_out(sensor: str) -> str:
    return f"--sensors '!{sensor}' leaves it out"


def _ms(value_ns: int) -> str:
    return f"{value_ns / 1e6:.1f} ms" if value_ns < 10_000_000_000 else f"{value_ns / 1e9:.1f} s"
