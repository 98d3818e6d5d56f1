"""Compiled motion along lanes: points, poses, and the last resort against overlaps."""

import numpy as np

from fbench.datasets.city.traffic.network import ALONG, AXLE, HERE, NUM_CHOICES, WINDOW
from fbench.replay.data.arrays import Array, Float64
from fbench.replay.geometry.kernels import kernel, kernel_part


@kernel_part
def segment(path: Float64, lane: np.void, s: float) -> int:
    """Row of the point before `s` along a lane."""
    low, high = lane["point_from"], lane["point_to"] - 1
    while high - low > 1:
        mid = (low + high) // 2
        if path[mid, ALONG] <= s:
            low = mid
        else:
            high = mid
    return int(low)


@kernel_part
def nearest_point(path: Float64, lane: np.void, other: np.void, s: float) -> float:
    """Where along `other`, which runs beside `lane`, one is at `s` of it."""
    if s <= 0.0:
        return s
    if s >= lane["length_m"]:
        return float(other["length_m"] + s - lane["length_m"])
    i = segment(path, lane, s)
    j = other["point_from"] + i - lane["point_from"]
    share = (s - path[i, ALONG]) / (path[i + 1, ALONG] - path[i, ALONG])
    return float(path[j, ALONG] + share * (path[j + 1, ALONG] - path[j, ALONG]))


@kernel_part
def neighbor(lane: np.void, side: int) -> int:
    """Lane to the left (1) or to the right (-1) of one; -1 for none."""
    return int(lane["left"] if side > 0 else lane["right"])


@kernel_part
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


@kernel_part
def locate(lanes: Array, way: Array, s: float) -> tuple[int, float]:
    """Which lane of a way `s` along the lane `HERE` is on, before or after it, and where there."""
    k = HERE
    while s < 0 and k > 0:
        k -= 1
        s += lanes[way[k]]["length_m"]
    while s > lanes[way[k]]["length_m"] and k < WINDOW - 1:
        s -= lanes[way[k]]["length_m"]
        k += 1
    return way[k], s


@kernel_part
def sideways(share: float) -> tuple[float, float]:
    """How much of a lane change is left at a share of its way, and its derivative: a quintic without jerk at ends."""
    if share <= 0.0:
        return 1.0, 0.0
    if share >= 1.0:
        return 0.0, 0.0
    x = share
    return 1 - x * x * x * (10 - 15 * x + 6 * x * x), -30 * x * x * (1 - x) * (1 - x)


@kernel_part
def axle(path: Float64, lanes: Array, me: np.void, way: Array, s: float, v: float, work: Float64, out: Float64) -> None:
    """Position, then velocity (6,) of the point `s` along a mover's way, beside it while it changes lanes."""
    span = me["side_for_m"]
    rest, rate = sideways((me["base_m"] + s - me["side_from_m"]) / span)
    side, side_v = me["side_m"] * rest, me["side_m"] * rate / span * v
    lane, local = locate(lanes, way, s)
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


@kernel_part
def travel(v: float, a: float, t: float) -> tuple[float, float]:
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
        gone, v = travel(me["speed_mps"], me["accel_mps2"], since_s)
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


@kernel
def move(lanes: Array, movers: Array, way: Array, step_s: float) -> None:
    """Move all to the end of the step; who leaves a lane has one less to go along."""
    for i in range(len(movers)):
        me = movers[i]
        if me["frozen"]:
            me["speed_mps"] = 0.0
            continue
        gone, v = travel(me["speed_mps"], me["accel_mps2"], step_s)
        me["at_m"] += gone
        me["speed_mps"] = v if v > 1e-3 else 0.0
        while me["at_m"] > lanes[way[i, HERE]]["length_m"]:
            passed = lanes[way[i, HERE]]["length_m"]
            me["at_m"] -= passed
            me["base_m"] += passed
            for k in range(WINDOW - 1):
                way[i, k] = way[i, k + 1]
            way[i, WINDOW - 1] = -1


