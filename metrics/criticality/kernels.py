"""Compiled loops of criticality: when two moving rectangles first touch, and parabolas through places."""

import math

import numpy as np

from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.geometry.kernels import kernel, kernel_part

_NARROWINGS = 16  # Of a stretch in which the gap is least, by a third each
_FLAT_M = 1e-6  # Gaps that differ less are equal


@kernel_part
def _place(body: Float64, time_s: float) -> tuple[float, float, float]:
    """Place and heading after a time, of x, y, heading, course, speed, acceleration and turn rate (7,); the closed form
    is that of `Motion.move`.
    """
    x, y, yaw, course, speed, acceleration, rate = body
    t = time_s
    if acceleration < 0 and speed < -acceleration * t:
        t = speed / -acceleration
    turned = rate * t
    if abs(turned) < 1e-2:
        z = turned * turned
        first_x, first_y = 1 - z / 6, turned / 2 - turned * z / 24
        second_x, second_y = 1 / 2 - z / 8, turned / 3 - turned * z / 30
    else:
        s, c = math.sin(turned), math.cos(turned)
        first_x, first_y = s / turned, (1 - c) / turned
        second_x, second_y = (s - first_y) / turned, (first_x - c) / turned
    along = speed * t * first_x + acceleration * t * t * second_x
    aside = speed * t * first_y + acceleration * t * t * second_y
    c, s = math.cos(course), math.sin(course)
    return x + along * c - aside * s, y + along * s + aside * c, yaw + turned


@kernel_part
def _gap(ego: Float64, ahead_m: float, body: Float64, half_ego: Float64, half_body: Float64, time_s: float) -> float:
    """Distance of the rectangles along the axis that separates them most; negative where none does."""
    x, y, yaw = _place(ego, time_s)
    other_x, other_y, other_yaw = _place(body, time_s)
    c, s = abs(math.cos(other_yaw - yaw)), abs(math.sin(other_yaw - yaw))
    ego_c, ego_s, body_c, body_s = math.cos(yaw), math.sin(yaw), math.cos(other_yaw), math.sin(other_yaw)
    dx, dy = other_x - x - ahead_m * ego_c, other_y - y - ahead_m * ego_s
    gap = abs(dx * ego_c + dy * ego_s) - half_ego[0] - half_body[0] * c - half_body[1] * s
    gap = max(gap, abs(dy * ego_c - dx * ego_s) - half_ego[1] - half_body[0] * s - half_body[1] * c)
    gap = max(gap, abs(dx * body_c + dy * body_s) - half_body[0] - half_ego[0] * c - half_ego[1] * s)
    return float(max(gap, abs(dy * body_c - dx * body_s) - half_body[1] - half_ego[0] * s - half_ego[1] * c))


@kernel_part
def _touch(
    ego: Float64, ahead_m: float, body: Float64, half_ego: Float64, half_body: Float64, low_s: float, high_s: float
) -> float:
    """A moment between two at which the rectangles touch, where their gap is least; inf: they don't."""
    low, high = low_s, high_s
    for _ in range(_NARROWINGS):
        third = (high - low) / 3
        first = _gap(ego, ahead_m, body, half_ego, half_body, low + third)
        if first <= 0:
            return low + third
        second = _gap(ego, ahead_m, body, half_ego, half_body, high - third)
        if second <= 0:
            return high - third
        if first < second:
            high = high - third
        else:
            low = low + third
    return math.inf


