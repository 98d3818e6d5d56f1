"""What the report reads besides tables and scores: faults, latency and host, checked when read."""

from collections.abc import Mapping
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, RootModel, ValidationError

from fbench.replay.errors import RunError
from fbench.replay.store import Run


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, allow_inf_nan=False)


class FaultRow(_Record):
    """One code of the fault table with its count."""

    code: str
    behaviour: str
    text: str
    count: int
    places: list[str] = []


class FaultTable(_Record):
    """`faults.json`."""

    lost: int
    rows: list[FaultRow]


class Stage(_Record):
    """Latency of one stage [ms]; `total` is the whole frame."""

    stage: str
    count: int
    mean_ms: float | None = None
    p50_ms: float | None = None
    p95_ms: float | None = None
    p99_ms: float | None = None
    max_ms: float | None = None
    first_ms: float | None = None


class LatencyTable(_Record):
    """`latency.json`."""

    clock: str = "host"
    """`host`, or `log` where results were only recorded: times from a frame's instant to its result in the log."""
    budget_ms: float
    frames: int
    over_budget: int
    over_budget_share: float | None = None
    percentile_method: str = ""
    excluded: str = ""
    stages: list[Stage]


class Host(RootModel[Mapping[str, str | float | int | bool | None]]):
    """`host.json`."""


R = TypeVar("R", bound=BaseModel)


def read_record(run: Run, name: str, kind: type[R]) -> R | None:
    """Read a JSON file of the run folder; `None` where the run doesn't have it.

    Raises:
        RunError: where it isn't what its name says.
    """
    path = run.folder / name
    if not path.is_file():
        return None
    try:
        return kind.model_validate(run.json(name))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "content"
        raise RunError(f"{path}: {where}: {first['msg']}; score the run again") from error
