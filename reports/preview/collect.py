"""Collection of what a preview is drawn from, in one pass over the log, and the content of its sheet."""

import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np

from fbench.replay.conditions.disturb import Disturbance, DisturbedReader
from fbench.replay.conditions.effects import Effects, describe
from fbench.replay.contracts.errors import DecodeError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.protocols import Reader
from fbench.replay.data.arrays import Float64
from fbench.replay.data.frames import Frame
from fbench.replay.data.images import Pixels
from fbench.replay.data.messages import Message, Pose, Tick, Truth
from fbench.replay.data.rig import Mount, Rig, RigChange
from fbench.replay.engine.clock import Clock
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.frames import FrameStream
from fbench.replay.geometry.transforms import inverse
from fbench.replay.logs.partial_rig import PartialRig
from fbench.replay.logs.setup import StampParams
from fbench.reports.html.records import positive
from fbench.reports.preview.sample import Instant, Material, Sample, thin

T = TypeVar("T")
MAX_TIMES = 1000  # So many instants and arrivals at least are kept for the panel of times, where the log has as many


@dataclass(frozen=True)
class Shown:
    """One picture."""

    file: str
    size_wh: tuple[int, int]
    caption: str
    alt: str


@dataclass(frozen=True)
class Verdict:
    """One line about calibration, time, Doppler or truth."""

    about: str  # Which sensors
    what: str  # `alignment`, `stereo`, `time`, `doppler` or `truth`
    text: str
    is_bad: bool


@dataclass(frozen=True)
class FrameContent:
    """The pictures of one frame."""

    index: int
    head: str
    pictures: Sequence[Shown]


@dataclass(frozen=True)
class SensorRow:
    """One line of the table of sensors."""

    name: str
    kind: str
    messages: int
    missing: str
    mounted: str
    camera: str
    shift: str
    delay: str
    problem: str


@dataclass(frozen=True)
class Content:
    """The whole sheet."""

    name: str
    facts: Sequence[tuple[str, str]]
    sensors: Sequence[SensorRow]
    verdicts: Sequence[Verdict]
    gaps: Sequence[str]  # What can't be shown, and why
    measured: Sequence[Shown]  # Rig, times, Doppler and edges: one picture each for the whole log
    frames: Sequence[FrameContent] = field(default_factory=tuple)

    @property
    def pictures(self) -> Sequence[Shown]:
        """All of them, in the order of the sheet."""
        return [*self.measured, *(picture for frame in self.frames for picture in frame.pictures)]


class Album:
    """Writes pictures into an existing folder, under names that are safe whatever sensors are called: the number of a
    sensor in the order of all `names` keeps them apart.
    """

    def __init__(self, folder: Path, names: Sequence[str]) -> None:
        self._folder, self._names = folder, list(names)

    def add(self, stem: str, pixels: Pixels, caption: str, alt: str) -> Shown:
        """Write one picture."""
        import cv2

        ok, data = cv2.imencode(".png", pixels, [cv2.IMWRITE_PNG_COMPRESSION, 6])
        if not ok:
            raise DecodeError(f"picture {stem} of shape {pixels.shape} can't be encoded")
        (self._folder / f"{stem}.png").write_bytes(np.asarray(data).tobytes())
        return Shown(f"{stem}.png", (pixels.shape[1], pixels.shape[0]), caption, alt)

    def stem(self, sensor: str) -> str:
        """Part of a file name for a sensor: its number, and what is safe of its name."""
        return f"{self._names.index(sensor)}-{re.sub(r'[^A-Za-z0-9_]+', '-', sensor)[:40]}".rstrip("-")


