"""One log as messages, truth and rig, whatever its container and encoding: one stream of events feeds all of them."""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from hashlib import blake2b
from itertools import islice
from typing import TypeAlias

import numpy as np

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import BOXES, Message, Pose, Tick, Truth
from fbench.replay.data.rig import LogInfo, Rig, RigChange
from fbench.replay.logs import assembly, bursts
from fbench.replay.logs.arrange import arrange, box_channels, facts, rename
from fbench.replay.logs.assembly import Assembly, count_parts
from fbench.replay.logs.bursts import MAX_BURST_NS, NUM_PROBED, join_bursts, mean_parts
from fbench.replay.logs.calibration import LogCalibration
from fbench.replay.logs.codecs.codec import MESSAGES, SENSORS, Assembler, TruthPart
from fbench.replay.logs.codecs.video.stream import VideoStreams
from fbench.replay.logs.container import Container, Entry
from fbench.replay.logs.coordinate_frames import BODY, CoordinateFrames
from fbench.replay.logs.events import EventDecoder, make_origin
from fbench.replay.logs.roles import roles, select, sensor_roles
from fbench.replay.logs.setup import BoxSource, Setup
from fbench.replay.logs.truth import join_parts, pair_parts
from fbench.replay.runs.secrets import clean_mapping, readable, without_secrets

Event: TypeAlias = Message | RigChange | TruthPart | None


_FEW_MESSAGES = 100_000  # Log times of so many are read from an index in no time
_ALMOST_0 = 1e-6
_NO_TIMES = np.zeros(0, np.int64)