@kernel
def extend(lanes: Array, nexts: Array, movers: Array, way: Array, choices: Float64) -> None:
    """Choose lanes for the places ahead on all ways that are -1, each after the one before."""
    for i in range(len(movers)):
        for k in range(HERE + 1, WINDOW):
            if way[i, k] < 0:
                drawn = choices[i, movers[i]["num_chosen"] % NUM_CHOICES]
                movers[i]["num_chosen"] += 1
                way[i, k] = choose_next(lanes, nexts, way[i, k - 1], movers[i]["length_m"], drawn)


@kernel_part
def choose_next(lanes: Array, nexts: Array, lane: int, length_m: float, drawn: float) -> int:
    """Choose a successor that bodies of this length may use."""
    first, last = lanes[lane]["next_from"], lanes[lane]["next_to"]
    total = 0.0
    for n in range(first, last):
        if lanes[nexts[n]["lane"]]["longest_m"] >= length_m:
            total += nexts[n]["weight"]
    if total == 0.0:
        return int(nexts[first + int(drawn * (last - first))]["lane"])
    left = drawn * total
    for n in range(first, last):
        if lanes[nexts[n]["lane"]]["longest_m"] >= length_m:
            left -= nexts[n]["weight"]
            lane = int(nexts[n]["lane"])
            if left < 0.0:
                break
    return lane


MARGIN_M = 0.05
_DRIVES_MPS = 0.3  # Who is slower hardly notices that it is stopped


@kernel
def overlaps(p: Float64, q: Float64, size_p: Float64, size_q: Float64, margin: float) -> bool:
    """Whether two footprints (poses and length, width) are nearer than a margin: no axis separates them."""
    dx, dy = q[0] - p[0], q[1] - p[1]
    reach = size_p[0] + size_p[1] + size_q[0] + size_q[1] + 2 * margin
    if 4 * (dx * dx + dy * dy) > reach * reach:
        return False
    cp, sp, cq, sq = np.cos(p[6]), np.sin(p[6]), np.cos(q[6]), np.sin(q[6])
    cos, sin = abs(cp * cq + sp * sq), abs(cp * sq - sp * cq)
    lp, wp, lq, wq = 0.5 * size_p[0] + margin, 0.5 * size_p[1] + margin, 0.5 * size_q[0], 0.5 * size_q[1]
    return bool(
        abs(dx * cp + dy * sp) < lp + lq * cos + wq * sin
        and abs(dy * cp - dx * sp) < wp + lq * sin + wq * cos
        and abs(dx * cq + dy * sq) < lq + lp * cos + wp * sin
        and abs(dy * cq - dx * sq) < wq + lp * sin + wp * cos
    )


@kernel
def stop_before_touching(movers: Array, now: Float64, then: Float64, sizes: Float64, pairs: Array) -> int:
    """Stop at once who would touch another within the step: whoever is behind, else who has the higher number. `now`
    and `then` (N, 9) are poses at the step's beginning and end; rows of `then` become those of `now` for who is
    stopped. `pairs` (M, 2) are those of `near_pairs`. Returns how many of those who were stopped drove.
    """
    num, changed = 0, True
    while changed:
        changed = False
        for m in range(len(pairs)):
            i, j = pairs[m, 0], pairs[m, 1]
            if movers[i]["frozen"] and movers[j]["frozen"]:
                continue
            margin = 0.0 if movers[i]["frozen"] or movers[j]["frozen"] else MARGIN_M
            if not overlaps(then[i], then[j], sizes[i], sizes[j], margin):
                continue
            who = _yields(movers, now, i, j)
            movers[who]["frozen"] = True
            movers[who]["braking"] = True
            for k in range(now.shape[1]):  # an assignment of the row takes a second more to compile
                then[who, k] = now[who, k]
            if movers[who]["speed_mps"] > _DRIVES_MPS:
                num += 1
            changed = True
    return num


@kernel_part
def _yields(movers: Array, now: Float64, i: int, j: int) -> int:
    if movers[i]["frozen"] or movers[j]["frozen"]:
        return j if movers[i]["frozen"] else i
    dx, dy = now[j, 0] - now[i, 0], now[j, 1] - now[i, 1]
    i_sees = dx * np.cos(now[i, 6]) + dy * np.sin(now[i, 6])
    j_sees = -dx * np.cos(now[j, 6]) - dy * np.sin(now[j, 6])
    if (i_sees > 0.0) != (j_sees > 0.0):
        return i if i_sees > 0.0 else j
    return max(i, j)
