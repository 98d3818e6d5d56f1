"""Rows of nuScenes' tables, read one by one; names and units are the set's.

Schema: https://github.com/nutonomy/nuscenes-devkit, `docs/schema_nuscenes.md`.
"""

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, TextIO, TypeVar

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, FiniteFloat, ValidationError

from fbench.replay.contracts.errors import LimitError, LogError, wrong_field
from fbench.replay.contracts.importing import require_file
from fbench.replay.data.rig import Kind

_CHUNK = 2**20
MAX_ROW = 4 * 2**20  # No row is longer, in characters
_SPACE = re.compile(r"[ \t\n\r]*")
_DECODER = json.JSONDecoder()
MAX_US = (2**63 - 1) // 1000


def json_rows(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the objects of an array; holds a few of them at a time. Raises LogError where the file can't be read, isn't
    such an array, or is truncated; naming the row, counted from 0. Raises LimitError for a row longer than `MAX_ROW`.
    """
    require_file(path)
    try:
        with path.open(encoding="utf-8-sig") as file:
            yield from _Window(path, file).rows()
    except UnicodeDecodeError as error:
        raise LogError(f"{path}: isn't UTF-8 text ({error.reason})") from error
    except OSError as error:
        raise LogError(f"{path}: {error.strerror}") from error


class _Window:
    """The part of a file that is being decoded."""

    def __init__(self, path: Path, file: TextIO) -> None:
        self._path, self._file = path, file
        self._text, self._at, self._num = "", 0, 0

    def rows(self) -> Iterator[dict[str, Any]]:
        if self._next() != "[":
            raise LogError(f"{self._path}: isn't a table, expected a JSON array of objects")
        closing = self._next()
        while closing != "]":
            if self._num or closing == ",":
                if closing != "," or not self._num:
                    raise LogError(f"{self._path}: row {self._num}: expected ',' or ']', is the file truncated?")
            else:
                self._at -= len(closing)
            yield self._row()
            self._num += 1
            closing = self._next()
        if self._next():
            raise LogError(f"{self._path}: text follows the end of the array")

    def _next(self) -> str:
        """Return the next character that isn't a space, and go behind it; empty at the end of the file."""
        while True:
            self._at = self._behind_space()
            if self._at < len(self._text):
                self._at += 1
                return self._text[self._at - 1]
            if not self._read():
                return ""

    def _row(self) -> dict[str, Any]:
        while True:
            try:
                row, end = _DECODER.raw_decode(self._text, self._behind_space())
            except (ValueError, RecursionError) as error:  # malformed, or not read to its end
                if len(self._text) - self._at > MAX_ROW:
                    why = f"malformed or over {MAX_ROW} characters"
                    raise LimitError(f"{self._path}: row {self._num}: {why}") from error
                if self._read():
                    continue
                deep = isinstance(error, RecursionError)
                why = "nested too deeply" if deep else f"malformed JSON ({str(error).split(':')[0]})"
                raise LogError(f"{self._path}: row {self._num}: {why}, is the file truncated?") from error
            if not isinstance(row, dict):
                raise LogError(f"{self._path}: row {self._num}: expected an object")
            self._at = end
            return row

    def _behind_space(self) -> int:
        found = _SPACE.match(self._text, self._at)
        return found.end() if found else self._at

    def _read(self) -> bool:
        """Drop what was decoded and read on; false at the end of the file."""
        more = self._file.read(_CHUNK)
        self._text, self._at = self._text[self._at :] + more, 0
        return bool(more)


def _unit(wxyz: tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    if abs(sum(value * value for value in wxyz) - 1) > 1e-3:
        raise ValueError("isn't a unit quaternion")
    return wxyz


Token = Annotated[str, Field(pattern=r"^[!-~]{1,64}$")]
"""Printable ASCII without spaces, so that tokens can stand in a list."""
Link = Annotated[str, Field(pattern=r"^[!-~]{0,64}$")]  # A token; empty where there is none
Words = Annotated[str, Field(max_length=4000)]  # Any text; the limit makes pydantic refuse what isn't Unicode, too
Microseconds = Annotated[int, Field(ge=0, le=MAX_US)]
Three = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Quaternion = Annotated[tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat], AfterValidator(_unit)]  # w, x, y, z
Length = Annotated[FiniteFloat, Field(gt=0)]
Count = Annotated[int, Field(ge=0, lt=2**31)]
Pixels = Annotated[Count | None, BeforeValidator(lambda value: value or None)]
"""Absent, 0 or empty where there is no image."""


class Row(BaseModel):
    """A row of any table."""

    model_config = ConfigDict(frozen=True)
    token: Token


class Scene(Row):
    """`scene`."""

    name: Annotated[str, Field(min_length=1, max_length=200)]
    description: Words = ""
    log_token: Token
    nbr_samples: Count
    first_sample_token: Token
    last_sample_token: Token


class Sample(Row):
    """`sample`."""

    scene_token: Token
    timestamp: Microseconds
    prev: Link = ""
    next: Link = ""


class SampleData(Row):
    """`sample_data`."""

    sample_token: Token
    ego_pose_token: Token
    calibrated_sensor_token: Token
    timestamp: Microseconds
    is_key_frame: bool
    filename: Words
    width: Pixels = None
    height: Pixels = None


class EgoPose(Row):
    """`ego_pose`: the body's pose in the world."""

    timestamp: Microseconds
    translation: Three
    rotation: Quaternion


class CalibratedSensor(Row):
    """`calibrated_sensor`: the sensor's pose on the body."""

    sensor_token: Token
    translation: Three
    rotation: Quaternion
    camera_intrinsic: list[Three] = []


class Sensor(Row):
    """`sensor`."""

    channel: Annotated[str, Field(pattern=r"^[A-Za-z0-9_.+-]{1,100}$")]
    modality: Kind


class Annotation(Row):
    """`sample_annotation`: a box in the world; `size` is width, length, height."""

    sample_token: Token
    instance_token: Token
    attribute_tokens: tuple[Token, ...] = ()
    visibility_token: Link = ""
    translation: Three
    size: tuple[Length, Length, Length]
    rotation: Quaternion
    num_lidar_pts: Count
    num_radar_pts: Count
    prev: Link = ""
    next: Link = ""


class Instance(Row):
    """`instance`."""

    category_token: Token


class Named(Row):
    """`category` and `attribute`."""

    name: Annotated[str, Field(min_length=1, max_length=200)]


class Visibility(Row):
    """`visibility`."""

    level: Words


class Log(Row):
    """`log`."""

    logfile: Words = ""
    vehicle: Words = ""
    date_captured: Words = ""
    location: Words = ""


R = TypeVar("R", bound=Row)


def parse_row(model: type[R], row: Mapping[str, Any], path: Path) -> R:
    """Check a row. Raises LogError naming its token and the first field that is wrong."""
    try:
        return model.model_validate(row)
    except ValidationError as error:
        token, (field, why) = str(row.get("token"))[:64], wrong_field(error)
        # Not `token: why`, of which nothing would be shown, as of any secret.
        raise LogError(f"{path}: row with token '{token}': {field} is wrong ({why})") from error


def parse_rows(model: type[R], path: Path) -> Iterator[R]:
    """Yield all rows of a table. Raises LogError for the first one that is wrong."""
    return (parse_row(model, row, path) for row in json_rows(path))


def read_by_token(model: type[R], path: Path) -> dict[str, R]:
    """All rows of a small table. Raises LogError for the first one that is wrong, or has the token of another."""
    rows: dict[str, R] = {}
    for row in parse_rows(model, path):
        if row.token in rows:
            raise LogError(f"{path}: two rows have the token '{row.token}'")
        rows[row.token] = row
    return rows
