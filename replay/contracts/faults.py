"""The fault table: what can be wrong with data, how fbench behaves, how it is counted, and how much may be lost."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Literal

from fbench.replay.contracts.errors import ConfigError, LogError, did_you_mean
from fbench.replay.runs.secrets import without_secrets

Behaviour = Literal["fatal", "count", "degrade"]


@dataclass(frozen=True)
class FaultKind:
    """One row of the table."""

    behaviour: Behaviour
    """`fatal`: an error with this code, exit 3 (2 where a wrong option is the cause); `count`: data was skipped, exit 4
    beyond the budget; `degrade`: went on with less, flagged only."""
    text: str


UNVERIFIED = "LOG006"  # Flipped bits would go unnoticed
UNREAD, UNREAD_SENSOR = "LOG012", "LOG013"
FAULTS: dict[str, FaultKind] = {
    "LOG001": FaultKind("fatal", "not a log"),
    "LOG002": FaultKind("count", "log is truncated"),
    "LOG003": FaultKind("degrade", "no index, read in file order"),
    "LOG004": FaultKind("count", "damaged chunk skipped"),
    "LOG005": FaultKind("degrade", "checksum over the whole file differs, though all chunks are whole"),
    "LOG006": FaultKind("degrade", "chunk without checksum, integrity unverified"),
    "LOG007": FaultKind("fatal", "unknown compression"),
    "LOG008": FaultKind("count", "message on an unknown channel, or channel with an unknown schema"),
    "LOG009": FaultKind("fatal", "one topic or channel id with two meanings"),
    "LOG010": FaultKind("count", "name isn't UTF-8, escaped"),
    "LOG011": FaultKind("count", "file of the recording is missing"),
    "LOG012": FaultKind("degrade", "topic of a type that fbench has no use for"),
    "LOG013": FaultKind("degrade", "topic that looks like a sensor's and isn't read"),
    "PQ001": FaultKind("fatal", "Parquet log is damaged, or lacks columns"),
    "PQ002": FaultKind("count", "damaged row group skipped"),
    "DEC001": FaultKind("count", "message can't be decoded"),
    "DEC002": FaultKind("count", "image is corrupt"),
    "DEC003": FaultKind("count", "cloud whose sizes don't fit together, or without coordinates"),
    "DEC004": FaultKind("count", "picture of a video that lacks what it depends on, lost until the next keyframe"),
    "DEC005": FaultKind("degrade", "picture of a video before its first keyframe, can't be decoded"),
    "DEC006": FaultKind("degrade", "video whose pictures have no numbers, so a lost message would go unnoticed"),
    "DAT001": FaultKind("count", "cloud with mostly non-finite points skipped"),
    "DAT002": FaultKind("degrade", "empty point cloud"),
    "DAT003": FaultKind("degrade", "points farther away than 1 km; are the units metres?"),
    "DAT004": FaultKind("degrade", "non-finite points dropped"),
    "DAT005": FaultKind("count", "pose that isn't finite, or has no rotation, skipped"),
    "DAT006": FaultKind("degrade", "velocities or magnitudes of a radar that are infinite, taken as not measured"),
    "LIM001": FaultKind("fatal", "record is larger than the limit"),
    "LIM002": FaultKind("fatal", "decompression bomb"),
    "LIM003": FaultKind("count", "image isn't of the size that its camera is calibrated for"),
    "LIM004": FaultKind("fatal", "Parquet row group or page, or Feather file, is larger than the limit"),
    "LIM005": FaultKind("fatal", "frame or log with more pairs of truth and result boxes than the limit"),
    "CAL001": FaultKind("fatal", "calibration or transform is missing or invalid"),
    "CAL002": FaultKind("degrade", "calibration changes within the log, new segment"),
    "CFG001": FaultKind("fatal", "sensor or topic isn't in the log"),
    "CFG003": FaultKind("fatal", "configuration is damaged or malformed"),
    "SEC002": FaultKind("fatal", "path leads out of the log's folder"),
    "TIM001": FaultKind("degrade", "reference message out of order, no frame"),
    "TIM005": FaultKind("degrade", "clock jumped back, new segment"),
    "TIM007": FaultKind("degrade", "gap, new segment"),
    "TIM008": FaultKind("fatal", "clocks of two sensors differ"),
    "TIM011": FaultKind("degrade", "topic without stamps, those of recording taken"),
    "TIM013": FaultKind("degrade", "times of points that aren't understood, left out"),
    "COR001": FaultKind("fatal", "condition failed, or gave what it may not"),
    "COR002": FaultKind("fatal", "condition needs what the log lacks"),
    "FRM001": FaultKind("count", "sensor that the pipeline needs is in fewer than a tenth of the frames"),
    "GT001": FaultKind("fatal", "nothing has truth; sequences of files without truth are left out and listed"),
    "GT003": FaultKind("fatal", "one id twice in a frame, in truth or tracks"),
    "GT004": FaultKind("count", "truth box isn't finite or has no size"),
    "GT005": FaultKind("degrade", "label in a file that is no box, or of no camera"),
    "GT006": FaultKind("degrade", "truth that belongs to no frame"),
    "GT007": FaultKind("degrade", "class that isn't known, counts as other"),
    "GT008": FaultKind("count", "frame with more truth boxes than the limit, not scored"),
    "PRD001": FaultKind("count", "pipeline gave a non-finite box or score"),
    "PRD002": FaultKind("count", "pipeline failed on a frame"),
    "PRD003": FaultKind("degrade", "recorded result that belongs to no frame"),
    "PRD004": FaultKind("degrade", "recorded result was there before its frame, so it has no latency"),
    "PRD005": FaultKind("degrade", "nearly all car-sized LiDAR clusters were rejected"),
    "PRD006": FaultKind("degrade", "radar whose echoes are too few to outline objects in images"),
    "PRD007": FaultKind("degrade", "built-in bird's-eye network on a log that isn't simulated"),
}  # Codes follow the fault matrix of docs/faults.md


@dataclass
class FaultLog:
    """Counts faults by code and keeps the first places of each."""

    keep: int = 10
    counts: Counter[str] = field(default_factory=Counter)
    places: dict[str, list[str]] = field(default_factory=dict)
    _met: set[tuple[str | int, ...]] = field(default_factory=set)

    def once(self, code: str, key: tuple[str | int, ...], where: str) -> None:
        """Count a fault unless `key`, the place, was counted under the same code before: logs are read repeatedly."""
        if (code, *key) not in self._met:
            self._met.add((code, *key))
            self.add(code, where)

    def add(self, code: str, where: str, num: int = 1) -> None:
        """Count `num` faults of `code`, met at `where` (topic, stamp, offset)."""
        self.counts[code] += num
        kept = self.places.setdefault(code, [])
        if len(kept) < self.keep:
            kept.append(without_secrets(where))

    @property
    def num_lost(self) -> int:
        """How many faults lost data."""
        return sum(n for code, n in self.counts.items() if FAULTS[code].behaviour == "count")

    def rows(self) -> list[dict[str, object]]:
        """All codes that are counted: behaviour, text, count (also when zero) and first places, in table order."""
        return [
            {
                "code": code, "behaviour": kind.behaviour, "text": kind.text, "count": self.counts[code],
                "places": self.places.get(code, []),
            }
            for code, kind in FAULTS.items()
            if kind.behaviour != "fatal"
        ]  # fmt: skip


class StagedFaults(FaultLog):
    """Keeps faults in the order in which they were met, until another log is told of them."""

    def __init__(self) -> None:
        super().__init__()
        self._waiting: list[tuple[str, tuple[str | int, ...] | None, str, int]] = []

    def once(self, code: str, key: tuple[str | int, ...], where: str) -> None:
        """Keep a fault; whether it was counted before is for the log to say that is told of it."""
        self._waiting.append((code, key, where, 1))

    def add(self, code: str, where: str, num: int = 1) -> None:
        """Keep `num` faults."""
        self._waiting.append((code, None, where, num))

    def take(self) -> "StagedFaults":
        """Hand over what is kept."""
        taken = StagedFaults()
        taken._waiting, self._waiting = self._waiting, []
        return taken

    def pass_to(self, log: FaultLog) -> None:
        """Hand over what is kept to a log that counts it."""
        self.take().copy_to(log)

    def copy_to(self, log: FaultLog) -> None:
        """Have a log count what is kept, and keep it."""
        for code, key, where, num in self._waiting:
            if key is None:
                log.add(code, where, num)
            else:
                log.once(code, key, where)

    def clear(self) -> None:
        """Forget what is kept."""
        self._waiting = []


@dataclass(frozen=True)
class FaultBudget:
    """How many faults that lose data are allowed."""

    total: int | None = 0  # Of all codes without a number of their own; `None`: any number
    by_code: Mapping[str, int] = field(default_factory=dict)

    def find_exceeded(self, faults: FaultLog) -> tuple[str, ...]:
        """Codes of which more were met than allowed, sorted."""
        lost = {code: num for code, num in sorted(faults.counts.items()) if num and FAULTS[code].behaviour == "count"}
        over = [code for code, num in lost.items() if num > self.by_code.get(code, num)]
        others = [code for code in lost if code not in self.by_code]
        if self.total is not None and sum(lost[code] for code in others) > self.total:
            over += others
        return tuple(sorted(over))


def parse_budget(on_fault: str, budgets: Sequence[str]) -> FaultBudget:
    """Read `strict` (nothing may be lost) or `tolerant` (anything), and budgets such as `5` or `DEC001=5`. Raises
    ConfigError naming what isn't one of these.
    """
    totals: dict[str, int | None] = {"strict": 0, "tolerant": None}
    if on_fault not in totals:
        raise ConfigError(f"--on-fault {on_fault}: expected 'strict' or 'tolerant'")
    total, by_code = totals[on_fault], {}
    for text in budgets:
        code, equals, number = text.rpartition("=")
        if not number.isdecimal() or not number.isascii():
            raise ConfigError(f"--fault-budget {text}: expected a number of faults such as 5, or CODE=5")
        if not equals:
            total = int(number)
            continue
        countable = [c for c, kind in FAULTS.items() if kind.behaviour == "count"]
        if code not in countable:
            hint = did_you_mean(code, countable)
            raise ConfigError(f"--fault-budget {text}: '{code}' isn't a fault that loses data{hint}")
        by_code[code] = int(number)
    return FaultBudget(total, by_code)


@contextmanager
def explain_losses(faults: FaultLog) -> Iterator[None]:
    """Add what was lost before to the message of a log that can't be used: the first such fault of the table, else the
    first topic of a sensor that isn't read, or is left out though its type is known.
    """
    try:
        yield
    except LogError as error:
        lost = [(code, places) for code, places in sorted(faults.places.items()) if FAULTS[code].behaviour == "count"]
        unread = (*faults.places.get(UNREAD_SENSOR, []), *faults.places.get(UNREAD, []))
        sensors = len(faults.places.get(UNREAD_SENSOR, []))
        left_out = (place for i, place in enumerate(unread) if i < sensors or "is left out: " in place)
        first = next((f"{FAULTS[code].text}: {places[0]}" for code, places in lost), next(left_out, None))
        if first is None:
            raise
        raise LogError(f"{error}; before that: {first}", error.code) from error
