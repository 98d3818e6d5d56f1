"""The task that a fresh process is asked to replay; travels as JSON."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter

from fbench.replay.setup.request import ReplayRequest

Form = Literal["unchunked", "lz4", "small chunks", "parquet"]


@dataclass(frozen=True)
class VerifyTask:
    """One replay under some circumstances."""

    request: ReplayRequest
    folder: Path
    """Folder of the run; what else the process writes goes beside it."""
    form: Form | None = None
    """Container to which the log is converted first."""
    num_threads: int = 1
    """Of OpenCV; other libraries read the environment."""

    def to_json(self) -> str:
        """Return it for another process."""
        return _ADAPTER.dump_json(self).decode()

    @staticmethod
    def from_json(text: str) -> "VerifyTask":
        """Read what `to_json` returned."""
        return _ADAPTER.validate_json(text)


_ADAPTER = TypeAdapter(VerifyTask)
WATCH = "watch.json"
"""In the run folder: what each frame was made of."""
