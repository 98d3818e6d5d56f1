"""What went into each frame, seen from outside: all messages until then, and those of the frame."""

from collections.abc import Iterator, Mapping

from fbench.replay.data import Frame, LogInfo, Message, Output, Rig, RigChange, Tick, Truth
from fbench.replay.digest import START, digest, link
from fbench.replay.protocols import Pipeline, Reader


class WatchedReader:
    """A reader that chains the digests of the messages it delivers."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader
        self.chain = START
        """Last link."""

    @property
    def info(self) -> LogInfo:
        """Name, id and metadata."""
        return self._reader.info

    @property
    def rig(self) -> Rig:
        """Sensors and their calibration."""
        return self._reader.rig

    @property
    def num_messages(self) -> Mapping[str, int]:
        """Messages by sensor."""
        return self._reader.num_messages

    @property
    def poses(self) -> tuple[str, ...]:
        """Names of the streams of poses."""
        return self._reader.poses

    def messages(self) -> Iterator[Message | RigChange]:
        """All messages."""
        for message in self._reader.messages():
            self.chain = link(self.chain, digest(message))
            yield message

    def ticked(self) -> Iterator[Message | RigChange | Tick]:
        """All messages, and the instants of boxes."""
        for message in self._reader.ticked():
            self.chain = link(self.chain, digest(message))
            yield message

    def truths(self) -> Iterator[Truth]:
        """Ground truth."""
        return self._reader.truths()


class WatchedPipeline:
    """A pipeline that notes what its frames are made of."""

    def __init__(self, pipeline: Pipeline, reader: WatchedReader) -> None:
        self._pipeline, self._reader = pipeline, reader
        self.rows: list[dict[str, object]] = []

    def start(self, rig: Rig, log_info: LogInfo) -> None:
        """Prepare for one log."""
        self._pipeline.start(rig, log_info)

    def reset(self, reason: str) -> None:
        """Forget all tracks."""
        self._pipeline.reset(reason)

    def step(self, frame: Frame) -> Output:
        """Process one frame."""
        parts: dict[str, object] = {"stamp_ns": frame.stamp_ns, "frame_number": frame.frame_number}
        for sensor, message in frame.messages.items():
            parts[f"{sensor}.stamp_ns"] = message.stamp_ns
            parts[f"{sensor}.log_ns"] = message.log_ns
            parts[f"{sensor}.content"] = digest(message)
        self.rows.append({"index": frame.index, "messages": self._reader.chain, "parts": parts})
        return self._pipeline.step(frame)
