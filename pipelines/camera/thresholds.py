"""From which score on boxes count, and which of several on one object stays: as asked for, else as the weights say."""

from collections.abc import Mapping
from dataclasses import dataclass, fields

from fbench.replay.errors import ModelError


@dataclass(frozen=True)
class Thresholds:
    """All shares, 0 to 1. The defaults are for weights that say nothing."""

    min_score: float = 0.6
    nms_iou: float = 0.5
    nms_containment: float = 0.9


def thresholds(asked: Mapping[str, float | None], metadata: Mapping[str, str]) -> Thresholds:
    """Return what is asked for by name, else what the weights' metadata say under that name, else the defaults.

    Raises:
        ModelError: where metadata aren't numbers between 0 and 1; it names the entry, not the file.
    """
    said = {f.name: _share(f.name, metadata[f.name]) for f in fields(Thresholds) if f.name in metadata}
    return Thresholds(**(said | {name: value for name, value in asked.items() if value is not None}))


def _share(name: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = -1.0
    if not 0.0 <= value <= 1.0:
        raise ModelError(f"metadata entry '{name}': expected a number between 0 and 1, got {text[:40]!r}")
    return value
