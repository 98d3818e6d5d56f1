"""Tracklets of KITTI's raw drives: 3D boxes of objects over time, an archive of boost::serialization.

XML is untrusted. The files begin with `<!DOCTYPE boost_serialization>`; a DTD that says more than this, and so could
declare entities, is refused, as is deep nesting.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.replay.contracts.errors import LogError
from fbench.replay.contracts.importing import read_bytes
from fbench.replay.data.arrays import Float64, Int64, text_array
from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.classes import label
from fbench.replay.formats.documents import parse_xml
from fbench.replay.formats.text import parse_number, whole
from fbench.replay.geometry.iou import move_boxes

_ROOT = "boost_serialization"
_TRACKLET = (_ROOT, "tracklets", "item")
_POSE = (*_TRACKLET, "poses", "item")
_MAX_DEPTH = 16
_GROUPS = ("item", "tracklets", "poses")
_MAX_CHARS = 1000
_MAX_TEXTS = 100
_MAX_POSES = 1_000_000
_MAX_MAGNITUDE = 1e9
FILE = "tracklet_labels.xml"
STATES = {0: "", 1: "interpolated", 2: "labelled"}
"""`attribute` of boxes by <state>: whether a person placed the box, or it lies between two which one placed."""
_CLASSES = {"Person (sitting)": "Person_sitting"}  # Names that other benchmarks of KITTI write differently
_NUMBERS = ("tx", "ty", "tz", "rx", "ry", "rz", "state", "occlusion", "truncation")  # Of a pose
_UNKNOWN = -1
_MAX_BYTES = 2**26


@dataclass(slots=True)
class Element:
    """An element with texts within."""

    path: Path
    line: int
    tag: str
    texts: dict[str, str] = field(default_factory=dict)  # Texts of the elements within that hold no others
    poses: "list[Element]" = field(default_factory=list)  # Of a tracklet
    num_poses: "Element | None" = None  # Holds `count`

    @property
    def where(self) -> str:
        """For errors."""
        return f"{self.path}: line {self.line}: <{self.tag[:40]}>"

    def text(self, tag: str) -> str:
        """Return the text of an element within. Raises LogError where it is missing."""
        if tag not in self.texts:
            raise LogError(f"{self.where}: no <{tag}>")
        return self.texts[tag]

    def real(self, tag: str) -> float:
        """Return a number. Raises LogError where it is missing, isn't finite, or is beyond all reason."""
        value = parse_number(self.text(tag), self.where, f"<{tag}>")
        if not abs(value) < _MAX_MAGNITUDE:
            raise LogError(f"{self.where}: <{tag}> is '{self.text(tag)[:40]}', expected a finite number")
        return value

    def count(self, tag: str) -> int:
        """Return a whole number that isn't negative. Raises LogError where it is missing, or isn't one."""
        value = whole(self.text(tag), self.where, f"<{tag}>")
        if not 0 <= value < _MAX_MAGNITUDE:
            raise LogError(f"{self.where}: <{tag}> is {value}, expected 0 or more, and not beyond all reason")
        return value


class TrackletsXml:
    """Reads one file, tracklet by tracklet."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._tags: list[str] = []
        self._open: list[Element] = []
        self._text = ""
        self._tracklets: list[Element] = []
        self._num_poses = 0
        self._total: Element | None = None
        self._parser = expat.ParserCreate("utf-8")
        self._parser.StartElementHandler, self._parser.EndElementHandler = self._start, self._end
        self._parser.CharacterDataHandler, self._parser.buffer_text = self._add_text, True
        self._parser.StartDoctypeDeclHandler = self._check_dtd

    def tracklets(self, content: bytes) -> Sequence[Element]:
        """Read the document; there are as many tracklets as it says. Raises LogError where it isn't such a document."""
        parse_xml(self._parser, content, lambda what: LogError(f"{self._path}: {what}"))
        _require_count(self._total or Element(self._path, 1, "tracklets"), len(self._tracklets))
        return self._tracklets

    def _check_dtd(self, name: str, system: str | None, public: str | None, has_subset: bool) -> None:
        if system is not None or public is not None or has_subset:
            self._refuse("XML with a DTD is refused, expected '<!DOCTYPE boost_serialization>' or none")

    def _refuse(self, why: str) -> NoReturn:
        raise LogError(f"{self._path}: line {self._parser.CurrentLineNumber}: {why}")

    def _start(self, tag: str, _: Mapping[str, str]) -> None:
        self._tags.append(tag)
        self._text = ""
        if self._tags[0] != _ROOT:
            self._refuse(f"<{tag[:40]}> instead of <{_ROOT}>, these aren't tracklets")
        if len(self._tags) > _MAX_DEPTH:
            self._refuse(f"nested more than {_MAX_DEPTH} deep")
        element = Element(self._path, self._parser.CurrentLineNumber, tag)  # takes the texts within
        self._open.append(element)
        place = tuple(self._tags) if tag in _GROUPS else ()
        if place == _TRACKLET:
            self._tracklets.append(element)
        elif place == _POSE:
            self._num_poses += 1
            if self._num_poses > _MAX_POSES:
                self._refuse(f"more than {_MAX_POSES} boxes")
            self._tracklets[-1].poses.append(element)
        elif place == _POSE[:-1]:
            self._tracklets[-1].num_poses = element
        elif place == _TRACKLET[:-1]:
            self._total = element

    def _add_text(self, text: str) -> None:
        self._text += text
        if len(self._text) > _MAX_CHARS:
            self._refuse(f"a text of more than {_MAX_CHARS} characters")

    def _end(self, tag: str) -> None:
        self._tags.pop()
        self._open.pop()
        if self._open and tag not in _GROUPS:
            texts = self._open[-1].texts
            texts.setdefault(tag, self._text.strip())
            if len(texts) > _MAX_TEXTS:
                self._refuse(f"more than {_MAX_TEXTS} kinds of elements within one")
        self._text = ""