class LogReader:
    """One log; implements `fbench.replay.contracts.protocols.Reader`.

    `topics` are patterns of those that are read, all where there are none; `faults` counts those of files beside the
    log, the container its own: once, however many passes are made. Holds only blocks that overlap in time. Raises
    ConfigError where a pattern fits nothing.
    """

    def __init__(
        self, container: Container, topics: Sequence[str] = (), setup: Setup | None = None,
        faults: FaultLog | None = None,
    ) -> None:  # fmt: skip
        self.container, self.setup, self.faults = container, setup or Setup(), faults or FaultLog()
        every = arrange(roles(container, self.setup.decoders), container, self.setup)
        # A log that fbench converted holds the messages of another program, with their coordinate frames.
        if self.setup.body not in ("", BODY) and any(role.is_own for role in every.values()):
            where = f"{self.setup.source}: body.frame"
            raise ConfigError(
                f"{where}: in a log that fbench wrote it is '{BODY}'; if the file describes another log: --config none"
            )
        self.roles = select(every, topics)
        kept = {role.sensor for role in self.roles.values()}
        self.left_out = frozenset(role.sensor for role in every.values()) - kept

    @cached_property
    def info(self) -> LogInfo:
        """Name, id and metadata, without credentials; a missing id is made of topics, schemas and first messages."""
        header = self.container.header
        log_id = self._digest() if header is None else header.log_id
        name = readable(without_secrets(self.container.path.stem))
        return LogInfo(name, without_secrets(log_id), self._calibration.metadata)

    @cached_property
    def _calibration(self) -> LogCalibration:
        header = self.container.header
        sensors = sensor_roles(self.roles)
        names = {role.frame_id: role.sensor for role in sensors} if self.setup.sensors else {}
        metadata = {} if header is None else rename(header.metadata, names)
        metadata = clean_mapping({**metadata, **facts(self.setup)})
        return LogCalibration(self.container, self.roles, self.left_out, self.setup, metadata)

    @property
    def rig(self) -> Rig:
        """Sensors as the log begins. Raises LogError naming one without transform or calibration."""
        return self._calibration.rig

    @property
    def coordinate_frames(self) -> CoordinateFrames:
        """What names of coordinate frames and cameras mean here. Raises LogError where the rig is incomplete."""
        return self._calibration.coordinate_frames

    @cached_property
    def num_messages(self) -> Mapping[str, int]:
        """Messages of each sensor and stream of poses, by name, as the index says; a burst counts as one, by an
        estimate for those that are `estimated`.
        """
        counts: Counter[str] = Counter()
        names = [(id_, role.sensor) for id_, role in sorted(self.roles.items()) if role.kind in MESSAGES]
        names += [(id_, self._calibration.tf.name) for id_ in sorted(self._calibration.tf.channels)]
        for id_, name in names:
            counts[name] += self.container.counts.get(id_, 0)
        for name, parts in self.parts.items():
            counts[name] = int(counts[name] / parts + _ALMOST_0)  # what a recording cuts off is no measurement
        if num := sum(self.container.counts.get(id_, 0) for id_ in self.tick_channels):
            counts[BOXES] = num
        return counts

    @cached_property
    def bursts(self) -> Mapping[str, float]:
        """How many messages make a measurement of the sensors that send several, by name."""
        means: dict[str, float] = {}
        assembled = self._assemblers.keys()
        counts = self.container.counts
        times = self.container.log_times() if sum(counts.values()) <= _FEW_MESSAGES else None
        for id_ in sorted(self._channels("lidar", "radar")):
            if id_ in assembled:
                continue
            if times is not None and not (np.diff(times.get(id_, _NO_TIMES)[:NUM_PROBED]) <= MAX_BURST_NS).any():
                continue
            entries = self.container.entries(frozenset([id_]))
            messages = (self._decoder.message(entry, None, Assembly()) for entry in entries)
            if (mean := mean_parts(messages)) > 1:
                means[self.roles[id_].sensor] = mean
        return means

    @cached_property
    def parts(self) -> Mapping[str, float]:
        """How many messages make a measurement on average, by name of the sensor: in bursts, or as packets."""
        found = dict(self.bursts)
        for id_, assembler in self._assemblers.items():
            role, entries = self.roles[id_], self.container.entries(frozenset([id_]))
            given = ((e.data, make_origin(role, e)) for e in entries if isinstance(e.data, memoryview))
            found[role.sensor] = count_parts(assembler, given)
        return found

    @cached_property
    def estimated(self) -> frozenset[str]:
        """Names of the sensors that send measurements in parts, too many of them to count each."""
        most = dict.fromkeys(self.bursts, bursts.NUM_SAMPLED)
        most |= {self.roles[id_].sensor: assembly.NUM_SAMPLED for id_ in self._assemblers}
        totals: Counter[str] = Counter()
        for id_, role in sorted(self.roles.items()):
            totals[role.sensor] += self.container.counts.get(id_, 0) if role.kind in SENSORS else 0
        return frozenset(name for name, num in most.items() if totals[name] > num)

    @property
    def _assemblers(self) -> Mapping[int, Assembler]:
        """New assemblers of the channels with parts of measurements."""
        codecs = {id_: self.roles[id_].codec for id_ in sorted(self._channels(*SENSORS))}
        made = {id_: None if codec is None else codec.assembler() for id_, codec in codecs.items()}
        return {id_: assembler for id_, assembler in made.items() if assembler is not None}

    @cached_property
    def tick_channels(self) -> frozenset[int]:
        """Channels that give the instants: of a topic with truth, else results; none where sensors have messages."""
        if any(self.container.counts.get(id_) for id_ in self._channels(*SENSORS)):
            return frozenset()
        by_kind = [sorted(self.roles[id_].topic for id_ in self._channels(kind)) for kind in ("truth", "detections")]
        topic = next((topics[0] for topics in by_kind if topics), None)
        return frozenset(id_ for id_, role in self.roles.items() if role.topic == topic)

    @cached_property
    def poses(self) -> tuple[str, ...]:
        """Names of the streams of poses."""
        moving = {self._calibration.tf.name} if self._calibration.tf.channels else set()
        return tuple(sorted({role.sensor for role in self.roles.values() if role.kind == "pose"} | moving))

    def messages(self, start_ns: int | None = None) -> Iterator[Message | RigChange]:
        """All measurements and poses in canonical order, and between them where the rig changes; those from a log time
        on, where one is given.
        """
        events = self._events(self._channels(*MESSAGES) | self._calibration.tf.channels, start_ns=start_ns)
        messages = (event for _, event in events if event is not None and not isinstance(event, TruthPart))
        return join_bursts(messages, frozenset(self.bursts))

    def events(self) -> Iterator[Message | RigChange | Tick]:
        """The same with the instants of boxes, in a log without measurements."""
        ticks = self.tick_channels
        events = self._events(self._channels(*MESSAGES) | self._calibration.tf.channels | ticks, ticks)
        found = ((entry, event) for entry, event in events if event is not None)
        return (make_tick(entry, event) if isinstance(event, TruthPart) else event for entry, event in found)

    def everything(self) -> Iterator[tuple[Entry, Event]]:
        """All entries of all channels in canonical order, with what each holds: `None` where fbench has no use for it,
        it can't be decoded, or it tells the rig. A change of the rig comes with the entry that it precedes.
        """
        return self._events(frozenset(self.container.channels))

    def rig_changes(self, most: int | None = None) -> list[RigChange] | None:
        """Return where the rig changes; `None` where more than `most` messages would have to be read for it."""
        changes, counts = self._calibration.changes(), self.container.counts
        nums = [counts.get(id_) for id_ in sorted(changes.channels)]
        if most is not None and (None in nums or sum(num or 0 for num in nums) > most):
            return None
        return list(changes.all(self.container))

    def _events(
        self, channels: frozenset[int], ticks: frozenset[int] = frozenset(), start_ns: int | None = None
    ) -> Iterator[tuple[Entry, Event]]:
        """Yield entries with what each holds; changes of the rig come before messages and `ticks`."""
        changes, moving = self._calibration.changes(), self._calibration.tf.poses()
        assembly, videos = Assembly(), VideoStreams()
        for entry in changes.follow(self.container.entries(channels | changes.channels, start_ns)):
            kind = self.roles[entry.channel].kind if entry.channel in self.roles else ""
            is_message = kind in MESSAGES or entry.channel in self._calibration.tf.channels
            if is_message or entry.channel in ticks:
                for change in changes.until(entry.log_ns):
                    yield entry, change
            if is_message:
                yield entry, self._decoder.message(entry, moving, assembly, videos)
            elif kind in ("truth", "detections"):
                yield entry, self._decoder.truth_part(entry)
            else:
                if entry.channel not in changes.channels:
                    self._decoder.try_rig(entry, kind)
                yield entry, None

    def truths(self) -> Iterator[Truth]:
        """Truth in the order of stamps, 3D and 2D together (see `join_parts`); of a file where the setup names it."""
        if self.setup.truth is not None:
            return self._read_boxes(self.setup.truth)
        return join_parts(self._truth_parts(self._channels("truth")))

    def body_poses(self) -> Iterator[Pose]:
        """Poses of the body alone, in canonical order."""
        moving = self._calibration.tf.poses()
        for entry in self.container.entries(self._channels("pose") | self._calibration.tf.channels):
            pose = self._decoder.message(entry, moving, Assembly())
            if isinstance(pose, Pose):
                yield pose

    def detections(self, topic: str) -> Iterator[Truth]:
        """Results of another system; see `contracts.protocols.BoxReader`. Raises LogError without such a topic."""
        if not topic and self.setup.results is not None:
            return self._read_boxes(self.setup.results)
        wanted = box_channels(self.roles, topic or next(iter(self.setup.result_topics), ""), self.container.path)
        return pair_parts(self._truth_parts(wanted))

    def try_boxes(self, topic: str, num: int) -> str | None:
        """Say why none of the first messages of a topic with boxes can be used; `None`: one can, or there is none."""
        channels = frozenset(id_ for id_, role in self.roles.items() if role.topic == topic)
        faults = FaultLog()
        decoder = EventDecoder(self._calibration, faults)
        for entry in islice(self.container.entries(channels), num):
            if decoder.truth_part(entry) is not None:
                return None
        why = next((place for places in faults.places.values() for place in places), "")
        return why.partition(": ")[2] or why or None

    def _truth_parts(self, channels: frozenset[int]) -> Iterator[TruthPart]:
        parts = (self._decoder.truth_part(entry) for entry in self.container.entries(channels))
        return (part for part in parts if part is not None)

    def _read_boxes(self, source: BoxSource) -> Iterator[Truth]:
        """Boxes of a file, with the labels that the setup gives them."""
        from fbench.replay.formats.open import open_boxes  # most logs have no such file, and tables need pyarrow

        for truth in open_boxes(source, self.coordinate_frames, self.faults).truths():
            yield self._decoder.classify(truth, source.path.name)

    @cached_property
    def _decoder(self) -> EventDecoder:
        return EventDecoder(self._calibration)

    def _channels(self, *kinds: str) -> frozenset[int]:
        return frozenset(id_ for id_, role in self.roles.items() if role.kind in kinds)

    def _digest(self) -> str:
        """Digest of all topics with their schemas and first messages, whatever the ids of their channels."""
        digest = blake2b(digest_size=16)
        channels = self.container.channels
        by_topic: dict[str, list[int]] = {}
        for id_, channel in sorted(channels.items()):
            by_topic.setdefault(channel.topic, []).append(id_)
        for topic, ids_ in sorted(by_topic.items()):
            ids = frozenset(ids_)
            schema = channels[min(ids)].schema
            entry = next(self.container.entries(ids), None)
            parts = [topic.encode()]
            parts += [] if schema is None else [schema.name.encode(), schema.data]
            parts += [] if entry is None else [entry.log_ns.to_bytes(8, "little")]
            parts += [bytes(entry.data)] if entry is not None and isinstance(entry.data, memoryview) else []
            for part in parts:
                digest.update(len(part).to_bytes(8, "little") + part)
        return digest.hexdigest()


def make_tick(entry: Entry, part: TruthPart) -> Tick:
    """Return the instant that a message of boxes gives."""
    return Tick(BOXES, part.truth.stamp_ns, entry.log_ns, part.truth.frame_number)
