"""Small worlds to look at: a ground plane, walls and boxes, seen by a camera at the height of 1 m."""

import numpy as np
import pytest

from fbench.datasets.city.camera.picture import picture
from fbench.datasets.city.instant import BodyStates
from fbench.datasets.city.mesh import Actor, Body, Mesh, Skin, box, merge_meshes
from fbench.datasets.city.rays.caster import EmbreeCaster, Instant
from fbench.datasets.city.rig import CameraSpec, RigSpec
from fbench.replay.conditions.weather import Weather

ASPHALT = Skin("asphalt", (0.12, 0.12, 0.12))
GROUND = box((0, 0, -0.5), (600, 600, 1), ASPHALT)
EGO_BODY = Body("car", (4.0, 1.8, 1.5), (box((0, 0, 0.75), (4, 1.8, 1.5), Skin("paint", (0.5, 0.5, 0.5))),))


def block(color=(0.5, 0.1, 0.1), size=(4.0, 1.8, 1.5), material="paint", label="car") -> Body:
    return Body(label, size, (box((0, 0, size[2] / 2), size, Skin(material, color)),))


class Look:
    """Takes pictures of a static world and of bodies (position, yaw) before the ego vehicle at the origin."""

    def __init__(self, static: list[Mesh], bodies=(), braking=(), lamps=(), parked=False):
        self.actors = (Actor(EGO_BODY), *(Actor(body, parked) for body, _, _ in bodies))
        self.caster = EmbreeCaster(merge_meshes(static), self.actors)
        n = len(self.actors)
        position = np.array([(0.0, 0, 0), *(p for _, p, _ in bodies)], float)
        yaw = np.array([0.0, *(y for _, _, y in bodies)])
        brakes = np.array([False, *braking, *[False] * (n - 1 - len(braking))])
        self.states = BodyStates(
            0.0, position, yaw, np.zeros((n, 3)), np.zeros(n), np.zeros(n), brakes, np.array(lamps, bool)
        )

    def now(self, spec, weather=None, sensor="camera", seed=1, stamp_ns=0, street_lamps_m=None):
        T = RigSpec(cameras={sensor: spec}).rig().body_T_sensor(sensor)
        lamps = np.zeros((0, 3)) if street_lamps_m is None else np.array(street_lamps_m, float)
        return Instant(
            self.caster, self.states, weather or Weather(), lamps, seed, sensor, T, stamp_ns, stamp_ns + 5
        )  # fmt: skip

    def take(self, spec=None, weather=None, **given):
        spec = spec or plain()
        return picture(self.now(spec, weather, **given), spec)


def plain(**changes) -> CameraSpec:
    """A camera at (2, 0, 1) without noise and vignetting, 400 x 300, f = 200 px."""
    return CameraSpec(
        **{"translation_m": (2.0, 0.0, 1.0), "size_wh": (400, 300), "noise": 0.0, "vignetting": 0.0} | changes
    )


@pytest.fixture
def look():
    return Look


@pytest.fixture
def spec():
    return plain


@pytest.fixture
def ground():
    return GROUND


@pytest.fixture
def body():
    return block
