"""Converting in one call, and everything that a log holds, to be compared."""

from pathlib import Path
from typing import Any

from tests.replay.logs import builders as b

from fbench.replay.contracts.faults import FaultLog
from fbench.replay.engine.excerpt import make_excerpt
from fbench.replay.logs.convert.run import Converted, ConvertRequest, convert
from fbench.replay.logs.convert.target import Target, make_split
from fbench.replay.logs.open import open_container
from fbench.replay.runs.digest import Digest


def converted(source: Path, out: Path, **how: Any) -> Path:
    """Convert; nothing may be lost."""
    result, faults = conversion(source, out, **how)
    assert not faults.num_lost
    return result.path


def conversion(
    source: Path,
    out: Path,
    topics: tuple[str, ...] = (),
    start: str | None = None,
    end: str | None = None,
    decode: bool = False,
    split_s: float | None = None,
    split_mb: float | None = None,
    **how: Any,
) -> tuple[Converted, FaultLog]:
    faults = FaultLog()
    target = Target(out, split=make_split(split_s, split_mb), **how)
    asked = ConvertRequest(topics, make_excerpt(start, end, None), decode)
    return convert(open_container(source, faults), target, asked), faults


def messages(path: Path) -> list[tuple[Any, ...]]:
    """All messages as the container has them, in canonical order; only for containers of bytes."""
    container = open_container(path, FaultLog())
    return [
        (container.channels[e.channel], e.log_ns, e.publish_ns, e.sequence, bytes(e.data))
        for e in container.entries(frozenset(container.channels))
    ]


def content(path: Path) -> list[Any]:
    """All that fbench reads of a log, the name of the file aside."""
    reader, faults = b.read(path)
    read = [b.canonical(item) for stream in (reader.messages(), reader.truths()) for item in stream]
    return [
        faults.num_lost,
        b.canonical(reader.rig),
        reader.info.log_id,
        dict(reader.info.metadata),
        reader.num_messages,
        read,
    ]


def digest(path: Path) -> str:
    """Digest of the stream of messages."""
    result = Digest()
    for message in b.read(path)[0].messages():
        result.add(message)
    return result.hex()