def _require_count(element: Element, num: int) -> None:
    if (count := element.count("count")) != num:
        raise LogError(f"{element.where}: <count> is {count}, but there are {num}")


@dataclass(frozen=True, eq=False)
class Tracklets:
    """All boxes of a drive, by frame."""

    boxes: Boxes3D  # In body coordinates, those of one frame after those of another, in the order of the file
    frame: Int64  # (N,) of each box, ascending
    num_tracks: int

    def of(self, frame: int) -> Boxes3D:
        """Return the boxes of a frame, none where it has none."""
        first, stop = np.searchsorted(self.frame, [frame, frame + 1])
        return self.boxes[int(first) : int(stop)]


@dataclass(frozen=True, eq=False)
class _Track:
    """One object; M boxes, one a frame."""

    source_label: str
    first_frame: int
    size_lwh_m: tuple[float, float, float]
    poses: Float64  # (M, 9): position of the bottom's middle [m], rx, ry, rz [rad], state, occlusion, truncation


def read_tracklets(path: Path, body_T_velo: Float64, met: Callable[[LogError], None]) -> Tracklets:
    """Read a drive's boxes, whose LiDAR is at `body_T_velo` (4, 4); `track_id` is the tracklet's place in the file,
    from 0 on. What is wrong with single tracklets, which are left out, goes to `met`.

    Position and rotation R = Rz(rz) Ry(ry) Rx(rx) are in the LiDAR's coordinates. Occlusion (0 visible, 1 partly,
    2 fully) and truncation (0 in the image, 1 truncated, 2 outside of it, 99 behind it) keep KITTI's levels, -1
    becomes NaN; see `tracklets.h` of the raw devkit. Raises LogError where the file can't be used at all.
    """
    tracks: dict[int, _Track] = {}
    for index, element in enumerate(TrackletsXml(path).tracklets(read_bytes(path, _MAX_BYTES))):
        try:
            tracks[index] = _track(element)
        except LogError as error:
            met(error)
    boxes, frame = _join_tracks(tracks)
    order = np.argsort(frame, kind="stable")
    return Tracklets(move_boxes(boxes[order], body_T_velo), frame[order], len(tracks))


def _track(element: Element) -> _Track:
    lwh = (element.real("l"), element.real("w"), element.real("h"))
    if min(lwh) <= 0:
        raise LogError(f"{element.where}: the box has no size (h {lwh[2]:g}, w {lwh[1]:g}, l {lwh[0]:g})")
    poses = []
    for pose in element.poses:
        if (state := pose.real("state")) not in STATES:
            raise LogError(f"{pose.where}: <state> is {state:g}, expected one of {', '.join(map(str, STATES))}")
        poses.append([pose.real(name) for name in _NUMBERS])
    _require_count(element.num_poses or Element(element.path, element.line, "poses"), len(poses))
    numbers = np.array(poses, np.float64).reshape(-1, len(_NUMBERS))
    return _Track(element.text("objectType"), element.count("first_frame"), lwh, numbers)


def _join_tracks(tracks: Mapping[int, _Track]) -> tuple[Boxes3D, Int64]:
    """Return the boxes in the LiDAR's coordinates, and their frames."""
    if not tracks:
        return Boxes3D.empty(), np.zeros(0, np.int64)
    rows = [len(track.poses) for track in tracks.values()]
    poses = np.concatenate([track.poses for track in tracks.values()])
    lwh = np.repeat([track.size_lwh_m for track in tracks.values()], rows, axis=0)
    names = [track.source_label for track in tracks.values()]
    up = np.zeros((len(poses), 3))  # From the bottom's middle to the box's, along its own axes
    up[:, 2] = lwh[:, 2] / 2
    turned: Float64 = Rotation.from_euler("ZYX", poses[:, [5, 4, 3]]).apply(up) if len(poses) else up
    occlusion, truncation = (np.where(levels == _UNKNOWN, np.nan, levels) for levels in (poses[:, 7], poses[:, 8]))
    boxes = Boxes3D(
        poses[:, :3] + turned,
        lwh,
        poses[:, 5],
        pitch_rad=poses[:, 4],
        roll_rad=poses[:, 3],
        label=np.repeat(np.array([label(_CLASSES.get(name, name)) for name in names], np.str_), rows),
        source_label=np.repeat(text_array(names), rows),
        track_id=np.repeat(np.array(list(tracks), np.int64), rows),
        occlusion=occlusion,
        truncation=truncation,
        attribute=np.array([STATES[state] for state in poses[:, 6]], np.str_),
    )
    frames = [track.first_frame + np.arange(len(track.poses)) for track in tracks.values()]
    return boxes, np.concatenate(frames)
