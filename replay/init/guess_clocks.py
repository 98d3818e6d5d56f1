"""Which stamps count, and what makes the clocks of all sensors one."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from fbench.replay.arrays import Int64
from fbench.replay.init.draft import Line
from fbench.replay.init.guess_sensors import Candidate
from fbench.replay.restamp import MAX_SKEW_NS


@dataclass(frozen=True, eq=False)
class Clocks:
    """How the stamps of the sample have to be read."""

    use_log: bool = False
    why: str = ""
    offsets_ms: Mapping[str, float] = field(default_factory=dict)
    """Added to the stamps of a sensor."""
    notes: Mapping[str, str] = field(default_factory=dict)
    """What is odd about the stamps of a sensor."""

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
