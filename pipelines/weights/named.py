"""Names of weights where a path is expected."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, TypeAlias

from fbench.pipelines.weights.cache import state, weights_folder
from fbench.pipelines.weights.catalogue import CATALOGUE, Entry, entry_named
from fbench.replay.errors import ConfigError, ModelError
from fbench.replay.files import expanded, is_file

Weights: TypeAlias = Literal["auto"] | Path | None
"""A file, or a name of the catalogue; `auto` are the built-in ones on simulated logs, and none on others."""
AUTO: Literal["auto"] = "auto"
_PARAMETER = ".weights"


def resolve(weights: Weights, catalogue: Sequence[Entry] = CATALOGUE) -> Weights:
    """Return the file of a name of the catalogue; paths, `auto` and `None` stay as they are.

    A name is what has neither folder nor suffix, unless a file is called so.

    Raises:
        ConfigError: for an unknown name, and where the file wasn't fetched.
        ModelError: where the file isn't the published one.
    """
    if not isinstance(weights, Path) or weights.suffix or weights.parent != Path() or is_file(weights):
        return weights
    if os.path.isdir(weights) and all(entry.name != weights.name for entry in catalogue):
        raise ConfigError(f"weights '{weights}': a folder; name an ONNX file")
    entry = entry_named(weights.name, catalogue)
    path = weights_folder() / entry.file_name
    found = state(entry, path)
    if found == "absent":
        raise ConfigError(f"weights '{entry.name}' aren't at {path}: fbench weights get {entry.name}")
    if found == "damaged":
        raise ModelError(f"{path}: isn't {entry.name} as published; to fetch it anew: fbench weights get {entry.name}")
    return path


def resolve_settings(settings: Sequence[str], catalogue: Sequence[Entry] = CATALOGUE) -> tuple[str, ...]:
    """Return settings `SENSOR.NAME=VALUE` with files in place of names, where they set weights; see `resolve`."""
    return tuple(_resolved(setting, catalogue) for setting in settings)


def _resolved(setting: str, catalogue: Sequence[Entry]) -> str:
    path, _, text = setting.partition("=")
    if not path.endswith(_PARAMETER) or text in (AUTO, "none"):
        return setting
    return f"{path}={resolve(expanded(text), catalogue)}"
