"""Sensors that frames of a replay lack: what is said of each, and of those that hardly any frame has."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property

from fbench.replay.data.frames import Frame
from fbench.replay.engine.absence import Absence, Absences, Shortage, find_shortage, require_any
from fbench.replay.engine.frame_buffer import NOT_THERE
from fbench.replay.engine.frames import FrameStream
from fbench.replay.runs.folder import FrameRecord


class MissingSensors:
    """Says why frames lack sensors, when all of a log was read."""

    def __init__(self, stream: FrameStream) -> None:
        self._stream = stream
        self._lacking: dict[str, list[int]] = {}  # Rows of the frames that lack a sensor, by sensor

    def note(self, frame: Frame, row: int) -> None:
        """Remember which sensors a frame lacks."""
        for sensor in frame.missing:
            self._lacking.setdefault(sensor, []).append(row)

    @cached_property
    def _absences(self) -> Absences:
        return Absences(self._stream.buffer, self._stream.sync)

    def explain(self, record: FrameRecord) -> FrameRecord:
        """Say of each sensor that wasn't there in time whether it was skipped, came too late or never."""
        missing: dict[str, str] = {}
        for sensor, reason in record.missing.items():
            is_late = (record.index, sensor) in self._stream.buffer.counts.late_ms
            if not (is_late or reason.startswith(NOT_THERE)):
                missing[sensor] = reason
                continue
            why = self._find(sensor, record)
            # What comes too late behind the end of an excerpt isn't read, so 'never' can't be said.
            is_unknown = self._stream.is_cut and isinstance(why, Absence) and why.kind == "never"
            missing[sensor] = reason if is_unknown else f"skipped: {why}" if isinstance(why, str) else str(why)
        return replace(record, missing=missing)

    def _find(self, sensor: str, record: FrameRecord) -> Absence | str:
        """Say why a frame lacks a sensor; a text where its message was there, but couldn't be used."""
        if (record.index, sensor) not in self._stream.buffer.counts.late_ms:
            skipped = self._stream.skipped.reason(sensor, record.stamp_ns, record.frame_number)
            if skipped is not None:
                return skipped
        return self._absences.find(sensor, record.index, record.stamp_ns)

    def find_shortages(
        self, needed: Sequence[str], records: Sequence[FrameRecord], kinds: Mapping[str, str]
    ) -> list[Shortage]:
        """Return those of the sensors needed, each of which came, that hardly any frame has."""
        found: dict[str, Shortage] = {}
        for name in needed:
            reasons = [self._find(name, records[row]) for row in self._lacking.get(name, [])]
            absences = [reason for reason in reasons if isinstance(reason, Absence)]
            num_skipped, arrivals = len(reasons) - len(absences), self._stream.buffer.counts.arrivals[name]
            shortage = find_shortage(name, len(records), absences, num_skipped, arrivals, self._stream.sync)
            found |= {} if shortage is None else {name: shortage}
        return require_any(found, {name: kinds.get(name, "") for name in needed})
