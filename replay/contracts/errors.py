"""Errors, exit codes and the near names that errors suggest."""

import difflib
import errno
import traceback
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from fbench.replay.runs.secrets import without_secrets

if TYPE_CHECKING:
    from pydantic import BaseModel, ValidationError

EXIT_OK = 0
EXIT_NO = 1
EXIT_USAGE = 2
EXIT_DATA = 3
EXIT_LOSSY = 4
_MAX_CHARS = 1200
"""Longer messages lose their middle, which then is a name or value from data."""
_MAX_TEXT = 1 << 20
_MAX_NAME = 200


def _clean(text: str) -> str:
    """Return a text of any origin as one short line: what isn't printable becomes a space, and credentials go."""
    half = _MAX_CHARS // 2
    short = text if len(text) <= _MAX_CHARS else f"{text[:half]} ... {text[-half:]}"
    return "".join(c if c.isprintable() else " " for c in without_secrets(short))


class FbenchError(Exception):
    """Root of all errors that fbench raises on purpose.

    The message is one line: what, where (file, topic, stamp, offset), what to do. What isn't printable in names that
    come from data becomes a space; credentials are left out.
    """

    exit_code = EXIT_DATA

    def __init__(self, text: str = "", code: str = "") -> None:
        super().__init__(_clean(text))
        self.code = code
        """Row of the fault table (`replay/contracts/faults.py`), empty where none fits."""

    @property
    def line(self) -> str:
        """The message, and the code where there is one."""
        return f"{self} [{self.code}]" if self.code else str(self)


class ConfigError(FbenchError):
    """Usage or configuration: an unknown name, a wrong parameter, an output folder that exists."""

    exit_code = EXIT_USAGE


class BusyError(ConfigError):
    """An output that another process is writing."""


class OutputError(ConfigError):
    """An output that has a good place, where the system lets nothing be written: the disk is full, or no one may."""

    exit_code = EXIT_DATA


class MissingPackageError(ConfigError):
    """A package of an extra that isn't installed, met when it is needed."""


class LogError(FbenchError):
    """A log that can't be used: wrong format, no calibration, no such sensor."""


class LimitError(LogError):
    """Data that would take more memory than fbench grants them."""


class DecodeError(LogError):
    """One message whose payload can't be decoded; readers count it and go on."""


class UnsupportedError(DecodeError):
    """A message in a form that fbench has no use for, such as a depth image."""


class DepthError(UnsupportedError):
    """A depth image, which no pipeline uses as a picture."""


class PointsError(DecodeError):
    """A cloud whose sizes don't fit together, or that has no coordinates."""


class DataError(FbenchError):
    """An array of the wrong shape or dtype: names field, expected and got."""


class ModelError(FbenchError):
    """Weights that can't be fetched or loaded, or whose outputs aren't understood."""


class RunError(FbenchError):
    """A run folder that is missing, incomplete or of another version."""


class MetricError(FbenchError):
    """Truth or results that can't be scored."""


class ReportedError(Exception):
    """What a plug-in raised in a process of its own, as the line that `one_line` made there."""


class TerminatedError(BaseException):
    """SIGTERM came."""


INTERRUPTS = (KeyboardInterrupt, TerminatedError)
"""What ends fbench from outside. A plug-in may raise anything else, and it counts as the plug-in's failure."""


_REFUSALS = frozenset(
    getattr(errno, name) for name in ("EACCES", "EPERM", "EROFS", "ENOSPC", "EDQUOT", "EFBIG", "EIO", "ENOMEM")
)


def output_error(where: object, error: Exception, hint: str = "") -> ConfigError:
    """Return the error for an output that can't be written: a usage error where the place is wrong, such as below a
    file; `hint` follows the reason.
    """
    given = error.errno if isinstance(error, OSError) else errno.EIO
    reason = (error.strerror if isinstance(error, OSError) else None) or next(iter(str(error).splitlines()), "")
    kind = OutputError if given in _REFUSALS else ConfigError
    return kind(f"{where}: can't be written ({reason}){hint}")


def one_line(error: BaseException) -> str:
    """What a plug-in raised, with the place where it did."""
    if isinstance(error, ReportedError):
        return _clean(str(error))
    try:
        text = str(error)
    except INTERRUPTS:
        raise
    except BaseException as second:  # noqa: BLE001 - the text of a plug-in's error is made by the plug-in, too
        text = f"its text can't be made ({type(second).__name__})"
    what = next(iter(text[:_MAX_TEXT].splitlines()), "no message")
    places = traceback.extract_tb(error.__traceback__)
    place = f" ({Path(places[-1].filename).name}:{places[-1].lineno})" if places else ""
    return f"{type(error).__name__}: {_clean(what)}{place}"


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return `; did you mean 'x'?`, or the known names where none is near."""
    names, name = sorted(known), name[:_MAX_NAME]
    lower = {n.lower(): n for n in names}
    near = difflib.get_close_matches(name.lower(), list(lower), n=1, cutoff=0.6)
    if not near:
        near = [n for n in sorted(lower) if n.endswith(f".{name.lower()}")][:1]
    if near:
        return f"; did you mean '{lower[near[0]]}'?"
    return f"; there are: {', '.join(names)}" if names else "; there are none"


def wrong_field(error: "ValidationError") -> tuple[str, str]:
    """Return the name of the first field that isn't as its model says, empty for the whole, and why."""
    first = error.errors(include_url=False)[0]
    return ".".join(map(str, first["loc"])), first["msg"]


def first_wrong(error: "ValidationError") -> str:
    """Return the first field that isn't as its model says, and why: `objects.0.size: Field required`."""
    return ": ".join(text for text in wrong_field(error) if text)


def require_printable(text: str) -> str:
    """Return a text of a configuration. Raises ValueError where it holds what no name or path needs, such as NUL."""
    if not text.isprintable():
        raise ValueError("has characters that can't be printed")
    return text


def require_whole(value: object) -> object:
    """Return a number of a configuration. Raises ValueError for `true` and `1.0`, which Python takes for 1."""
    if type(value) is not int:
        raise ValueError("expected a whole number")
    return value


def wrong_key(error: "ValidationError", table_of: Callable[[list[str]], "type[BaseModel]"], hint: str = "") -> str:
    """Say what is wrong first in a TOML file: `table_of` gives the table of a key that isn't known, for the name that
    may be meant, and `hint` follows.
    """
    found = error.errors(include_url=False)[0]
    keys = [str(part) for part in found["loc"]]
    place = ".".join(keys)
    if found["type"] == "extra_forbidden":
        names = [field.alias or name for name, field in table_of(keys).model_fields.items()]
        return f"'{place}' isn't known{did_you_mean(keys[-1], names)}{hint}"
    if found["type"] == "missing":
        return f"'{place}' is missing"
    return f"'{place}': {found['msg'].removeprefix('Value error, ')}"
