"""Guesses of truth and results: topics and files, and what their classes mean."""

import os
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

from fbench.replay.contracts.errors import DataError, DecodeError
from fbench.replay.data.boxes import Boxes
from fbench.replay.data.classes import is_known, label
from fbench.replay.logs.codecs.codec import Origin, TruthPart
from fbench.replay.logs.container import Entry
from fbench.replay.logs.roles import Role
from fbench.replay.setup.inspection import Line, Look, Table, sampled

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


_MAX_ENTRIES = 500  # Messages with boxes of a window that are read for their classes
_MAX_CLASSES = 100
_MAX_NAME = 200


@dataclass
class _Met:
    """Classes by the names that a source gives them."""

    nums: Counter[str] = field(default_factory=Counter)
    labels: dict[str, Counter[str]] = field(default_factory=dict)
    certain: dict[str, bool] = field(default_factory=dict)  # False where nobody has said what a name means


def truth_table(look: Look, beside: Beside) -> Table:
    """Write `[truth]`."""
    topics = _topics(look, "truth")
    files = _files(beside)
    if topics:
        own = all(role.is_own for role in look.roles.values() if role.kind == "truth")
        why = "the log says so" if own else "called so"
        return Table(("truth",), (Line("topics", topics, why), *files))
    if files:
        return Table(("truth",), files, notes=("No topic of the log is called truth, gt, label or annotation.",))
    example = Line(
        "file", "labels.parquet", "boxes beside the log: Parquet, CSV, KITTI, OpenLABEL ...", is_active=False
    )
    return Table(("truth",), (example,), notes=("The log holds no ground truth, so runs have no accuracy.",))


def _files(beside: Beside) -> tuple[Line, ...]:
    return tuple(Line("file", name, "beside the log; is it ground truth?", is_active=False) for name in beside.boxes)


def results_table(look: Look) -> Table | None:
    """Write `[results]` where the log has boxes that aren't called truth."""
    topics = _topics(look, "detections")
    if not topics:
        return None
    why = "boxes that aren't called truth, so of some system: score them with -p recorded:TOPIC"
    return Table(("results",), (Line("topics", topics, why, is_guess=True),))


def _topics(look: Look, kind: str) -> tuple[str, ...]:
    return tuple(sorted({role.topic for role in look.roles.values() if role.kind == kind}))


def classes_table(look: Look) -> Table | None:
    """Write `[classes]` from the names that were met in the sample; `None` where there are none."""
    met = _Met()
    channels = frozenset(id_ for id_, role in look.roles.items() if role.kind in ("truth", "detections"))
    for sample in sampled(look.container, channels, look.times, _MAX_ENTRIES):
        _take(met, look.roles[sample.entry.channel], sample.entry)
    if not met.nums:
        return None
    names = sorted(met.nums, key=lambda name: (-met.nums[name], name))
    notes = ["By the names that the log gives, counted in a sample; 'ignore' leaves a class out of scores."]
    notes += [f"{len(names) - _MAX_CLASSES} rarer names aren't listed."] if len(names) > _MAX_CLASSES else []
    lines = tuple(_class_line(name, met) for name in names[:_MAX_CLASSES])
    return Table(("classes",), lines, notes=tuple(notes))


def _class_line(name: str, met: _Met) -> Line:
    meant = min(met.labels[name].items(), key=lambda item: (-item[1], item[0]))[0]
    num = met.nums[name]
    count = f"{num} {'box' if num == 1 else 'boxes'}"
    return Line(name, meant, count if met.certain[name] else f"{count}, not a known name", not met.certain[name])


def _take(met: _Met, role: Role, entry: Entry) -> None:
    try:
        part = _part(role, entry)
    except (DecodeError, DataError):
        return
    for boxes in (part.truth.boxes3d, part.truth.boxes2d):
        if boxes is not None and boxes.source_label is not None:
            _count(met, boxes, role.is_own)


def _part(role: Role, entry: Entry) -> TruthPart:
    if isinstance(entry.data, memoryview):
        if role.codec is None:
            raise DecodeError("no codec")
        return role.codec.truth(entry.data, Origin(role.sensor, entry.log_ns, entry.publish_ns))
    stored = entry.data.read()
    if not isinstance(stored, TruthPart):
        raise DecodeError("a measurement in the place of truth")
    return stored


def _count(met: _Met, boxes: Boxes, is_own: bool) -> None:
    names: list[str] = [] if boxes.source_label is None else boxes.source_label.tolist()
    meant = [label(name) for name in names] if boxes.label is None else boxes.label.tolist()
    pairs: Mapping[tuple[str, str], int] = Counter(zip(names, meant, strict=True))
    for (name, means), num in sorted(pairs.items()):
        if 0 < len(name) <= _MAX_NAME:
            met.nums[name] += num
            met.labels.setdefault(name, Counter())[means] += num
            met.certain[name] = met.certain.get(name, False) or is_own or is_known(name)
