"""Files beside a log that may belong to it, by their names alone."""

import os
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

_MAX_FILES = 2000
_MAX_SHOWN = 5
_BOX_WORDS = ("label", "truth", "annotation", "openlabel", "gt", "tracks", "boxes")
_RIG_WORDS = ("calib", "camchain", "camera_info", "extrinsic", "intrinsic", "rig", "urdf")


@dataclass(frozen=True)
class Beside:
    """Names of files and folders in the log's folder."""

    boxes: tuple[str, ...] = ()
    rigs: tuple[str, ...] = ()


def look_beside(config: Path, log: Path) -> Beside:
    """Look at the names in the folder of a configuration."""
    folder = config.resolve().parent
    try:
        with os.scandir(folder) as found:
            items = [(item.name, item.is_dir()) for item in islice(found, _MAX_FILES)]
    except OSError:
        return Beside()
    others = sorted(
        (name, is_dir) for name, is_dir in items if not name.startswith(".") and name not in (log.name, config.name)
    )
    boxes = [name for name, is_dir in others if _is_boxes(name, is_dir)]
    rigs = [name for name, is_dir in others if not is_dir and _is_rig(name)]
    return Beside(tuple(boxes[:_MAX_SHOWN]), tuple(rigs[:_MAX_SHOWN]))


def _is_boxes(name: str, is_dir: bool) -> bool:
    stem, suffix = os.path.splitext(name.lower())
    words = stem.replace("-", "_").replace(".", "_").split("_")
    is_called = any(word.rstrip("s") == known.rstrip("s") for word in words for known in _BOX_WORDS) or "label" in stem
    return is_called and (is_dir or suffix in (".csv", ".parquet", ".json", ".txt"))


def _is_rig(name: str) -> bool:
    stem, suffix = os.path.splitext(name.lower())
    return suffix == ".urdf" or (suffix in (".yaml", ".yml", ".toml") and any(word in stem for word in _RIG_WORDS))
