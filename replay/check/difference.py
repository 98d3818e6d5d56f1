"""One verified replay: its task, what its frames are made of, and the first difference of two."""

import json
from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, TypeVar

import numpy as np
from pydantic import TypeAdapter

from fbench.replay.contracts.protocols import Pipeline, Reader, ReaderWrapper
from fbench.replay.data.boxes import Boxes
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.messages import Message, Tick
from fbench.replay.data.rig import LogInfo, Rig, RigChange
from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.logs.container import Container
from fbench.replay.logs.containers.mcap.write import RawMcapWriter
from fbench.replay.logs.convert.copying import Copying
from fbench.replay.logs.convert.run import ConvertRequest, convert
from fbench.replay.logs.convert.sinks import McapSink
from fbench.replay.logs.convert.source import Source
from fbench.replay.logs.convert.target import Target
from fbench.replay.runs.digest import START, digest, link
from fbench.replay.runs.folder import FrameRecord, Run
from fbench.replay.setup.request import ReplayRequest

T = TypeVar("T")
Form = Literal["unchunked", "lz4", "small chunks", "parquet"]


@dataclass(frozen=True)
class VerifyTask:
    """One replay under some circumstances."""

    request: ReplayRequest
    folder: Path  # Folder of the run; what else the process writes goes beside it
    form: Form | None = None  # Container to which the log is converted first
    num_threads: int = 1  # Of OpenCV; other libraries read the environment


TASK = TypeAdapter(VerifyTask)  # As JSON, for another process
WATCH = "watch.json"  # In the run folder: what each frame was made of
_OF_CONTAINERS = ("LOG", "PQ", "LIM", "DEC")
"""Faults with these prefixes tell about the container, which another one needn't have."""


class WatchedReader(ReaderWrapper):
    """A reader that chains the digests of the messages it delivers."""

    def __init__(self, reader: Reader) -> None:
        super().__init__(reader)
        self.chain = START
        """Last link."""

    def pass_on(self, messages: Iterator[Message | RigChange | Tick]) -> Iterator[Message | RigChange | Tick]:
        """Yield messages as they are, and chain their digests."""
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
    return convert(container, targets[form], ConvertRequest()).path


@dataclass(frozen=True)
class Difference:
    """What differs first."""

    stage: str
    what: str
    frame: int | None = None

    def __str__(self) -> str:
        place = self.stage if self.frame is None else f"frame {self.frame}, {self.stage}"
        return f"{place}: {self.what}"


class Outcome:
    """A finished run with what its frames were made of."""

    def __init__(self, folder: Path) -> None:
        self.run = Run(folder)

    @cached_property
    def inputs(self) -> dict[int, dict[str, Any]]:
        """What went into each frame, by its index."""
        return {row["index"]: row for row in self.run.json(WATCH)}

    def parts(self, record: FrameRecord) -> dict[str, Any]:
        """What one frame was made of."""
        return self.inputs.get(record.index, {}).get("parts", {})  # type: ignore[no-any-return]

    def faults(self, of_container: bool = True) -> dict[str, Any]:
        """Faults and stragglers; else without those of the container, and without places, which name its files."""
        content = self.run.json("faults.json")
        rows = content.pop("rows")
        if of_container:
            return {**content, **{row["code"]: [row["count"], row["places"]] for row in rows}}
        content.pop("lost")
        return {**content, **{r["code"]: r["count"] for r in rows if not r["code"].startswith(_OF_CONTAINERS)}}

    @cached_property
    def digests(self) -> dict[str, str]:
        """One digest a stage."""
        run = self.run
        frames = START
        for record in run.frames:
            frames = link(frames, digest([_facts(record), self.parts(record)]))
        found = {
            "messages": run.manifest.log.digest,
            "frames": frames,
            "detections": digest([run.detections.frames, run.detections.boxes]),
            "tracks": digest([run.tracks.frames, run.tracks.boxes]),
            "faults": digest(json.dumps(self.faults(), sort_keys=True)),
        }
        if any(record.truth_stamp_ns is not None for record in run.frames):
            found["scores"] = digest(json.dumps(run.json("scores.json"), sort_keys=True))
        return found


