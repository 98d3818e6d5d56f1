"""Guesses of truth and results: topics and files, and what their classes mean."""

import os
from collections import Counter, defaultdict
from collections.abc import Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path

from fbench.replay.contracts.errors import DataError, DecodeError
from fbench.replay.data.classes import is_known, label
from fbench.replay.data.messages import Message
from fbench.replay.data.scores import format_count
from fbench.replay.logs.codecs.codec import Origin, TruthPart
from fbench.replay.logs.container import Entry
from fbench.replay.logs.roles import Role
from fbench.replay.setup.inspection import Inspection, Line, Table, sample_messages

_MAX_FILES = 2000
_MAX_SHOWN = 5
_BOX_WORDS = ("label", "truth", "annotation", "openlabel", "gt", "tracks", "boxes")
_RIG_WORDS = ("calib", "camchain", "camera_info", "extrinsic", "intrinsic", "rig", "urdf")


def find_neighbors(config: Path, log: Path) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of files and folders in a configuration's folder that may hold a log's boxes, and of files with its rig."""
    try:
        with os.scandir(config.resolve().parent) as found:
            items = sorted((item.name, item.is_dir()) for item in islice(found, _MAX_FILES))
    except OSError:
        return (), ()
    items = [item for item in items if not item[0].startswith(".") and item[0] not in (log.name, config.name)]
    boxes, rigs = [], []
    for name, is_dir in items:
        stem, suffix = os.path.splitext(name.lower())
        words = {word.rstrip("s") for word in stem.replace("-", "_").replace(".", "_").split("_")}
        is_called = "label" in stem or any(known.rstrip("s") in words for known in _BOX_WORDS)
        if is_called and (is_dir or suffix in (".csv", ".parquet", ".json", ".txt")):
            boxes.append(name)
        has_rig_word = suffix in (".yaml", ".yml", ".toml") and any(word in stem for word in _RIG_WORDS)
        if not is_dir and (suffix == ".urdf" or has_rig_word):
            rigs.append(name)
    return tuple(boxes[:_MAX_SHOWN]), tuple(rigs[:_MAX_SHOWN])


_MAX_ENTRIES = 500  # Messages with boxes of a window that are read for their classes
_MAX_CLASSES = 100
_MAX_NAME = 200


def truth_table(log: Inspection, boxes_beside: Sequence[str]) -> Table:
    """Write `[truth]`."""
    topics = _topics(log, "truth")
    why = "beside the log; is it ground truth?"
    files = tuple(Line("file", name, why, is_active=False) for name in boxes_beside)
    if topics:
        own = all(role.is_own for role in log.roles.values() if role.kind == "truth")
        return Table(("truth",), (Line("topics", topics, "the log says so" if own else "by its name"), *files))
    if files:
        return Table(("truth",), files, notes=("No topic of the log is called truth, gt, label or annotation.",))
    why = "boxes beside the log: Parquet, CSV, KITTI, OpenLABEL ..."
    example = Line("file", "labels.parquet", why, is_active=False)
    return Table(("truth",), (example,), notes=("The log holds no ground truth, so runs have no accuracy.",))


def results_table(log: Inspection) -> Table | None:
    """Write `[results]` where the log has boxes that aren't called truth."""
    topics = _topics(log, "detections")
    if not topics:
        return None
    why = "boxes not named as truth, so probably results: score them with -p recorded:TOPIC"
    return Table(("results",), (Line("topics", topics, why, is_guess=True),))


def _topics(log: Inspection, kind: str) -> tuple[str, ...]:
    return tuple(sorted({role.topic for role in log.roles.values() if role.kind == kind}))


def classes_table(log: Inspection) -> Table | None:
    """Write `[classes]` from the names that were met in the sample; `None` where there are none."""
    labels = defaultdict[str, Counter[str]](Counter)
    certain: set[str] = set()  # Names of which somebody has said what they mean
    channels = frozenset(id_ for id_, role in log.roles.items() if role.kind in ("truth", "detections"))
    for _, entry in sample_messages(log.container, channels, log.times, _MAX_ENTRIES):
        role = log.roles[entry.channel]
        for (name, meant), num in _count_classes(role, entry).items():
            if 0 < len(name) <= _MAX_NAME:
                labels[name][meant] += num
                if role.is_own or is_known(name):
                    certain.add(name)
    if not labels:
        return None
    names = sorted(labels, key=lambda name: (-labels[name].total(), name))
    notes = ["By the names that the log gives, counted in a sample; 'ignore' leaves a class out of scores."]
    notes += [f"{len(names) - _MAX_CLASSES} rarer names aren't listed."] if len(names) > _MAX_CLASSES else []
    lines = []
    for name in names[:_MAX_CLASSES]:
        meant = min(labels[name].items(), key=lambda item: (-item[1], item[0]))[0]
        num = labels[name].total()
        count = format_count(num, "box", "boxes")
        why = count if name in certain else f"{count}, not a known name"
        lines.append(Line(name, meant, why, name not in certain))
    return Table(("classes",), tuple(lines), notes=tuple(notes))


def _count_classes(role: Role, entry: Entry) -> Counter[tuple[str, str]]:
    """Boxes of a message by the names that its source gives them and the labels that these stand for."""
    part: Message | TruthPart | None = None
    with suppress(DecodeError, DataError):
        if not isinstance(entry.data, memoryview):
            part = entry.data.read()
        elif role.codec is not None:
            part = role.codec.truth(entry.data, Origin(role.sensor, entry.log_ns, entry.publish_ns))
    result: Counter[tuple[str, str]] = Counter()
    for boxes in (part.truth.boxes3d, part.truth.boxes2d) if isinstance(part, TruthPart) else ():
        if boxes is not None and boxes.source_label is not None:
            names: list[str] = boxes.source_label.tolist()
            meant = [label(name) for name in names] if boxes.label is None else boxes.label.tolist()
            result.update(zip(names, meant, strict=True))
    return result
