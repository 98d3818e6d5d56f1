"""Coordinate systems of an OpenLABEL file, against those of the log."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from fbench.replay.arrays import Float64
from fbench.replay.boxfiles.json_file import mapping, member, text, vector
from fbench.replay.boxfiles.placing import body_T
from fbench.replay.errors import LogError
from fbench.replay.geometry.transforms import inverse, pose_matrix
from fbench.replay.logs.coordinates import CoordinateFrames
from fbench.replay.logs.setup import BoxSource

WORLD = "world"


@dataclass(frozen=True, eq=False)
class _Edge:
    """The pose (4, 4) of a coordinate system in another one."""

    parent: str
    parent_T_child: Float64


class CoordinateSystems:
    """Finds the way from a coordinate system to the body, or to the world.

    A name that the log knows means what it means there. Others are followed through `transforms` of the frame, then
    `pose_wrt_parent`, until the log knows one, or one is of a type `local...`, which is the body (`scene...` and
    `geo...`: the world). What leads nowhere is taken for the coordinate frame that the user names.
    """

    def __init__(self, root: Mapping[str, Any], coordinates: CoordinateFrames, source: BoxSource) -> None:
        where = str(source.path)
        self._coordinates, self._default = coordinates, source.frame
        self._types: dict[str, str] = {}
        self._edges: dict[str, _Edge] = {}
        for name, value in member(root, "coordinate_systems", where).items():
            at = f"{where}: coordinate system '{name[:60]}'"
            system = mapping(value, at)
            self._types[name] = text(system.get("type"), f"{at}: type").lower()
            parent = text(system.get("parent"), f"{at}: parent")
            if parent and system.get("pose_wrt_parent") is not None:
                self._edges[name] = _Edge(parent, _matrix(system["pose_wrt_parent"], at))

    def of_frame(self, properties: Mapping[str, Any], where: str) -> dict[str, _Edge]:
        """Read the transforms of one frame, by the coordinate system that they start from."""
        found: dict[str, _Edge] = {}
        for name, value in member(properties, "transforms", where).items():
            at = f"{where}: transform '{name[:60]}'"
            told = mapping(value, at)
            source, destination = text(told.get("src"), f"{at}: src"), text(told.get("dst"), f"{at}: dst")
            found[source] = _Edge(destination, _matrix(told.get("transform_src_to_dst"), at))
        return found

    def target(self, name: str, moving: Mapping[str, _Edge], where: str) -> tuple[str, Float64]:
        """Return `body` or `world`, and the matrix (4, 4) that moves boxes there.

        Raises:
            LogError: where the coordinate systems form a loop.
            ConfigError: where nothing leads from there to the log.
        """
        matrix, met, at = np.eye(4), {name: None}, name
        while True:
            if self._is_world(at):
                return self._from_world(at, matrix, moving, where)
            if self._is_known(at):
                return "body", body_T(at, self._coordinates, where) @ matrix
            if self._types.get(at, "").startswith("local"):
                return "body", matrix
            edge = moving.get(at, self._edges.get(at))
            if edge is None and self._default and at != self._default:
                edge = _Edge(self._default, np.eye(4))
            if edge is None:
                return "body", body_T(at, self._coordinates, where) @ matrix
            matrix, at = edge.parent_T_child @ matrix, edge.parent
            if at in met:
                raise LogError(f"{where}: coordinate systems form a loop at '{at[:60]}'")
            met[at] = None

    def _is_known(self, name: str) -> bool:
        if name in ("", "body", self._coordinates.body) or name in self._coordinates.rig.mounts:
            return True
        return name in self._coordinates.tree.edges

    def _is_world(self, name: str) -> bool:
        return self._coordinates.is_world(name) or self._types.get(name, "").startswith(("scene", "geo"))

    def _from_world(self, world: str, matrix: Float64, moving: Mapping[str, _Edge], where: str) -> tuple[str, Float64]:
        """The file's own pose of the body at this frame goes before the log's."""
        for name, edge in moving.items():
            if edge.parent == world and not self._is_world(name):
                if self._is_known(name):
                    return "body", body_T(name, self._coordinates, where) @ inverse(edge.parent_T_child) @ matrix
                if self._types.get(name, "").startswith("local"):
                    return "body", inverse(edge.parent_T_child) @ matrix
        return WORLD, matrix


def _matrix(value: object, where: str) -> Float64:
    """A transform as 16 numbers (rows), as quaternion x, y, z, w, or as angles about x, y, z with R = Rz Ry Rx, unless
    `sequence` says otherwise.
    """
    told = mapping(value, where)
    if "matrix4x4" in told:
        matrix = np.array(vector(told["matrix4x4"], (16,), f"{where}: matrix4x4")).reshape(4, 4)
        _require_rigid(matrix, where)
        return matrix
    translation = vector(told.get("translation"), (3,), f"{where}: translation")
    try:
        if "quaternion" in told:
            rotation = Rotation.from_quat(vector(told["quaternion"], (4,), f"{where}: quaternion"))
        else:
            sequence = text(told.get("sequence"), f"{where}: sequence") or "zyx"
            rotation = _euler(vector(told.get("euler_angles"), (3,), f"{where}: euler_angles"), sequence)
        matrix = pose_matrix(translation, rotation.as_quat())
    except ValueError as error:
        raise LogError(f"{where}: no valid rotation ({error})") from error
    _require_rigid(matrix, where)
    return matrix


def _euler(xyz: list[float], sequence: str) -> Rotation:
    """Angles about x, y, z; the sequence names axes from left to right in the product of matrices."""
    axes = sequence.upper()
    if sorted(axes) != ["X", "Y", "Z"]:
        raise ValueError(f"sequence is '{sequence[:20]}', expected zyx or another order of x, y, z")
    return Rotation.from_euler(axes, [xyz["XYZ".index(axis)] for axis in axes])


def _require_rigid(matrix: Float64, where: str) -> None:
    rotation = matrix[:3, :3]
    good = np.isfinite(matrix).all() and np.array_equal(matrix[3], [0, 0, 0, 1])
    if not good or np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3 or np.linalg.det(rotation) < 0:
        raise LogError(f"{where}: is no rigid transform", "CAL001")