@kernel
def meet(
    egos: Float64, ahead_m: float, bodies: Float64, half_ego: Float64, half_bodies: Float64, horizon_s: float,
    num_steps: int, halvings: int,
) -> Float64:  # fmt: skip
    """When (N,) each ego (N, 7) and body (N, 7), as `_place` has them, first touch; inf: not within the horizon.

    The middle of an ego's rectangle is `ahead_m` before its place. Within u seconds from t on the rectangles come near
    by at most (v + a t) u + a u^2 / 2, where v is how fast both move and turn at first and a how hard both accelerate,
    so as many steps are skipped as their gap allows. Where the gap is least between steps, a touch is looked for there.
    Rectangles that overlap at once meet at 0 if they go on into each other, and not at all if they don't.
    """
    found = np.full(len(bodies), np.inf)
    step_s = horizon_s / num_steps
    radius_ego = math.hypot(half_ego[0], half_ego[1]) + abs(ahead_m)
    for i in range(len(bodies)):
        ego, body, half = egos[i], bodies[i], half_bodies[i]
        speed = ego[4] + body[4] + abs(ego[6]) * radius_ego + abs(body[6]) * math.hypot(half[0], half[1])
        gain = max(ego[5], 0.0) + max(body[5], 0.0)
        gap = _gap(ego, ahead_m, body, half_ego, half, 0.0)
        if gap <= 0:
            if _gap(ego, ahead_m, body, half_ego, half, step_s) < gap - 1e-9:
                found[i] = 0.0
            continue
        k, before = 0, gap
        while k < num_steps:
            now = speed + gain * k * step_s
            free_s = 2 * gap / max(now + math.sqrt(now * now + 2 * gain * gap), 1e-9)
            last, was = k, gap
            k = min(k + max(int(free_s / step_s), 1), num_steps)
            gap = _gap(ego, ahead_m, body, half_ego, half, k * step_s)
            low, high = (k - 1) * step_s, k * step_s if gap <= 0 else math.inf
            # Not where it stays as it is, as between bodies that go along with each other.
            is_least = max(was - before, was - gap) <= _FLAT_M and min(was - before, was - gap) < -_FLAT_M
            if gap > 0 and is_least and was < step_s * (now + gain * step_s):
                low, end = max(last - 1, 0) * step_s, min(last + 1, k) * step_s
                high = _touch(ego, ahead_m, body, half_ego, half, low, end)
                low = last * step_s if high > last * step_s else low
            before = was
            if high < math.inf:
                for _ in range(halvings):
                    middle = (low + high) / 2
                    if _gap(ego, ahead_m, body, half_ego, half, middle) > 0:
                        low = middle
                    else:
                        high = middle
                found[i] = high
                break
    return found


@kernel
def fit_parabolas(
    xy: Float64, time_s: Float64, part: Int64, middle_s: Float64, half_s: Float64, motion: Float64
) -> None:
    """Fill in velocity and acceleration (N, 4) of places (N, 2) at rising times (N,): those of the parabola nearest to
    the places of the same part (N,) that lie within `half_s` (N,) of `middle_s` (N,); nothing where these are fewer
    than three. Least squares, from the place itself and from the mean time on, so that little is rounded.
    """
    for i in range(len(xy)):
        first, last = i, i
        while first > 0 and part[first - 1] == part[i] and middle_s[i] - time_s[first - 1] <= half_s[i]:
            first -= 1
        while last + 1 < len(xy) and part[last + 1] == part[i] and time_s[last + 1] - middle_s[i] <= half_s[i]:
            last += 1
        num, mean = last - first + 1, 0.0
        for j in range(first, last + 1):
            mean += (time_s[j] - time_s[i]) / num
        second = third = fourth = 0.0
        for j in range(first, last + 1):
            t = time_s[j] - time_s[i] - mean
            second, third, fourth = second + t**2, third + t**3, fourth + t**4
        # Of two different times, rounding aside, no parabola follows.
        free = fourth - second**2 / num - third**2 / second if second > 0 else 0.0
        if free <= 1e-9 * fourth:
            continue
        for axis in range(2):
            sum_0 = sum_1 = sum_2 = 0.0
            for j in range(first, last + 1):
                t, way = time_s[j] - time_s[i] - mean, xy[j, axis] - xy[i, axis]
                sum_0, sum_1, sum_2 = sum_0 + way, sum_1 + way * t, sum_2 + way * t**2
            bend = (sum_2 - second * sum_0 / num - third * sum_1 / second) / free
            motion[i, axis] = (sum_1 - third * bend) / second - 2 * bend * mean
            motion[i, 2 + axis] = 2 * bend
