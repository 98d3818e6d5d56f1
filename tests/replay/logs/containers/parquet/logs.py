"""Writing and reading Parquet logs in tests, and changing what is in them."""

import json
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from tests.replay.logs import builders as b

from fbench.replay.contracts.errors import FbenchError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.messages import Message, Truth
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.logs.containers.parquet.folder import ParquetFolder
from fbench.replay.logs.containers.parquet.write import ParquetWriter
from fbench.replay.logs.reader import LogReader


def write(
    path: Path, items: Iterable[Message | Truth], rig: Rig = b.NO_RIG, info: LogInfo = b.INFO, **how: Any
) -> Path:
    with ParquetWriter(path, info, rig, **how) as writer:
        for item in items:
            writer.write(item)
    return path


def read(path: Path) -> tuple[LogReader, FaultLog]:
    faults = FaultLog()
    return LogReader(ParquetFolder(path, faults)), faults


def content(reader: LogReader) -> list[Any]:
    """All that is in a log, so that logs that are equal are equal in it."""
    messages = [b.canonical(m) for m in reader.messages()]
    return [*messages, *(b.canonical(t) for t in reader.truths())]


def counted(items: Iterable[Any]) -> Counter[str]:
    return Counter(repr(item) for item in items)


def refusal(action: Callable[[], object]) -> FbenchError | None:
    """The error with which something is refused; `None` where it isn't. Others pass."""
    try:
        action()
    except FbenchError as error:
        return error
    return None


def edit(path: Path, change: Callable[[dict[str, Any]], object]) -> Path:
    """Change `log.json` as someone would who knows the format: without its digest."""
    file = path / "log.json"
    log = json.loads(file.read_text())
    log.pop("digest", None)
    change(log)
    file.write_text(json.dumps(log))
    return path
