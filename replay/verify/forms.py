"""The same log in other containers."""

from pathlib import Path

from fbench.replay.excerpt import Excerpt
from fbench.replay.logs.container import Container
from fbench.replay.logs.convert.copying import Copying
from fbench.replay.logs.convert.run import Wish, convert
from fbench.replay.logs.convert.sinks import McapSink
from fbench.replay.logs.convert.source import Source
from fbench.replay.logs.convert.target import Target
from fbench.replay.logs.mcap.raw_write import RawMcapWriter
from fbench.replay.verify.task import Form

_SMALL = 4096


def converted(container: Container, folder: Path, form: Form) -> Path:
    """Write a log into `folder` in another form, under the same name; returns where it is.

    Raises:
        LogError: where it can't be read.
    """
    name = container.path.stem
    if form == "unchunked":
        return _unchunked(container, folder / f"{name}.mcap")
    targets = {
        "lz4": Target(folder / f"{name}.mcap", compression="lz4"),
        "small chunks": Target(folder / f"{name}.mcap", chunk_size=_SMALL),
        "parquet": Target(folder / f"{name}.parquet"),
    }
    return convert(container, targets[form], Wish()).path


def _unchunked(container: Container, path: Path) -> Path:
    source = Source(container, (), Excerpt())
    sink = McapSink(RawMcapWriter(path, source.about, "none", is_chunked=False), str(path))
    try:
        for item in Copying(source, frozenset()).items():
            sink.put(item)
        sink.close()
    finally:
        sink.discard()
    return path
