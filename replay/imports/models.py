"""Files of datasets that hold JSON, checked by models of pydantic."""

from pathlib import Path
from typing import TypeVar

from pydantic import TypeAdapter, ValidationError

from fbench.replay.errors import LogError
from fbench.replay.imports.files import read_bytes

T = TypeVar("T")


def read_json(path: Path, model: type[T]) -> T:
    """Return the content of a JSON file.

    Raises:
        LogError: naming file and field, where it can't be read or isn't as the model says.
    """
    try:
        return TypeAdapter(model).validate_json(read_bytes(path))
    except ValidationError as error:
        raise LogError(f"{path}: {first_wrong(error)}") from error


def first_wrong(error: ValidationError) -> str:
    """Return the first field that isn't as its model says, and why: `objects.0.size: Field required`."""
    return ": ".join(text for text in wrong_field(error) if text)


def wrong_field(error: ValidationError) -> tuple[str, str]:
    """Return the name of the first field that isn't as its model says, empty for the whole, and why."""
    first = error.errors()[0]
    return ".".join(str(part) for part in first["loc"]), first["msg"]
