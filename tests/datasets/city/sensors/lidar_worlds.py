"""Small worlds and what a LiDAR sees there."""

import numpy as np

from fbench.datasets.city.instant import BodyStates
from fbench.datasets.city.mesh import Actor, Body, Mesh, Skin, box, cylinder, merge_meshes, quad
from fbench.datasets.city.rays.caster import EmbreeCaster, Instant
from fbench.datasets.city.rig import LidarSpec, thesis_rig
from fbench.datasets.city.sensors.lidar import Sweep, sweep
from fbench.replay.conditions.weather import Weather

GREY = (0.5, 0.5, 0.5)
SPEC = thesis_rig().lidars["lidar"]
MOUNT = thesis_rig().rig().body_T_sensor("lidar")
SIZE = (4.5, 1.8, 1.5)
CLEAR = Weather()


def lidar(**changes) -> LidarSpec:
    """Return the thesis's LiDAR with other parameters."""
    return LidarSpec.model_validate({**SPEC.model_dump(), **changes})


def ground(material: str = "concrete") -> Mesh:
    """Return 800 x 800 m of flat ground."""
    return quad(np.array([[-400, -400, 0], [400, -400, 0], [400, 400, 0], [-400, 400, 0.0]]), Skin(material, GREY))


def drum(radius_m: float, material: str = "plaster") -> Mesh:
    """Return the inside of a round tower about the sensor, which beams meet nearly at right angles at its height."""
    return cylinder((0, 0, -200), (0, 0, 200), radius_m, 720, Skin(material, GREY))


def car() -> Body:
    """Return a car of two boxes with glass above."""
    return Body(
        "car",
        SIZE,
        (merge_meshes([box((0, 0, 0.5), (4.5, 1.8, 1.0), Skin("paint", GREY)),
                 box((0, 0, 1.25), (2.5, 1.6, 0.5), Skin("glass", GREY))]),),
    )  # fmt: skip


def states(rows) -> BodyStates:
    """Return bodies from rows of x, y, yaw, velocity x and y, yaw rate; the first is the ego vehicle."""
    table = np.zeros((len(rows), 6))
    for i, row in enumerate(rows):
        table[i, : len(row)] = row
    flat = np.zeros(len(rows))
    return BodyStates(
        0.0, np.column_stack([table[:, :2], flat]), table[:, 2].copy(), np.column_stack([table[:, 3:5], flat]),
        table[:, 5].copy(), flat, np.zeros(len(rows), bool), np.zeros(0, bool),
    )  # fmt: skip


def turn(static: Mesh, rows=((0, 0),), spec: LidarSpec = SPEC, weather: Weather = CLEAR, **given) -> Sweep:
    """Return one turn of the LiDAR among cars at `rows`."""
    caster = EmbreeCaster(static, (Actor(car()),) * len(rows))
    keys = {"sensor": "lidar", "seed": 0, "stamp_ns": 50_000_000, **given}
    now = Instant(
        caster, states(rows), weather, np.zeros((0, 3)), keys["seed"], keys["sensor"], MOUNT, keys["stamp_ns"],
        60_000_000,
    )  # fmt: skip
    return sweep(now, spec)


def ranges(result: Sweep) -> np.ndarray:
    """Return measured ranges (N,)."""
    xyz = result.cloud.xyz.astype(np.float64)
    return np.sqrt((xyz * xyz).sum(axis=1))


def bytes_of(result: Sweep) -> bytes:
    """Return all that a sweep says."""
    cloud = result.cloud
    arrays = (cloud.xyz, cloud.intensity, cloud.ring, cloud.offset_ns, result.body, result.range_m)
    return b"".join(array.tobytes() for array in arrays)
