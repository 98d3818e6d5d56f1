"""Parsing `tracklet_labels.xml` of KITTI's raw drives, an archive of boost::serialization.

XML is untrusted. The files begin with `<!DOCTYPE boost_serialization>`; a DTD that says more than this, and so could
declare entities, is refused, as is deep nesting.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

from fbench.replay.boxfiles.parse import number, whole
from fbench.replay.errors import LogError

_ROOT = "boost_serialization"
_TRACKLET = (_ROOT, "tracklets", "item")
_POSE = (*_TRACKLET, "poses", "item")
_MAX_DEPTH = 16
_GROUPS = ("item", "tracklets", "poses")
_MAX_CHARS = 1000
_MAX_TEXTS = 100
_MAX_POSES = 1_000_000
_MAX_MAGNITUDE = 1e9


@dataclass(slots=True)
class Element:
    """An element with texts within."""

    path: Path
    line: int
    tag: str
    texts: dict[str, str] = field(default_factory=dict)
    """Texts of the elements within that hold no others."""

    @property
    def where(self) -> str:
        """For errors."""
        return f"{self.path}: line {self.line}: <{self.tag[:40]}>"

    def text(self, tag: str) -> str:
        """Return the text of an element within.

        Raises:
            LogError: where it is missing.
        """
        if tag not in self.texts:
            raise LogError(f"{self.where}: no <{tag}>")
        return self.texts[tag]

    def real(self, tag: str) -> float:
        """Return a number.

        Raises:
            LogError: where it is missing, isn't finite, or is beyond all reason.
        """
        value = number(self.text(tag), self.where, f"<{tag}>")
        if not abs(value) < _MAX_MAGNITUDE:
            raise LogError(f"{self.where}: <{tag}> is '{self.text(tag)[:40]}', expected a finite number")
        return value

    def count(self, tag: str) -> int:
        """Return a whole number that isn't negative.

        Raises:
            LogError: where it is missing, or isn't one.
        """
        value = whole(self.text(tag), self.where, f"<{tag}>")
        if not 0 <= value < _MAX_MAGNITUDE:
            raise LogError(f"{self.where}: <{tag}> is {value}, expected 0 or more, and not beyond all reason")
        return value


@dataclass(slots=True)
class TrackletElement(Element):
    """One tracklet, as it is written."""

    poses: list[Element] = field(default_factory=list)
    num_poses: Element | None = None
    """Holds `count`."""


class TrackletsXml:
    """Reads one file, tracklet by tracklet."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._tags: list[str] = []
        self._open: list[Element] = []
        self._text = ""
        self._tracklets: list[TrackletElement] = []
        self._num_poses = 0
        self._total: Element | None = None
        self._parser = expat.ParserCreate("utf-8")

    def tracklets(self, content: bytes) -> Iterator[TrackletElement]:
        """Read the document; there are as many tracklets as it says.

        Raises:
            LogError: where it isn't such a document.
        """
        parser = self._parser
        parser.StartElementHandler, parser.EndElementHandler = self._start, self._end
        parser.CharacterDataHandler, parser.buffer_text = self._add_text, True
        parser.StartDoctypeDeclHandler = self._check_dtd
        try:
            parser.Parse(content.removeprefix(b"\xef\xbb\xbf").lstrip(), True)
        except expat.ExpatError as error:
            what = expat.ErrorString(error.code)
            raise LogError(f"{self._path}: isn't XML ({what} in line {error.lineno})") from error
        total = self._total or Element(self._path, 1, "tracklets")
        if (count := total.count("count")) != len(self._tracklets):
            raise LogError(f"{total.where}: <count> is {count}, but there are {len(self._tracklets)}")
        yield from self._tracklets

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
        self._open.append(self._element(tag))

    def _element(self, tag: str) -> Element:
        """Return what takes the texts within; most elements hold none."""
        element = Element(self._path, self._parser.CurrentLineNumber, tag)
        if tag not in _GROUPS:
            return element
        place = tuple(self._tags)
        if place == _TRACKLET:
            self._tracklets.append(TrackletElement(self._path, element.line, tag))
            return self._tracklets[-1]
        if place == _POSE:
            self._num_poses += 1
            if self._num_poses > _MAX_POSES:
                self._refuse(f"more than {_MAX_POSES} boxes")
            self._tracklets[-1].poses.append(element)
        elif place == _POSE[:-1]:
            self._tracklets[-1].num_poses = element
        elif place == _TRACKLET[:-1]:
            self._total = element
        return element

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
