"""URDF: links and the joints between them.

An `origin` is the pose of the child link in the parent link: `xyz` [m], and `rpy` [rad] about fixed axes, that is
R = Rz(yaw) Ry(pitch) Rx(roll). XML is untrusted: documents with a DTD, and so all entities, are refused.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import NoReturn
from xml.parsers import expat

import numpy as np

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.formats.calibration_values import INVALID, MALFORMED, format_value, numbers, require_tree
from fbench.replay.formats.documents import parse_xml
from fbench.replay.logs.coordinate_frames import Edge
from fbench.replay.logs.rig_patch import RigPatch

_MOVING = ("revolute", "continuous", "prismatic", "floating", "planar")
_MAX_DEPTH = 64
_MAX_JOINTS = 5000
_XACRO = "holds xacro macros; run `xacro FILE > rig.urdf` first, and name that file"


def read_urdf(path: Path, content: bytes) -> RigPatch:
    """Return the pose of each link held by a fixed joint, and which joints move. ConfigError names a wrong joint."""
    from scipy.spatial.transform import Rotation  # takes a while to import

    robot = _Robot(path)
    robot.parse(content)
    edges: dict[str, Edge] = {}
    moving: dict[str, str] = {}
    for joint in robot.joints:
        where = f"{path}: joint '{joint.name}'"
        parent, child = (joint.parts.get(end, {}).get("link", "") for end in ("parent", "child"))
        for end, link in (("parent", parent), ("child", child)):
            if not link:
                raise ConfigError(f"{where}: no <{end} link=...>", MALFORMED)
            if link not in robot.links:
                raise ConfigError(f"{where}: its {end} '{link}' isn't a link of the file", MALFORMED)
        if child in edges:
            raise ConfigError(f"{where}: link '{child}' has a second parent", INVALID)
        origin = joint.parts.get("origin", {})
        texts = [(name, origin.get(name, "0 0 0").split()) for name in ("xyz", "rpy")]
        xyz, (roll, pitch, yaw) = (numbers(f"{where}: origin {name}", text, 3) for name, text in texts)
        rotation = np.asarray(Rotation.from_euler("ZYX", [yaw, pitch, roll]).as_quat(), np.float64)
        edges[child] = Edge(parent, np.array(xyz), rotation)
        if joint.kind in _MOVING:
            moving[child] = f"joint '{joint.name}' ({joint.kind})"
        elif joint.kind != "fixed":
            kinds = ", ".join(("fixed", *_MOVING))
            raise ConfigError(f"{where}: type {format_value(joint.kind)} isn't known; there are: {kinds}", MALFORMED)
    require_tree(str(path), edges)
    return RigPatch({child: edge for child, edge in edges.items() if child not in moving}, moving=moving)


@dataclass
class _Joint:
    name: str
    kind: str
    parts: dict[str, Mapping[str, str]] = field(default_factory=dict)  # Attributes of the elements within, by name


class _Robot:
    """What the parser has met."""

    def __init__(self, path: Path) -> None:
        self.joints: list[_Joint] = []
        self.links: set[str] = set()
        self._path, self._stack = path, list[str]()

    def parse(self, content: bytes) -> None:
        """Read a whole document. Raises ConfigError where it isn't URDF, is nested too deeply or has a DTD."""
        parser = expat.ParserCreate("utf-8")
        parser.StartElementHandler, parser.EndElementHandler = self._start, self._end
        parser.StartDoctypeDeclHandler = self._refuse_dtd
        parse_xml(parser, content, lambda what: ConfigError(f"{self._path}: {what}", MALFORMED))

    def _refuse_dtd(self, *_: object) -> NoReturn:
        raise ConfigError(f"{self._path}: XML with a DOCTYPE is refused; remove it", MALFORMED)

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._stack.append(tag)
        if len(self._stack) > _MAX_DEPTH:
            raise ConfigError(f"{self._path}: nested more than {_MAX_DEPTH} deep", MALFORMED)
        if self._stack[0] != "robot":
            raise ConfigError(f"{self._path}: isn't URDF (<{format_value(tag)[1:-1]}> instead of <robot>)", MALFORMED)
        if tag.startswith("xacro:"):
            raise ConfigError(f"{self._path}: {_XACRO}", MALFORMED)
        within = self._stack[1:-1]
        if not within and tag == "link":
            name = self._plain(attributes.get("name", ""))
            if not name or name in self.links:
                why = f"link '{name}' is there twice" if name else "a link has no name"
                raise ConfigError(f"{self._path}: {why}", MALFORMED)
            self.links.add(name)
        elif not within and tag == "joint":
            if len(self.joints) == _MAX_JOINTS:
                raise ConfigError(f"{self._path}: has more than {_MAX_JOINTS} joints", MALFORMED)
            self.joints.append(_Joint(self._plain(attributes.get("name", "")), attributes.get("type", "")))
        elif within == ["joint"]:
            joint, texts = self.joints[-1], {name: self._plain(value) for name, value in attributes.items()}
            if tag in joint.parts and tag in ("parent", "child", "origin"):
                raise ConfigError(f"{self._path}: joint '{joint.name}' has two elements <{tag}>", MALFORMED)
            joint.parts[tag] = texts

    def _end(self, _: str) -> None:
        self._stack.pop()

    def _plain(self, text: str) -> str:
        if "${" in text or "$(" in text:
            raise ConfigError(f"{self._path}: {_XACRO}", MALFORMED)
        return text
