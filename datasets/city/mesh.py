"""Triangles with materials and colors, simple shapes, quadrilaterals on walls, and bodies that take part."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fbench.replay.data.arrays import Array, Float32, Float64, freeze_fields
from fbench.replay.geometry.transforms import transform

Three = tuple[float, float, float]
Rgb = Three  # Linear red, green, blue, 0 to 1


@dataclass(frozen=True)
class Material:
    """One kind of surface. Figures are typical of it, chosen by us within what is published."""

    name: str
    lidar: float  # Diffuse reflectivity at 905 nm, 0 to 1, at normal incidence
    radar_db: float  # Radar cross-section a square meter at 77 GHz and normal incidence [dB]
    radar_lobe_deg: float
    """Half width of the lobe in which radar waves come back: small for smooth metal, wide for leaves."""
    gloss: float = 0.0
    """Share of light that is mirrored at normal incidence, 0 to 1; more at grazing incidence (Schlick)."""
    retro: float = 0.0  # Additional reflectivity for light that returns to its source: signs, plates, reflectors
    emits: float = 0.0  # Luminance where it shines, in units of the camera's white by day; 0: shines never
    texture: str = "plain"
    """Name of its pattern in the camera: plain, asphalt, concrete, brick, grass, leaves, bark, cloth, tiles, soil."""


MATERIALS = (
    Material("asphalt", 0.17, -22.0, 60.0, texture="asphalt"),
    Material("marking", 0.55, -22.0, 60.0, retro=0.1, texture="plain"),
    Material("sidewalk", 0.32, -20.0, 60.0, texture="tiles"),
    Material("grass", 0.45, -16.0, 80.0, texture="grass"),
    Material("soil", 0.25, -18.0, 80.0, texture="soil"),
    Material("concrete", 0.35, -8.0, 40.0, texture="concrete"),
    Material("brick", 0.30, -8.0, 40.0, texture="brick"),
    Material("plaster", 0.50, -9.0, 40.0, texture="concrete"),
    Material("window", 0.08, -10.0, 15.0, gloss=0.08),
    Material("lit_window", 0.08, -10.0, 15.0, gloss=0.08, emits=0.0015),
    Material("roof", 0.25, -10.0, 40.0, texture="tiles"),
    Material("paint", 0.45, 3.0, 25.0, gloss=0.05),
    Material("glass", 0.06, -10.0, 15.0, gloss=0.08),
    Material("rubber", 0.06, -12.0, 60.0),
    Material("metal", 0.50, 5.0, 20.0, gloss=0.4),
    Material("plastic", 0.12, -10.0, 50.0, gloss=0.03),
    Material("headlight", 0.25, -2.0, 40.0, gloss=0.1, emits=6.0),
    Material("taillight", 0.30, -6.0, 40.0, gloss=0.06, retro=0.5, emits=0.6),
    Material("plate", 0.50, 0.0, 30.0, retro=0.8),
    Material("skin", 0.60, -5.0, 70.0),
    Material("cloth", 0.45, -7.0, 70.0, texture="cloth"),
    Material("foliage", 0.50, -12.0, 90.0, texture="leaves"),
    Material("bark", 0.35, -12.0, 70.0, texture="bark"),
    Material("sign", 0.40, 2.0, 20.0, retro=0.9),
    Material("pole", 0.35, 0.0, 30.0, gloss=0.05),
    Material("barrier", 0.40, 4.0, 25.0, gloss=0.08),
    Material("street_lamp", 0.30, 0.0, 40.0, emits=4.0),
    Material("signal_lamp", 0.20, -6.0, 40.0, emits=1.5),
    Material("wood", 0.45, -14.0, 60.0, texture="plain"),
)
INDEX: Mapping[str, int] = {material.name: i for i, material in enumerate(MATERIALS)}  # Index into `MATERIALS` by name


@dataclass(frozen=True, eq=False)
class Mesh:
    """V vertices and T triangles, counter-clockwise from outside."""

    vertices_m: Float32  # (V, 3)
    triangles: Array  # (T, 3) int32 indices of vertices
    material: Array  # (T,) uint8 index into `materials.MATERIALS`
    color: Float32  # (T, 3) linear red, green, blue, 0 to 1: the diffuse albedo, or the light's color of what shines
    lamp: Array  # (T,) int32: which switchable lamp a triangle belongs to (see `motion.Lamps`), -1 for none

    def __post_init__(self) -> None:
        freeze_fields(self, vertices_m=("f4", ("V", 3)), triangles=("i4", ("T", 3)), material=("u1", ("T",)),
                      color=("f4", ("T", 3)), lamp=("i4", ("T",)))  # fmt: skip

    def __len__(self) -> int:
        return len(self.triangles)


_NONE = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32), np.zeros(0, np.uint8),
             np.zeros((0, 3), np.float32), np.zeros(0, np.int32))  # fmt: skip


def cross(a: Float64, b: Float64) -> Float64:
    """Return the cross products (N, 3) of vectors (N, 3): those of `np.cross`, in a third of its time for few."""
    result = np.empty(a.shape)
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        result[:, i] = a[:, j] * b[:, k] - a[:, k] * b[:, j]
    return result


def merge_meshes(meshes: Sequence[Mesh]) -> Mesh:
    """Join meshes into one, in their order."""
    every = [_NONE, *meshes]
    starts = np.cumsum([0, *(len(m.vertices_m) for m in every[:-1])])
    triangles = np.concatenate([m.triangles + np.int32(start) for m, start in zip(every, starts, strict=True)])
    names = ("vertices_m", "material", "color", "lamp")
    vertices, *looks = (np.concatenate([getattr(m, name) for m in every]) for name in names)
    return Mesh(vertices, triangles, *looks)


def move_mesh(mesh: Mesh, dst_T_src: Float64) -> Mesh:
    """Move a mesh by a rigid transform (4, 4)."""
    return replace(mesh, vertices_m=transform(dst_T_src, mesh.vertices_m).astype(np.float32))


def shift(mesh: Mesh, by_m: Three) -> Mesh:
    """Move a mesh without turning it."""
    return replace(mesh, vertices_m=mesh.vertices_m + np.asarray(by_m, np.float32))


@dataclass(frozen=True)
class Skin:
    """How a shape looks."""

    material: str
    color: Rgb
    lamp: int = -1


def mesh(vertices_m: Array, triangles: Array, skin: Skin) -> Mesh:
    """Return a mesh of one skin from vertices (V, 3) and triangles (T, 3), counter-clockwise from outside."""
    num, color = len(triangles), np.asarray(skin.color, np.float32)
    material, lamp = np.full(num, INDEX[skin.material], np.uint8), np.full(num, skin.lamp, np.int32)
    vertices, corners = np.asarray(vertices_m, np.float32), np.asarray(triangles, np.int32)
    return Mesh(vertices, corners, material, np.tile(color, (num, 1)), lamp)


def quad(corners_m: Array, skin: Skin) -> Mesh:
    """Return a flat quadrilateral from corners (4, 3), counter-clockwise from outside."""
    return mesh(np.asarray(corners_m), np.array([[0, 1, 2], [0, 2, 3]]), skin)


def box(center_m: Three, size_lwh_m: Three, skin: Skin) -> Mesh:
    """Return a box whose edges are along the axes."""
    x, y, _ = np.asarray(size_lwh_m) / 2
    outline = np.asarray([(-x, -y), (x, -y), (x, y), (-x, y)]) + np.asarray(center_m[:2])
    return prism(outline, center_m[2] - size_lwh_m[2] / 2, center_m[2] + size_lwh_m[2] / 2, skin)


def prism(outline_m: Array, bottom_m: float, top_m: float, skin: Skin) -> Mesh:
    """Extrude a convex outline (P, 2) in x and y, counter-clockwise from above, with both ends closed."""
    flat = np.asarray(outline_m, np.float64)
    sections = [np.column_stack([flat, np.full(len(flat), z)]) for z in (bottom_m, top_m)]
    return loft(sections, skin)


def cylinder(
    start_m: Three, end_m: Three, radius_m: float, num_sides: int, skin: Skin, end_radius_m: float = -1.0
) -> Mesh:
    """Return a closed cylinder, or a cone where the radius at its end is another."""
    a, b = np.asarray(start_m, np.float64), np.asarray(end_m, np.float64)
    axis = b - a
    axis = axis / np.sqrt((axis * axis).sum())
    u = np.cross([0.0, 0, 1] if abs(axis[2]) < 0.9 else [1.0, 0, 0], axis)
    u = u / np.sqrt((u * u).sum())
    angle = np.arange(num_sides) * (2 * np.pi / num_sides)
    ring = np.cos(angle)[:, None] * u + np.sin(angle)[:, None] * np.cross(axis, u)
    return loft([a + radius_m * ring, b + (radius_m if end_radius_m < 0 else end_radius_m) * ring], skin)


def loft(sections_m: Sequence[Float64], skin: Skin, closed: bool = True) -> Mesh:
    """Join convex rings of P points each, (P, 3), one after the other; both ends are closed unless `closed` is false.
    Seen along the way from the first ring to the last, points run clockwise: from its end, counter-clockwise.
    """
    num, last = len(sections_m[0]), len(sections_m) - 1
    i = np.arange(num)
    j = (i + 1) % num
    band = np.concatenate([np.column_stack([i, j, j + num]), np.column_stack([i, j + num, i + num])])
    sides = [band + k * num for k in range(last)]
    fan = np.column_stack([np.zeros(num - 2, int), np.arange(1, num - 1), np.arange(2, num)])
    ends = [fan[:, ::-1], fan + last * num] if closed else []
    return mesh(np.concatenate(sections_m), np.concatenate([*sides, *ends]), skin)


@dataclass(frozen=True, eq=False)
class Body:
    """The shape of one road user, in its own coordinates: x forward, y left, z up from the ground, the origin in the
    middle of its footprint.
    """

    label: str  # One of `LABELS`
    size_lwh_m: tuple[float, float, float]
    """Length, width, height of the box that holds all phases: |x| <= l/2, |y| <= w/2, 0 <= z <= h."""
    phases: tuple[Mesh, ...]  # One mesh, or those of a gait, evenly over one cycle

    def mesh_at(self, phase: float) -> int:
        """Index of the mesh at a phase from 0 to below 1."""
        return int(phase * len(self.phases)) % len(self.phases)


@dataclass(frozen=True, eq=False)
class Actor:
    """One road user in the world; the first is the ego vehicle."""

    body: Body
    parked: bool = False


def scale_color(color: Rgb, factor: float) -> Rgb:
    """Make a color darker or lighter."""
    r, g, b = (min(1.0, c * factor) for c in color)
    return r, g, b