def first_difference(base: Outcome, other: Outcome, same_container: bool) -> Difference | None:
    """Find the earliest frame that differs, in it the earliest stage, then what belongs to no frame."""
    for a, b in zip(base.run.frames, other.run.frames, strict=False):
        found = _compare_frames(base, other, a, b)
        if found is not None:
            return Difference(*found, frame=a.index)
    num, others = len(base.run.frames), len(other.run.frames)
    if num != others:
        return Difference("frames", f"{num} frames != {others}")
    if base.run.manifest.log.digest != other.run.manifest.log.digest:
        return Difference("messages", "what is in no frame, or truth, differs")
    if (what := _compare_mappings(base.faults(same_container), other.faults(same_container))) is not None:
        return Difference("faults", what)
    scores, other_scores = (
        {"/".join(str(s[key]) for key in ("metric", "class", "slice", "matching")): s for s in run.json("scores.json")}
        for run in (base.run, other.run)
    )
    what = _compare_mappings(scores, other_scores)
    return None if what is None else Difference("scores", what)


def _compare_frames(base: Outcome, other: Outcome, a: FrameRecord, b: FrameRecord) -> tuple[str, str] | None:
    content = _compare_mappings({**base.parts(a), **_facts(a)}, {**other.parts(b), **_facts(b)})
    if content is not None:
        return ("messages" if ".content " in content else "frames"), content
    if base.inputs.get(a.index, {}).get("messages") != other.inputs.get(b.index, {}).get("messages"):
        return "messages", "what was read until then differs"
    if a.failed != b.failed:
        return "detections", f"failed {a.failed!r} != {b.failed!r}"
    if (what := boxes_difference(base.run.detections.at(a.index), other.run.detections.at(b.index))) is not None:
        return "detections", what
    if (what := boxes_difference(base.run.tracks.at(a.index), other.run.tracks.at(b.index))) is not None:
        return "tracks", what
    return None if a.digest == b.digest else ("tracks", "digest differs")


def _facts(record: FrameRecord) -> dict[str, Any]:
    times = () if record.ready_ns is None else ("ready_ns", "start_ns", "done_ns")
    return {name: getattr(record, name) for name in ("index", "segment", "missing", "truth_stamp_ns", *times)}


def boxes_difference(a: Boxes, b: Boxes) -> str | None:
    """First field and element in which boxes differ, such as `score[3] 0.81 != 0.82`."""
    if type(a) is not type(b) or len(a) != len(b):
        return f"{len(a)} {type(a).__name__} != {len(b)} {type(b).__name__}"
    for name in (f.name for f in fields(a)):
        x, y = getattr(a, name), getattr(b, name)
        if (x is None) != (y is None):
            return f"{name} {'absent' if x is None else 'present'} != {'absent' if y is None else 'present'}"
        if x is not None and not np.array_equal(x, y, equal_nan=x.dtype.kind == "f"):
            odd = (x != y) & ~((x != x) & (y != y))  # noqa: PLR0124  # NaN is the same as NaN
            place = tuple(int(i) for i in np.argwhere(odd)[0])
            return f"{name}[{', '.join(map(str, place))}] {x[place].item()!r} != {y[place].item()!r}"
    return None


def _compare_mappings(a: dict[str, Any], b: dict[str, Any]) -> str | None:
    for name in {**a, **b}:
        x, y = a.get(name), b.get(name)
        if x != y and isinstance(x, dict) and isinstance(y, dict):
            return f"{name} {_compare_mappings(x, y)}"
        if x != y:
            return f"{name} {_shorten(x)} != {_shorten(y)}"
    return None


def _shorten(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."
