"""Suite files: what they may hold, and in which line something is wrong."""

from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from fbench.replay.contracts.errors import ConfigError, did_you_mean, require_printable, require_whole
from fbench.replay.contracts.variants import read_config
from fbench.replay.formats.documents import TomlError, find_line, parse_toml

Place: TypeAlias = tuple[str | int, ...]
Text = Annotated[str, Field(min_length=1, max_length=1000), AfterValidator(require_printable)]
Number = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class LogTable(_Strict):
    """`[[logs]]`: logs by path, pattern or address, or simulated ones: those of all combinations."""

    path: Text | None = None
    """A file, a folder, a pattern such as `drives/*.mcap`, or an address that fsspec knows."""
    name: Text | None = None
    config: Text | None = None
    truth: Text | None = None
    truth_format: Text | None = None
    rig: list[Text] = []
    simulate: Text | Annotated[list[Text], Field(min_length=1)] | None = None
    """A simulated world."""
    condition: Text | Annotated[list[Text], Field(min_length=1)] = "clear"
    seconds: Annotated[float, Field(gt=0, le=86_400)] = 10.0
    seed: Seed | Annotated[list[Seed], Field(min_length=1)] = 0
    sensors: list[Text] = []
    set: list[Text] = []


class PipelineTable(_Strict):
    """`[pipelines.NAME]`: a pipeline with parameters and sensors."""

    base: Text | None = None
    """A name, a class, or a TOML file; else what the table is called."""
    set: list[Text] = []
    sensors: list[Text] = []
    detect_every: Annotated[int, Field(ge=1)] | None = None


class ReplayTable(_Strict):
    """`[replay]`: options of `fbench replay` for all cells."""

    reference: Text | None = None
    timeout_ms: Number | None = None
    tolerance_ms: Number | None = None
    max_gap_s: Number | None = None
    offset: list[Text] = []
    stamps: Literal["header", "log"] | None = None
    from_: Annotated[Text | None, Field(alias="from")] = None
    to: Text | None = None
    frames: Text | None = None
    interpolate_truth_ms: Number = 0.0
    latency: Text | None = None
    overload: Text | None = None
    on_fault: Literal["strict", "tolerant"] = "strict"
    fault_budget: list[Text] = []
    topics: list[Text] = []
    media: bool = False
    """Keep images and points in run folders."""


class ScoringTable(_Strict):
    """`[scoring]`: which boxes count and match, and with which profiles the runs are scored besides."""

    range_m: Annotated[float, Field(gt=0)] = 50.0
    in_view: bool = True
    distance_m: Annotated[float, Field(gt=0, le=1e6)] = 2.0
    iou: Annotated[float, Field(gt=0, le=1)] = 0.5
    regions: list[Text] = []
    seen: Annotated[int, Field(ge=0)] = 0
    cameras: list[Text] = []
    """Images in which boxes are scored; all where there are none."""
    profiles: list[Text] = []


class SuiteFile(_Strict):
    """A whole suite file."""

    version: Annotated[Literal[1], BeforeValidator(require_whole)]
    title: Annotated[str, Field(max_length=200), AfterValidator(require_printable)] = ""
    logs: Annotated[list[LogTable | Text], Field(min_length=1)]
    pipelines: (
        Annotated[list[Text], Field(min_length=1)] | Annotated[dict[Text, PipelineTable | Text], Field(min_length=1)]
    )
    """Names, or tables and names by what the suite calls them."""
    conditions: Annotated[list[Text], Field(min_length=1)] = ["clear"]
    severities: list[Annotated[int, Field(ge=1, le=5)]] = []
    """Of the conditions that don't say how strong they are; else 3."""
    rates: Annotated[list[Text], Field(min_length=1)] = ["max"]
    seeds: Annotated[list[Seed], Field(min_length=1)] = [0]
    replay: ReplayTable = ReplayTable()
    scoring: ScoringTable = ScoringTable()


class SuiteText:
    """A suite file as it is written, for errors that name its lines. Raises ConfigError where it can't be read, isn't
    TOML, or holds what isn't known.
    """

    def __init__(self, content: bytes, where: str) -> None:
        self.where = where
        try:
            tables = parse_toml(content)
            self.content = content.decode("utf-8-sig")
            self.file = SuiteFile.model_validate(tables)
        except TomlError as error:
            raise ConfigError(f"{where}: isn't TOML ({error})", "CFG003") from error
        except ValidationError as error:
            raise self._wrong(error, tables) from None

    @classmethod
    def read(cls, path: Path) -> "SuiteText":
        """Read a file."""
        return cls(read_config(path, "name the TOML file of a suite", "suite"), str(path))

    def error(self, place: Place, text: str) -> ConfigError:
        """Return the error about what stands at a place, with its line and key."""
        key = ".".join(map(str, place))
        return ConfigError(f"{self.where}:{find_line(self.content, place)}: '{key}': {text}", "CFG003")

    def _wrong(self, error: ValidationError, tables: dict[str, Any]) -> ConfigError:
        """Describe what is wrong first: of several models that something may be, by the one whose form it has."""
        found = [(_real(one["loc"], tables), one) for one in error.errors(include_url=False)]
        place, first = max(found, key=lambda pair: len(pair[0]))
        if first["type"] == "extra_forbidden":
            return self.error(place, f"isn't known{did_you_mean(str(place[-1]), _fields(place))}")
        if first["type"] == "missing":
            return self.error(place[:-1] or place, f"'{place[-1]}' is missing")
        own = [one for other, one in found if other == place]
        first = next((one for one in own if not one["type"].endswith("_type")), first)
        is_form = len(own) > 1 and first["type"].endswith("_type")
        why = _EXPECTED.get(str(place[0]), first["msg"]) if is_form else first["msg"]
        return self.error(place, why.removeprefix("Value error, "))


_EXPECTED = {
    "logs": "expected a path, or a table with path or simulate",
    "pipelines": "expected names, or tables [pipelines.NAME]",
}
_MODELS: dict[str, type[BaseModel]] = {
    "logs": LogTable, "pipelines": PipelineTable, "replay": ReplayTable, "scoring": ScoringTable,
}  # fmt: skip


def _fields(place: Place) -> list[str]:
    return field_names(SuiteFile if len(place) == 1 else _MODELS.get(str(place[0]), SuiteFile))


def field_names(model: type[BaseModel]) -> list[str]:
    """Return the keys of a table as the file has them."""
    return [field.alias or name for name, field in model.model_fields.items()]


def _real(place: Place, tables: object) -> Place:
    """Leave out what pydantic calls the members of a union: no keys of the file."""
    kept: list[str | int] = []
    at = tables
    for number, part in enumerate(place):
        is_last = number == len(place) - 1
        if isinstance(at, dict) and (part in at or (is_last and _is_name(part))):
            kept.append(part)
            at = at.get(part)
        elif isinstance(at, list) and isinstance(part, int) and part < len(at):
            kept.append(part)
            at = at[part]
    return tuple(kept)


def _is_name(part: str | int) -> bool:
    return isinstance(part, str) and part.isidentifier() and part not in ("str", "int", "LogTable", "PipelineTable")
