"""Recording of what went into each frame, and the same log in other containers."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

from fbench.replay.check.difference import Form
from fbench.replay.contracts.protocols import Pipeline, Reader
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.messages import Message, Tick
from fbench.replay.data.rig import LogInfo, Rig, RigChange
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.logs.container import Container
from fbench.replay.logs.containers.mcap.write import RawMcapWriter
from fbench.replay.logs.convert.copying import Copying
from fbench.replay.logs.convert.run import Wish, convert
from fbench.replay.logs.convert.sinks import McapSink
from fbench.replay.logs.convert.source import Source
from fbench.replay.logs.convert.target import Target
from fbench.replay.runs.digest import START, digest, link

T = TypeVar("T")


class WatchedReader:
    """A reader that chains the digests of the messages it delivers; all else is as with the reader itself."""

    def __init__(self, reader: Reader) -> None:
        self._reader = reader
        self.chain = START
        """Last link."""

    def __getattr__(self, name: str) -> Any:
        return getattr(self._reader, name)

    def messages(self) -> Iterator[Message | RigChange]:
        """All messages."""
        return self._watch(self._reader.messages())

    def events(self) -> Iterator[Message | RigChange | Tick]:
        """All messages, and the instants of boxes."""
        return self._watch(self._reader.events())

    def _watch(self, messages: Iterator[T]) -> Iterator[T]:
        for message in messages:
            self.chain = link(self.chain, digest(message))
            yield message


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


def convert_to(form: Form, container: Container, folder: Path) -> Path:
    """Write a log in another form, under its name, into `folder`; return where. Raises LogError as reading does."""
    path = folder / f"{container.path.stem}.mcap"
    if form == "unchunked":
        source = Source(container, (), Excerpt())
        sink = McapSink(RawMcapWriter(path, source.about, "none", is_chunked=False))
        try:
            for item in Copying(source, frozenset()).items():
                sink.put(item)
            sink.close()
        finally:
            sink.discard()
        return path
    targets = {
        "lz4": Target(path, compression="lz4"),
        "small chunks": Target(path, chunk_size=4096),
        "parquet": Target(path.with_name(f"{container.path.stem}.parquet")),
    }
    return convert(container, targets[form], Wish()).path
