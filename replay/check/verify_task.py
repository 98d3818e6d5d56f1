"""The task that a fresh process is asked to replay; travels as JSON."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter

from fbench.replay.engine.excerpt import Excerpt
from fbench.replay.engine.frame_buffer import SyncParams
from fbench.replay.engine.read_ahead import DEFAULT
from fbench.replay.logs.setup import StampParams
from fbench.replay.setup.source import LogWish

Form = Literal["unchunked", "lz4", "small chunks", "parquet"]


@dataclass(frozen=True)
class Task:
    """One replay."""

    log: LogWish
    pipeline: str
    folder: Path
    """Where the run goes; what else the process writes goes beside it."""
    settings: list[str] = field(default_factory=list)
    sync: SyncParams = field(default_factory=SyncParams)
    stamps: StampParams = field(default_factory=StampParams)
    excerpt: Excerpt = field(default_factory=Excerpt)
    sensors: list[str] = field(default_factory=list)
    rate: str = "max"
    read_ahead: int | None = DEFAULT
    form: Form | None = None
    """Container to which the log is converted first."""
    num_threads: int = 1
    """Of OpenCV; other libraries read the environment."""

    def to_json(self) -> str:
        """For another process."""
        return _ADAPTER.dump_json(self).decode()

    @staticmethod
    def from_json(text: str) -> "Task":
        """Read what `to_json` gave."""
        return _ADAPTER.validate_json(text)


_ADAPTER = TypeAdapter(Task)
WATCH = "watch.json"
"""In the run folder: what each frame was made of."""
