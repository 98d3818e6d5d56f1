"""YAML files of others, read as untrusted input."""

from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import CollectionEndEvent, CollectionStartEvent, NodeEvent

MAX_SIZE = 4 * 1024 * 1024
_MAX_DEPTH = 32


class YamlFileError(Exception):
    """What is wrong with a file, in one line without its name."""

    def __init__(self, text: str, mendable: bool = True) -> None:
        super().__init__(text)
        self.mendable = mendable
        """Whether the content is damaged, so that writing the file anew would help."""


def read_yaml(path: Path, max_size: int = MAX_SIZE) -> object:
    """Return the content of a file as dicts, lists and texts.

    Raises:
        YamlFileError: where it can't be read, is too large or isn't what `parse_yaml` takes.
    """
    try:
        with path.open("rb") as file:
            content = file.read(max_size + 1)
    except OSError as error:
        raise YamlFileError(f"can't be read ({error.strerror})", mendable=False) from error
    if len(content) > max_size:
        raise YamlFileError(f"has more than the limit of {max_size} bytes", mendable=False)
    return parse_yaml(content)


def parse_yaml(content: bytes) -> object:
    """Parse without interpreting: every value is text, so that no tag, date or number can do harm.

    Raises:
        YamlFileError: where it is damaged, nested too deeply, or has aliases or one key twice.
    """
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise YamlFileError(f"isn't UTF-8 text ({error.reason} at byte {error.start})") from error
    try:
        _check_shape(text)
        return _parser().load(text)
    except YAMLError as error:
        reason = " ".join(str(error).split())
        raise YamlFileError(f"can't be parsed ({reason[:200]})") from error


def _parser() -> Any:
    return YAML(typ="base", pure=True)


def _check_shape(text: str) -> None:
    depth = 0
    for event in _parser().parse(text):
        if isinstance(event, NodeEvent) and event.anchor is not None:
            line = event.start_mark.line + 1
            raise YamlFileError(f"line {line}: YAML anchors and aliases aren't allowed here", mendable=False)
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        if depth > _MAX_DEPTH:
            line = event.start_mark.line + 1
            raise YamlFileError(f"line {line}: nested more than {_MAX_DEPTH} deep", mendable=False)
