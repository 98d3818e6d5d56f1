"""What a log holds, counted by reading it once."""

from dataclasses import dataclass
from itertools import pairwise

from fbench.replay.data import LogInfo, Message, Rig
from fbench.replay.protocols import Reader
from fbench.replay.sync import FrameBuffer, SyncParams, choose_reference


@dataclass(frozen=True)
class Stream:
    """The messages of one sensor."""

    sensor: str
    kind: str
    num_messages: int
    first_stamp_ns: int
    last_stamp_ns: int
    median_period_ns: int | None
    """`None` with fewer than two messages."""

    @property
    def rate_hz(self) -> float | None:
        """Messages a second, from the median period."""
        return 1e9 / self.median_period_ns if self.median_period_ns else None


@dataclass(frozen=True)
class Survey:
    """What a log holds."""

    info: LogInfo
    rig: Rig
    reference: str
    streams: tuple[Stream, ...]
    num_truths: int
    num_frames: int
    breaks: tuple[str, ...]
    """Where a new segment begins, and why."""


def survey(reader: Reader, params: SyncParams) -> Survey:
    """Read a log once and count; only stamps are kept."""
    reference = choose_reference(reader.rig, reader.info, reader.num_messages, params)
    buffer = FrameBuffer((), reference, params)
    stamps: dict[str, list[int]] = {}
    kinds: dict[str, str] = {}
    for message in reader.messages():
        stamps.setdefault(message.sensor, []).append(message.stamp_ns)
        kinds.setdefault(message.sensor, _kind(reader.rig, message))
        if message.sensor == reference:
            for _ in buffer.open_frame(message):
                pass
    streams = tuple(_stream(name, kinds[name], stamps[name]) for name in sorted(stamps))
    num_truths = sum(1 for _ in reader.truths())
    return Survey(reader.info, reader.rig, reference, streams, num_truths, buffer.num_frames, tuple(buffer.breaks))


def _kind(rig: Rig, message: Message) -> str:
    mount = rig.mounts.get(message.sensor)
    return mount.kind if mount is not None else type(message).__name__.lower()


def _stream(sensor: str, kind: str, stamps_ns: list[int]) -> Stream:
    steps = sorted(b - a for a, b in pairwise(stamps_ns))
    period = steps[len(steps) // 2] if steps else None
    return Stream(sensor, kind, len(stamps_ns), min(stamps_ns), max(stamps_ns), period)
