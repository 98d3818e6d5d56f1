"""Small worlds and what a radar sees there."""

import numpy as np

from fbench.datasets.city.instant import BodyStates
from fbench.datasets.city.mesh import Actor, Body, Mesh, Skin, box, cylinder, merge_meshes, quad
from fbench.datasets.city.rays.caster import EmbreeCaster, Instant
from fbench.datasets.city.rig import RadarSpec, thesis_rig
from fbench.datasets.city.sensors.radar import Scan, scan
from fbench.replay.conditions.weather import Weather

GREY = (0.5, 0.5, 0.5)
SPEC = thesis_rig().radars["radar"]
MOUNT = thesis_rig().rig().body_T_sensor("radar")
FINE = {
    "range_resolution_m": 0.0, "azimuth_resolution_deg": 0.0, "altitude_resolution_deg": 0.0,
    "speed_resolution_mps": 0.0,
}  # fmt: skip
EXACT = {
    **FINE, "range_noise_m": 0.0, "azimuth_noise_deg": 0.0, "altitude_noise_deg": 0.0, "speed_noise_mps": 0.0,
    "rcs_noise_db": 0.0,
}  # fmt: skip


def radar(**changes) -> RadarSpec:
    """Return the thesis's radar with other parameters."""
    return RadarSpec.model_validate({**SPEC.model_dump(), **changes})


def ground(material: str = "asphalt") -> Mesh:
    """Return 600 x 600 m of flat ground."""
    return quad(np.array([[-300, -300, 0], [300, -300, 0], [300, 300, 0], [-300, 300, 0.0]]), Skin(material, GREY))


def hall(size_m: float, material: str = "metal") -> Mesh:
    """Return the inside of a cube around the origin: every ray hits it."""
    return box((0, 0, 0), (size_m,) * 3, Skin(material, GREY))


def car() -> Body:
    """Return a car of boxes and cylinders."""
    parts = [
        box((0, 0, 0.65), (4.5, 1.8, 0.7), Skin("paint", GREY)),
        box((-0.3, 0, 1.25), (2.2, 1.6, 0.5), Skin("glass", GREY)),
    ]
    wheels = [
        cylinder((x, y - 0.1, 0.32), (x, y + 0.1, 0.32), 0.32, 16, Skin("rubber", GREY))
        for x in (-1.4, 1.4)
        for y in (-0.8, 0.8)
    ]
    return Body("car", (4.5, 1.8, 1.5), (merge_meshes([*parts, *wheels]),))


def pedestrian() -> Body:
    """Return a pedestrian of two cylinders."""
    trunk = cylinder((0, 0, 0), (0, 0, 1.5), 0.2, 16, Skin("cloth", GREY))
    head = cylinder((0, 0, 1.5), (0, 0, 1.75), 0.1, 12, Skin("skin", GREY))
    return Body("pedestrian", (0.4, 0.4, 1.75), (merge_meshes([trunk, head]),))


def truck() -> Body:
    """Return a truck of two boxes."""
    load, cab = (
        box((-1, 0, 2.2), (8, 2.5, 3), Skin("paint", GREY)),
        box((4, 0, 1.7), (2, 2.5, 2.6), Skin("paint", GREY)),
    )
    return Body("truck", (10, 2.5, 3.7), (merge_meshes([load, cab]),))


def world(static: Mesh, *bodies: Body) -> EmbreeCaster:
    """Return a world of which the ego vehicle is a car."""
    return EmbreeCaster(static, tuple(Actor(body) for body in (car(), *bodies)))


def states(*rows) -> BodyStates:
    """Return bodies from rows x, y, yaw and optionally vx, vy, yaw rate."""
    full = np.array([[*row, *[0.0] * (6 - len(row))] for row in rows], np.float64)
    zero = np.zeros(len(full))
    return BodyStates(
        0.0, np.column_stack([full[:, :2], zero]), full[:, 2], np.column_stack([full[:, 3:5], zero]), full[:, 5], zero,
        zero.astype(bool), np.zeros(0, bool),
    )  # fmt: skip


def look(caster, at, spec=SPEC, weather=None, seed=1, stamp_ns=0, mount=MOUNT) -> Scan:
    """Return one scan."""
    now = Instant(
        caster, at, weather or Weather(), np.zeros((0, 3)), seed, "radar", mount, stamp_ns, stamp_ns + 5
    )  # fmt: skip
    return scan(now, spec)
