"""Compiled: points on lanes and poses of bodies whose axles follow them."""

import numpy as np

from fbench.datasets.city.traffic.network import ALONG
from fbench.datasets.city.traffic.state import AXLE, HERE, WINDOW
from fbench.replay.arrays import Array, Float64
from fbench.replay.kernels import kernel


@kernel
def segment(path: Float64, lane: np.void, s: float) -> int:
    """Row of the point before `s` along a lane."""
    low, high = lane["point_from"], lane["point_to"] - 1
    while high - low > 1:
        mid = (low + high) // 2
        if path[mid, ALONG] <= s:
            low = mid
        else:
            high = mid
    found: int = low
    return found


@kernel
def curve(path: Float64, lane: np.void, s: float, out: Float64) -> None:
    """Cubic Hermite curve through a lane's points: x, y, z, their derivatives by s, and the second ones of x and y."""
    i = segment(path, lane, s)
    h = path[i + 1, ALONG] - path[i, ALONG]
    u = (s - path[i, ALONG]) / h
    for k in range(2):
        p, q = path[i, k], path[i + 1, k]
        m, n = path[i, 3 + k] * h, path[i + 1, 3 + k] * h
        c, d = 3 * (q - p) - 2 * m - n, 2 * (p - q) + m + n
        out[k] = p + u * (m + u * (c + u * d))
        out[3 + k] = (m + u * (2 * c + 3 * u * d)) / h
        out[6 + k] = (2 * c + 6 * u * d) / (h * h)
    out[2] = path[i, 2] + u * (path[i + 1, 2] - path[i, 2])
    out[5] = (path[i + 1, 2] - path[i, 2]) / h


@kernel
def located(lanes: Array, way: Array, s: float) -> tuple[int, float]:
    """Which lane of a way `s` along the lane `HERE` is on, before or after it, and where there."""
    k = HERE
    while s < 0 and k > 0:
        k -= 1
        s += lanes[way[k]]["length_m"]
    while s > lanes[way[k]]["length_m"] and k < WINDOW - 1:
        s -= lanes[way[k]]["length_m"]
        k += 1
    return way[k], s


@kernel
def sideways(share: float) -> tuple[float, float]:
    """How much of a lane change is left at a share of its way, and its derivative: a quintic without jerk at ends."""
    if share <= 0.0:
        return 1.0, 0.0
    if share >= 1.0:
        return 0.0, 0.0
    x = share
    return 1 - x * x * x * (10 - 15 * x + 6 * x * x), -30 * x * x * (1 - x) * (1 - x)


@kernel
def axle(path: Float64, lanes: Array, me: np.void, way: Array, s: float, v: float, work: Float64, out: Float64) -> None:
    """Position, then velocity (6,) of the point `s` along a mover's way, beside it while it changes lanes."""
    span = me["side_for_m"]
    rest, rate = sideways((me["base_m"] + s - me["side_from_m"]) / span)
    side, side_v = me["side_m"] * rest, me["side_m"] * rate / span * v
    lane, local = located(lanes, way, s)
    curve(path, lanes[lane], local, work)
    tx, ty, ax, ay = work[3], work[4], work[6], work[7]
    norm = np.sqrt(tx * tx + ty * ty)
    nx, ny = -ty / norm, tx / norm
    turn = (tx * ay - ty * ax) / (norm * norm)
    out[0] = work[0] + side * nx
    out[1] = work[1] + side * ny
    out[2] = work[2]
    out[3] = (tx - side * turn * tx / norm) * v + side_v * nx
    out[4] = (ty - side * turn * ty / norm) * v + side_v * ny
    out[5] = work[5] * v


@kernel
def travelled(v: float, a: float, t: float) -> tuple[float, float]:
    """Distance and speed after `t` at constant acceleration, never backwards."""
    if a < 0.0 and v + a * t <= 0.0:
        return -0.5 * v * v / a, 0.0
    return v * t + 0.5 * a * t * t, v + a * t


@kernel
def poses(path: Float64, lanes: Array, movers: Array, way: Array, since_s: float) -> Float64:
    """Poses (N, 9), `since_s` after the step's beginning: x, y, z, vx, vy, vz, yaw, yaw rate, distance gone."""
    out = np.empty((len(movers), 9))
    work, front, rear = np.empty(9), np.empty(6), np.empty(6)
    for i in range(len(movers)):
        me = movers[i]
        gone, v = travelled(me["speed_mps"], me["accel_mps2"], since_s)
        if me["frozen"]:
            gone, v = 0.0, 0.0
        s, half = me["at_m"] + gone, AXLE * me["length_m"]
        axle(path, lanes, me, way[i], s + half, v, work, front)
        axle(path, lanes, me, way[i], s - half, v, work, rear)
        for k in range(6):
            out[i, k] = 0.5 * (front[k] + rear[k])
        dx, dy = front[0] - rear[0], front[1] - rear[1]
        out[i, 6], out[i, 8] = np.arctan2(dy, dx), gone
        out[i, 7] = (dx * (front[4] - rear[4]) - dy * (front[3] - rear[3])) / (dx * dx + dy * dy)
    return out
