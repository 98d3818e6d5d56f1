"""What an `fbench.toml` may hold, checked when it is read."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator

from fbench.replay.classes import IGNORE
from fbench.replay.data import LABELS, Kind
from fbench.replay.logs.setup import Doppler, EgoMotion
from fbench.replay.names import did_you_mean
from fbench.replay.restamp import MAX_OFFSET_MS

NAME = "fbench.toml"

Name = Annotated[str, Field(min_length=1, max_length=1000)]
Duration = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class FramesTable(_Strict):
    """`[frames]`: how messages become frames."""

    reference: Name | None = None
    timeout_ms: Duration | None = None
    tolerance_ms: Duration = 50.0
    max_gap_s: Duration = 2.0
    stamps: Literal["header", "log"] = "header"


class BodyTable(_Strict):
    """`[body]`: where sensors are."""

    frame: str = ""
    """Coordinate frame of the body; empty: as its name tells."""
    pose: str = ""
    """Topic with poses of the body in the world; empty: as the log says."""
    world: str = ""
    """Coordinate frame in which poses from `/tf` are wanted; empty: the one above all others."""
    rig: tuple[Name, ...] = Field(default=(), strict=False, max_length=100)
    """Files with calibration, relative to this one; the first one that names a sensor counts."""


class SensorTable(_Strict):
    """`[sensors.NAME]`: one sensor."""

    topic: Name
    kind: Kind
    frame: str = ""
    calibration: str = ""
    offset_ms: Annotated[float, Field(ge=-MAX_OFFSET_MS, le=MAX_OFFSET_MS, allow_inf_nan=False)] = 0.0
    doppler: Doppler = "receding"
    ego_motion: EgoMotion = "included"
    velocity_period_mps: Annotated[float, Field(ge=0, le=1000, allow_inf_nan=False)] | None = None
    optional: bool = False


class BoxesTable(_Strict):
    """`[truth]` and `[results]`: boxes, from topics of the log or from a file beside it."""

    topics: tuple[Name, ...] | None = Field(default=None, strict=False)
    file: Name | None = None
    format: str | None = None
    frame: str = ""
    camera: str = ""


class Config(_Strict):
    """A whole `fbench.toml`."""

    version: Literal[1]
    frames: FramesTable = FramesTable()
    body: BodyTable = BodyTable()
    sensors: dict[Name, SensorTable] = {}
    """By name: these topics and no others; without any, the log decides."""
    truth: BoxesTable = BoxesTable()
    results: BoxesTable = BoxesTable()
    classes: dict[str, str] = {}
    """Label of fbench, or `ignore`, by the name that the log gives to a class."""

    @field_validator("classes")
    @classmethod
    def _labels_exist(cls, classes: dict[str, str]) -> dict[str, str]:
        known = (*LABELS, IGNORE)
        for name, label in classes.items():
            if label not in known:
                raise ValueError(f"'{name}' is to be '{label}', which is no label{did_you_mean(label, known)}")
        return classes
