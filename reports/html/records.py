"""Records that the report reads besides tables and scores, text as the page shows it, and templates."""

import json
import math
import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from functools import cache, partial
from hashlib import sha256
from importlib.resources import files
from typing import Any, TypeVar

import jinja2
from markupsafe import Markup
from pydantic import BaseModel, ConfigDict, RootModel, ValidationError

from fbench.replay.contracts.errors import RunError, wrong_field
from fbench.replay.runs.folder import Run

R = TypeVar("R", bound=BaseModel)
PACKAGE = "fbench.reports.html"
DASH = "–"
_INVISIBLE = re.compile(
    "[\x00-\x08\x0b-\x1f\x7f-\x9f\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff\ufff9-\ufffb\ud800-\udfff]"
)
_SCRIPT_ESCAPES = {ord(c): f"\\u{ord(c):04x}" for c in "<>&'\u2028\u2029"}


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
    p90_ms: float | None = None
    p95_ms: float | None = None
    p99_ms: float | None = None
    p999_ms: float | None = None
    max_ms: float | None = None
    first_ms: float | None = None
    cpu_mean_ms: float | None = None
    reason: str | None = None


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
    warm_up_frames: int = 0
    compiled_frames: int = 0
    stages: list[Stage]


class Host(RootModel[Mapping[str, str | float | int | bool | None]]):
    """`host.json`."""


def read_record(run: Run, name: str, kind: type[R]) -> R | None:
    """Read a JSON file of a run; `None` where it has none. Raises RunError where it isn't what its name says."""
    path = run.folder / name
    if not path.is_file():
        return None
    try:
        return kind.model_validate(run.json(name))
    except ValidationError as error:
        where, why = wrong_field(error)
        raise RunError(f"{path}: {where or 'content'}: {why}; score the run again") from error


def visible(text: str) -> str:
    """Write control, direction and other invisible characters as `\\x1b`, so that they neither act nor hide."""
    return _INVISIBLE.sub(lambda m: f"\\x{code:02x}" if (code := ord(m[0])) < 256 else f"\\u{code:04x}", text)


def number(value: float | None, digits: int = 3) -> str:
    """Format with a true minus sign; an en dash for `None` and what isn't finite."""
    if value is None or not math.isfinite(value):
        return DASH
    text = f"{value:,.{digits}f}".replace(",", "\u202f")
    return text.replace("-", "\u2212") if float(f"{value:.{digits}f}") else text.replace("-", "")


def shade(share: float | None) -> int | None:
    """Return a share from 0 to 1 in whole tenths, for the color of its cell; `None` for `None`."""
    return None if share is None else math.floor(10 * min(1.0, max(0.0, share)))


def positive(text: str) -> float:
    """Return the number that a text is; 0 where it is no positive one."""
    try:
        value = float(text)
    except ValueError:
        return 0.0
    return value if math.isfinite(value) and value > 0 else 0.0


def brief(text: str, length: int = 12) -> str:
    """Return the first characters of a digest."""
    return text[:length]


def round_floats(value: Any, digits: int = 3) -> Any:
    """Round floats for display, at any depth; NaN and infinities become `None`, strings visible."""
    if isinstance(value, float):
        return round(value, digits) + 0.0 if math.isfinite(value) else None
    if isinstance(value, str):
        return visible(value)
    if isinstance(value, Mapping):
        return {visible(str(k)): round_floats(v, digits) for k, v in value.items()}
    if isinstance(value, Sequence):
        return [round_floats(v, digits) for v in value]
    return value


def island(value: Any) -> str:
    """Encode as JSON that is safe inside a `<script type="application/json">`: nothing in it can end the element."""
    text = json.dumps(round_floats(value), allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    return text.translate(_SCRIPT_ESCAPES)


def resource(package: str, name: str) -> str:
    """Text of a file of a package."""
    return files(package).joinpath(name).read_text("utf-8")


def read_style(*names: str) -> Markup:
    """Style sheets of the package, one after another."""
    return Markup("\n".join(resource(PACKAGE, name) for name in names))  # noqa: S704 - part of the package


def read_script(*names: str) -> Markup:
    """Scripts of the package, in a scope of their own."""
    parts = "\n".join(resource(PACKAGE, name) for name in names)
    return Markup(f'"use strict";\n(() => {{\n{parts}\n}})();')  # noqa: S704


def allow(content: str) -> str:
    """Return the source of a Content-Security-Policy that allows an inline script or style by its digest."""
    return f"'sha256-{b64encode(sha256(content.encode('utf-8')).digest()).decode('ascii')}'"


@cache
def environment(package: str) -> jinja2.Environment:
    """Templates of a package; they make text visible, then escape it."""

    def show(value: object) -> object:
        return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value

    made = jinja2.Environment(
        loader=jinja2.FunctionLoader(partial(resource, package)),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=show,
    )
    made.filters["capitalize_first"] = lambda text: text[:1].upper() + text[1:]
    made.filters |= {"number": number, "brief": brief, "csp": lambda content: Markup(allow(content))}  # noqa: S704
    return made
