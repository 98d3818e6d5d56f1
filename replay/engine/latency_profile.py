"""Profiles of latency: how long each stage of a pipeline took on a machine, by what the frames held, to draw from.

A stage's time is a base, plus a rate for each point, box and pixel of the frame, plus a residual. Residuals are kept
frame by frame, so that stages that were slow together are drawn together (bootstrap of residuals, Efron 1979). All is
integer arithmetic on the numbers of the file and random bits of Philox, so any host draws the same.
"""

import json
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property
from hashlib import blake2b
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.runs.digest import digest
from fbench.replay.runs.folder import Run
from fbench.replay.runs.secrets import clean_mapping

MOST_NS = 86_400 * 10**9
"""A frame takes at most a day of log time, so that instants are whole 64-bit numbers."""
REST = "(rest)"
"""Stage that is what the others leave of the whole frame; where branches run in parallel, it may be negative."""
_Kind: TypeAlias = Literal["fbench latency profile"]
_Version: TypeAlias = Literal[1]
KIND: _Kind = "fbench latency profile"
VERSION: _Version = 1
_MOST_BYTES = 64 << 20
_NS = Annotated[int, Field(ge=0, le=MOST_NS)]
_Residual = Annotated[int, Field(ge=-MOST_NS, le=MOST_NS)]
_Rate = Annotated[int, Field(ge=0, le=1000 * MOST_NS)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


@dataclass(frozen=True)
class FrameContent:
    """What a frame held, as far as it decides how long the pipeline takes."""

    num_points: int
    """Of LiDAR and radar."""
    num_boxes: int
    """Detections that the pipeline gave."""
    num_pixels: int


class StageModel(_Strict):
    """How long a stage takes by what the frame holds, without its residual."""

    stage: str
    base_ns: _NS
    ps_per_point: _Rate
    ps_per_box: _Rate
    ps_per_pixel: _Rate

    def predict_ns(self, content: FrameContent) -> int:
        """Return its time [ns] in such a frame."""
        more = self.ps_per_point * content.num_points + self.ps_per_box * content.num_boxes
        return self.base_ns + (more + self.ps_per_pixel * content.num_pixels) // 1000


class LatencyProfile(_Strict):
    """How long a pipeline took on a machine."""

    kind: _Kind = KIND
    version: _Version = VERSION
    pipeline: str
    log: str  # Name of the log on which it was recorded
    repeats: Annotated[int, Field(ge=1)]
    host: dict[str, Any]  # As in `host.json`
    parameters: dict[str, str] = Field(default_factory=dict)
    """Digest of each parameter's value; empty: unknown."""
    stages: Annotated[list[StageModel], Field(min_length=1)]
    residuals_ns: Annotated[list[list[_Residual | None]], Field(min_length=1)]
    """Of each frame that was measured, a number a stage; null where the stage didn't run."""

    @model_validator(mode="after")
    def _check(self) -> Self:
        names = [model.stage for model in self.stages]
        if len({*names}) < len(names) or REST not in names:
            raise ValueError(f"stages: expected different ones, and '{REST}' among them")
        for row, residuals in enumerate(self.residuals_ns):
            if len(residuals) != len(names) or residuals[names.index(REST)] is None:
                raise ValueError(
                    f"residuals_ns.{row}: expected {len(names)} numbers, null only where a stage didn't run"
                )
        return self

    @cached_property
    def _rows(self) -> dict[frozenset[str], list[int]]:
        """The frames that were measured, by the stages that ran in them."""
        rows: dict[frozenset[str], list[int]] = {}
        for row, residuals in enumerate(self.residuals_ns):
            pairs = zip(self.stages, residuals, strict=True)
            rows.setdefault(frozenset(m.stage for m, ns in pairs if ns is not None), []).append(row)
        return rows

    def draw_ns(self, seed: int, log_id: str, frame: int, content: FrameContent, ran: Collection[str] | None) -> int:
        """Return how long a frame takes [ns], of the wall clock. Depends on the arguments alone.

        The residuals are those of one frame that was measured, in which the same stages ran; else one in which they
        and others ran; else any, where a stage that didn't run then has no residual. `ran` are the stages that run in
        this frame, `None`: unknown, so they are those of the frame that was drawn. Raises ConfigError where a stage
        isn't in the profile.
        """
        known = [model.stage for model in self.stages]
        if unknown := [stage for stage in ran or () if stage not in known]:
            raise ConfigError(
                f"--latency profile: the pipeline runs stage '{unknown[0]}', which the profile doesn't know; record "
                "one with the same parameters and sensors"
            )
        wanted = frozenset() if ran is None else frozenset((*ran, REST))
        rows = self._rows.get(wanted) or [row for own, rows in self._rows.items() if wanted <= own for row in rows]
        rows = sorted(rows) or [*range(len(self.residuals_ns))]
        bits = int(generator(seed, "latency", log_id, frame).bit_generator.random_raw())
        residuals = self.residuals_ns[rows[bits * len(rows) >> 64]]
        total_ns = 0
        for model, residual in zip(self.stages, residuals, strict=True):
            if model.stage in wanted or (ran is None and residual is not None):
                total_ns += model.predict_ns(content) + (residual or 0)
        return min(max(total_ns, 0), MOST_NS)

    def draw_run_ns(self, seed: int, run: Run, log_id: str) -> list[int]:
        """Return how long each frame of a run of a log in lockstep takes [ns], of the wall clock."""
        stages: dict[int, list[str]] = {}
        for stage, times in run.frame_times.items():
            for frame in times if stage != "total" else ():
                stages.setdefault(frame, []).append(stage)
        found = []
        for record in run.frames:
            content = FrameContent(record.num_points or 0, len(run.detections.at(record.index)), record.num_pixels or 0)
            ran = stages.get(record.index, []) if record.failed is None else None
            found.append(self.draw_ns(seed, log_id, record.index, content, ran))
        return found

    def require_pipeline(self, name: str) -> None:
        """Refuse another pipeline. Raises ConfigError."""
        if name != self.pipeline:
            raise ConfigError(f"--latency profile: was recorded of pipeline '{self.pipeline}', not of '{name}'")

    def require_parameters(self, parameters: Mapping[str, object]) -> None:
        """Refuse a pipeline with other values of parameters, as far as they are known. Raises ConfigError."""
        now = digest_parameters(parameters)
        other = [name for name, value in self.parameters.items() if now.get(name, value) != value]
        if other:
            more = f", and {len(other) - 1} more" if len(other) > 1 else ""
            raise ConfigError(
                f"--latency profile: was recorded with another value of parameter {other[0]}{more}; record one with "
                "the same parameters"
            )


def digest_parameters(parameters: Mapping[str, object]) -> dict[str, str]:
    """Return a digest of each parameter's value. Of a file its content counts, not where it is."""

    def essence(value: object) -> object:
        if isinstance(value, Mapping):
            return {name: essence(part) for name, part in sorted(value.items()) if name != "file" or len(value) == 1}
        return value

    return {name: digest(json.dumps(essence(value))) for name, value in sorted(clean_mapping(parameters).items())}


def load_profile(path: Path) -> tuple[LatencyProfile, str]:
    """Read a profile and its digest. Raises ConfigError where it can't be read, or isn't one of this version."""
    try:
        if not path.is_file():
            raise ConfigError(f"--latency profile:{path}: no such file; fbench profile writes one")
        if path.stat().st_size > _MOST_BYTES:
            raise ConfigError(f"{path}: not a latency profile (more than {_MOST_BYTES >> 20} MiB)")
        data = path.read_bytes()
        content = json.loads(data)
    except (OSError, ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not a latency profile (can't be read as JSON: {error})") from error
    if not isinstance(content, dict) or content.get("kind") != KIND:
        raise ConfigError(f"{path}: not a latency profile; fbench profile writes one")
    if content.get("version") != VERSION:
        raise ConfigError(
            f"{path}: is a latency profile of version {content.get('version')!r}, this fbench reads {VERSION}; "
            "record it again"
        )
    try:
        profile = LatencyProfile.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(map(str, first["loc"])) or "content"
        raise ConfigError(f"{path}: {where}: {first['msg']}") from error
    return profile, blake2b(data, digest_size=16).hexdigest()