class Spread(Generic[T]):
    """Keeps up to 2 `num` items, whatever the length of the stream; the first one always.

    Every `stride`-th item is kept; when there are too many, the stride doubles and every second one goes.
    """

    def __init__(self, num: int) -> None:
        self._num, self._stride, self._num_offered = num, 1, 0
        self._kept: list[T] = []

    def offer(self, item: T) -> None:
        """Keep the item if its turn has come."""
        self._num_offered += 1
        if (self._num_offered - 1) % self._stride:
            return
        self._kept.append(item)
        if len(self._kept) > 2 * self._num:
            self._kept, self._stride = self._kept[::2], self._stride * 2

    @property
    def items(self) -> Sequence[T]:
        """All that is kept."""
        return self._kept

    @property
    def subset(self) -> Sequence[T]:
        """At most `num` of what is kept, from the first to the last one, evenly spread."""
        last = len(self._kept) - 1
        if last < self._num:
            return self._kept
        steps = max(1, self._num - 1)
        return [self._kept[(i * last + steps // 2) // steps] for i in range(self._num)]


@dataclass(frozen=True)
class PreviewRequest:
    """Which frames are wanted, and how they are put together."""

    num: int = 6
    sync: SyncParams = field(default_factory=SyncParams)
    stamps: StampParams = field(default_factory=StampParams)
    excerpt: Excerpt = field(default_factory=Excerpt)
    disturbance: Disturbance = field(default_factory=Disturbance)


def collect(
    reader: Reader,
    partial: PartialRig,
    request: PreviewRequest,
    faults: FaultLog,
    progress: Callable[[int], None] = lambda n: None,
) -> Material:
    """Read a log, or the wanted frames of it. The reader's own rig isn't used, since it may be incomplete; `partial` is
    what is known of it. `progress` gets how many frames are read. Raises ConfigError where the reference or a sensor
    with an offset isn't in the log. Raises LogError where there are no frames.
    """
    observed = _Observed(reader, partial, request.stamps)
    effects, disturbance = Effects(), request.disturbance
    log = DisturbedReader(observed, disturbance, effects) if disturbance else observed
    stream = FrameStream(log, request.sync, request.stamps, request.excerpt, Clock(), faults)
    kept, instants = Spread[Sample](request.num), Spread[Instant](MAX_TIMES)
    missing: dict[str, Counter[str]] = {}
    strides: Counter[str] = Counter()
    num_frames, last = 0, None
    for num_frames, whole in enumerate(stream.frames(log), 1):
        frame, own = thin(whole)
        strides |= Counter(own)  # the largest of each
        # Take back the places that were made up.
        unknown = [n for n in stream.rig.mounts if n in partial.problems and n not in partial.rig.mounts]
        rig = stream.rig.without(unknown) if unknown else stream.rig
        given = disturbance.rig(rig, reader.info.log_id)
        effects.add_rig(rig, given)
        kept.offer(Sample(frame, given, ego_mps=None if last is None else _forward_mps(last, frame)))
        last = frame
        stamps = {name: message.stamp_ns for name, message in sorted(frame.messages.items())}
        instants.offer(Instant(frame.index, frame.stamp_ns, stamps))
        for sensor, reason in frame.missing.items():
            missing.setdefault(sensor, Counter())[reason] += 1
        progress(num_frames)
    stream.require_frames(reader.info.name)
    wanted = {sample.frame.index for sample in kept.subset}
    truths: dict[int, Truth] = {}
    num_labeled = 0
    for index, truth in stream.labels(log):
        num_labeled += 1
        if index in wanted:
            truths[index] = truth
    # Periods of radial velocities that the log's metadata state, of one radar or of all.
    metadata = reader.info.metadata
    every = metadata.get("radar.velocity_period_mps", "")
    radars = sorted(name for name, kind in partial.kinds.items() if kind == "radar")
    periods = {name: positive(metadata.get(f"radar.{name}.velocity_period_mps", every)) for name in radars}
    drawn = {s.frame.index: replace(s, truth=truths.get(s.frame.index)) for s in kept.subset}
    return Material(
        reader.info, partial.kinds, partial.rig, partial.problems, stream.reference,
        list(drawn.values()), [drawn.get(s.frame.index, s) for s in kept.items], num_frames, num_labeled,
        instants.items, {name: arrivals.items for name, arrivals in sorted(observed.arrivals.items())},
        dict(sorted(observed.counts.items())),
        {name: dict(sorted(why.items())) for name, why in sorted(missing.items())},
        {name: period for name, period in periods.items() if period},
        dict(sorted(strides.items())),
        {name: describe(row) for name, row in effects.rows().items()},
    )  # fmt: skip


class _Observed:
    """A log in which every sensor has a place, so that frames hold all of them, and whose times are noted."""

    def __init__(self, reader: Reader, partial: PartialRig, stamps: StampParams) -> None:
        self._reader, self._stamps = reader, stamps
        here, upright = np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0])
        unknown = {name: Mount(kind, here, upright) for name, kind in partial.kinds.items()}
        self.rig = Rig({**unknown, **partial.rig.mounts}, partial.rig.cameras)
        self.info, self.num_messages, self.poses = reader.info, reader.num_messages, reader.poses
        self.events, self.truths = reader.events, reader.truths
        self.arrivals: dict[str, Spread[tuple[int, int]]] = {}
        self.counts: Counter[str] = Counter()

    def messages(self) -> Iterator[Message | RigChange | Tick]:
        for message in self._reader.messages():
            if not isinstance(message, RigChange | Tick):
                stamp_ns = self._stamps.restamp(message).stamp_ns
                arrivals = self.arrivals.setdefault(message.sensor, Spread(MAX_TIMES))
                arrivals.offer((stamp_ns, message.log_ns))
                self.counts[message.sensor] += 1
            yield message


def _forward_mps(before: Frame, frame: Frame) -> float | None:
    """Forward speed from the poses of two frames [m/s]; `None` where that isn't known."""
    last, pose = (
        next((m for _, m in sorted(f.messages.items()) if isinstance(m, Pose)), None) for f in (before, frame)
    )
    if last is None or pose is None or before.segment != frame.segment or pose.stamp_ns <= last.stamp_ns:
        return None
    moved_m: Float64 = inverse(pose.world_T_body)[:3, :3] @ (pose.translation_m - last.translation_m)
    speed = float(moved_m[0]) / ((pose.stamp_ns - last.stamp_ns) / 1e9)
    return speed if math.isfinite(speed) else None
