"""How fast surfaces move along rays, as seen by a moving sensor."""

import numpy as np

from fbench.datasets.city.motion import EGO, BodyStates
from fbench.replay.arrays import Array, Float64


def radial_speeds(states: BodyStates, body: Array, point_m: Float64, direction: Float64, sensor_m: Float64) -> Float64:
    """Return the speeds (N,) of points along rays [m/s], relative to the sensor, positive when receding.

    Bodies are rigid: their velocity and turn rate move every point of theirs; wheels don't spin, limbs don't swing.

    Args:
        states: All bodies; the first carries the sensor.
        body: (N,) which body each point is on; below 0: on one that stands.
        point_m: (N, 3) in the world.
        direction: (N, 3) unit vectors in the world, away from the sensor.
        sensor_m: (3,) where the sensor is in the world.
    """
    sensor = _velocity(states, np.array([EGO]), sensor_m[None])
    moving = np.flatnonzero(body >= 0)
    relative = np.tile(-sensor, (len(body), 1))
    relative[moving] += _velocity(states, body[moving], point_m[moving])
    speed: Float64 = (relative * direction).sum(axis=1)
    return speed


def _velocity(states: BodyStates, body: Array, point_m: Float64) -> Float64:
    """Velocities (N, 3) over ground of points on bodies."""
    arm = point_m - states.position_m[body]
    rate = states.yaw_rate_radps[body]
    turn = np.stack([-rate * arm[:, 1], rate * arm[:, 0], np.zeros(len(arm))], axis=1)
    return np.asarray(states.velocity_mps[body] + turn, np.float64)
