"""Who turns left gives way to oncoming traffic: on a toy crossing and its mirror image, where the turn is to the right.

The straight lane runs east along y = 0; the turning one comes from the east at y = 3.5, crosses it and leaves to the
south. Who leaves one comes back on the other, so as many ask for each.
"""

import numpy as np

from fbench.datasets.city.traffic.placing import TrafficParams
from fbench.datasets.city.traffic.traffic import Traffic
from fbench.datasets.city.world.city_map import CityMap, Lane, Layout, SignalPlan

SECONDS = 400
APART_M = 3.5


def driven(start: tuple[float, float, float], *parts: tuple[float, float]) -> np.ndarray:
    """Points along straights and arcs (length, angle turned to the left) from x, y, heading on, about 0.8 m apart."""
    x, y, heading = start
    points = [(x, y, 0.0)]
    for length, turn in parts:
        num = round(length / 0.8)
        step, bend = length / num, turn / num
        for _ in range(num):
            chord = step * (np.sinc(bend / 2 / np.pi))
            x, y = x + chord * np.cos(heading + bend / 2), y + chord * np.sin(heading + bend / 2)
            heading += bend
            points.append((x, y, 0.0))
    return np.array(points)


def crossing(mirrored: bool) -> Layout:
    half = np.pi / 2
    a = float(np.arccos((25.0 + APART_M / 2) / 50.0))  # the teardrop's first and last bend, all of 25 m radius
    lines = [
        driven((-20.0, 0.0, 0.0), (40.0, 0.0)),
        driven((20.0, 0.0, 0.0), (25 * a, -a), (25 * (np.pi + 2 * a), np.pi + 2 * a), (25 * a, -a)),
        driven((20.0, APART_M, np.pi), (10.0, 0.0), (10 * half, half), (20.0 + APART_M - 10.0, 0.0)),
        driven((0.0, -20.0, -half), (20 * 3 * half, -3 * half)),
    ]
    flip = np.array([1.0, -1.0 if mirrored else 1.0, 1.0])
    lanes = tuple(Lane(line * flip, 3.5, 8.0, "drive", ((i + 1) % 4,), in_junction=i in (0, 2))
                  for i, line in enumerate(lines))  # fmt: skip
    assert all(np.allclose(lanes[i].points_m[-1], lanes[(i + 1) % 4].points_m[0], atol=1e-9) for i in range(4))
    return Layout(CityMap("toy", lanes, SignalPlan(60.0, np.zeros(0), np.zeros(0)), (), (), np.zeros((0, 3))), (), ())


class Crossed:
    """Some minutes: who stands where."""

    def __init__(self, mirrored: bool) -> None:
        traffic = Traffic(crossing(mirrored), TrafficParams(40.0, mix={"car": 1.0}, speed_spread=0.15), 6)
        motion = traffic.motion(0.0, float(SECONDS))
        states = [motion.at(k / 5) for k in range(SECONDS * 5)]
        at = np.array([state.position_m[:, :2] for state in states])
        self.x, self.y = at[..., 0], at[..., 1] * (-1 if mirrored else 1)
        self.speed = np.array([np.hypot(*state.velocity_mps[:, :2].T) for state in states])
        turning = (np.abs(self.y - APART_M) < 0.5) & (np.abs(self.x - 15) < 5)
        self.num_turned = int((~turning[:-1] & turning[1:]).sum())
        self.num_emergencies = traffic.num_emergencies

    def waiting_s(self) -> tuple[float, float]:
        """How long all stood before the straight lane and before the turning one."""
        stands = self.speed < 0.1
        return float((stands & (self.x < -15)).sum() / 5), float((stands & (self.x > 15)).sum() / 5)


def test_who_turns_left_waits_for_oncoming_ones_who_wait_for_who_turns_right() -> None:
    left, right = Crossed(mirrored=False), Crossed(mirrored=True)
    (straight_s, left_s), (other_straight_s, right_s) = left.waiting_s(), right.waiting_s()
    assert left_s > 2 * straight_s  # though the lanes are the same, mirrored
    assert right_s < other_straight_s
    assert left_s > 1.5 * right_s
    assert left.num_turned > 30
    assert left.num_emergencies == right.num_emergencies == 0
