"""Time to collision and efforts of encounters that can be worked out by hand."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fbench.metrics.criticality.conflict import Conflicts, find_conflicts
from fbench.metrics.criticality.motion import Motion
from fbench.replay.contracts.errors import LogError
from fbench.replay.data.metadata import Outline, outline_of

EGO = Outline(front_m=2.0, rear_m=2.0, side_m=1.0)
CAR = (4.0, 2.0)
INF = float("inf")


def body(x: float = 0, y: float = 0, v: float = 0, a: float = 0, w: float = 0, course: float = 0.0) -> Motion:
    """One body that looks where it goes."""
    one = [np.array([float(value)]) for value in (course, course, v, a, w)]
    return Motion(np.array([complex(x, y)]), *one)


def meet(ego: Motion, other: Motion, size: tuple[float, float] = CAR) -> Conflicts:
    return find_conflicts(ego, EGO, other, np.array([size]))


def numbers(found: Conflicts) -> tuple[float, float, float]:
    return float(found.ttc_s[0]), float(found.deceleration_mps2[0]), float(found.lateral_mps2[0])


CASES: dict[str, tuple[Motion, Motion, tuple[float, float, float]]] = {
    # 24 m between centers leave 20 m at 10 m/s: 2 s, 10^2 / (2 * 20) = 2.5, 2 m aside: 2 * 2 / 2^2 = 1
    "a standing car ahead": (body(v=10), body(24), (2, 2.5, 1)),
    "a slower car ahead": (body(v=15), body(24, v=5), (2, 2.5, 1)),
    # Each goes 20 m; braking must end before the place where they would meet: 10^2 / (2 * 20)
    "an oncoming car": (body(v=10), body(44, v=10, course=np.pi), (2, 2.5, 1)),
    # 1 m to the left: 1 m less on the right, 2 * 1 / 2^2
    "half in the way": (body(v=10), body(24, y=1), (2, 2.5, 0.5)),
    "in the next lane": (body(v=10), body(24, y=2.5), (INF, 0, 0)),
    "faster ahead": (body(v=10), body(24, v=12), (INF, 0, 0)),
    "beyond the horizon": (body(v=10), body(55), (INF, 0, 0)),
    # The car ahead brakes with 5 from 10 m/s and stands after 10 m and 2 s; the ego has 14 m to that place: 1.4 s + ...
    # ego at 10t, car at 4 + 10t - 2.5t^2 (gap 4): meet at t^2 = 1.6; ego must stop in 4 + 10: 100 / 28
    "a braking car ahead": (body(v=10), body(8, v=10, a=-5), (1.6**0.5, 100 / 28, 2 * 2 / 1.6)),
    # Gap 20, closing 10, the leader brakes with 1 from 20: 100 / 40 + 1, both still move then; 10 t + t^2 / 2 = 20
    "a slower car that brakes": (
        body(v=30), body(24, v=20, a=-1), (140**0.5 - 10, 3.5, 4 / (140**0.5 - 10) ** 2),
    ),
    # Its rear needs 16 m: its front (2 m ahead) meets the ego's right side when it has come from -11 to -3
    "a crossing car at a standing ego": (body(), body(0, y=-11, v=4, course=np.pi / 2), (2, 0, 0)),
    "from behind": (body(v=10), body(-24, v=20), (2, 0, 1)),
    "a braking ego that stops in time": (body(v=10, a=-2.5), body(30), (INF, 0, 0)),
    # 10 t - t^2 / 2 = 20
    "a braking ego": (body(v=10, a=-1), body(24), (10 - 60**0.5, 2.5, 4 / (10 - 60**0.5) ** 2)),
    "an ego that speeds up": (body(v=5, a=2), body(28), (-2.5 + 30.25**0.5, 25 / 48, 4 / (-2.5 + 30.25**0.5) ** 2)),
    # Corners meet for 0.09 s: ahead from 26.9 m (29.9 - 2 - 1), aside from 31.6 m (34.6 - 1 - 2) at 15 m/s each
    "a corner hit between two steps": (
        body(v=15), body(29.9, y=34.6, v=15, course=-np.pi / 2), (31.6 / 15, 15**2 / (2 * 31.6), 2 * 0.0 / 15),
    ),
    "overlapping and standing": (body(), body(3), (INF, 0, 0)),
    "overlapping and moving apart": (body(v=5), body(3, v=6), (INF, 0, 0)),
}  # fmt: skip


@pytest.mark.parametrize("name", CASES)
def test_an_encounter(name: str) -> None:
    ego, other, expected = CASES[name]
    assert numbers(meet(ego, other)) == pytest.approx(expected, abs=1e-6)


def test_a_turning_ego_follows_its_arc() -> None:
    """A quarter turn of radius 20 at 10 m/s ends at (20, 20), heading along y; a wide wall 2 m beyond its front is met
    at the end, though nothing is straight ahead.
    """
    quarter_s = np.pi / 2 / 0.5
    found = meet(body(v=10, w=0.5), body(20, 20 + 2 + 1), (20.0, 2.0))
    assert found.ttc_s[0] < quarter_s + 1e-6
    assert meet(body(v=10), body(20, 23), (20.0, 2.0)).ttc_s[0] == INF
    place, yaw = body(v=10, w=0.5).move(np.array([[quarter_s]]))
    assert place[0, 0] == pytest.approx(20 + 20j)
    assert yaw[0, 0] == pytest.approx(np.pi / 2)


def test_motion_is_the_integral_of_speed_and_heading() -> None:
    """Against small steps, also where turning is so slow that a series stands for the closed form."""
    for w in (0.0, 1e-4, 2e-3, 3e-3, 0.4, -1.2):
        one = body(1, 2, v=8, a=-2, w=w, course=0.7)
        t = np.linspace(0, 5, 200_001)
        speed, heading = np.maximum(8 - 2 * t, 0), 0.7 + w * np.minimum(t, 4)
        velocity = speed * np.exp(1j * heading)
        path = 1 + 2j + np.sum((velocity[1:] + velocity[:-1]) / 2) * (t[1] - t[0])
        assert one.move(np.array([[5.0]]))[0][0, 0] == pytest.approx(path, abs=1e-6)
        assert one.way_m(np.array([[5.0]]))[0, 0] == pytest.approx(16)


def test_efforts_are_limited_and_critical_by_time_or_by_braking() -> None:
    near = meet(body(v=20), body(4.5))
    assert numbers(near)[1:] == (12, 12)
    bodies = [near, meet(body(v=10), body(24)), meet(body(v=30), body(94)), meet(body(v=40), body(154))]
    assert [bool(found.critical[0]) for found in bodies] == [True, True, True, True]  # 0.03 s, 2 s, 3 s, 5.3 m/s^2
    slow = meet(body(v=2), body(11))
    assert numbers(slow)[0] == pytest.approx(3.5)
    assert not slow.critical[0]
    assert float(slow.weight[0]) == pytest.approx(1 - 3.5 / 5)
    assert float(meet(body(v=10), body(24)).weight[0]) == pytest.approx(0.6)
    assert float(meet(body(v=40), body(154)).weight[0]) == pytest.approx(40**2 / 300 / 8)


def test_unknown_motion_gives_nothing() -> None:
    found = meet(body(v=10), body(24, v=np.nan))
    assert np.isnan(numbers(found)).all()
    assert not found.known[0]
    assert not found.critical[0]


FAR, ANGLE, SPEED = st.floats(-40, 40), st.floats(-3.1, 3.1), st.floats(0, 30)
BODIES = st.builds(body, FAR, FAR, SPEED, st.floats(-6, 4), st.floats(-0.8, 0.8), ANGLE)


def moved(motion: Motion, shift: complex, angle: float) -> Motion:
    return Motion(
        motion.place * np.exp(1j * angle) + shift, motion.yaw_rad + angle, motion.course_rad + angle,
        motion.speed_mps, motion.acceleration_mps2, motion.turn_rate_radps,
    )  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(BODIES, BODIES, FAR, FAR, ANGLE)
def test_a_rigid_motion_changes_nothing(ego: Motion, other: Motion, x: float, y: float, angle: float) -> None:
    before = meet(ego, other)
    after = meet(moved(ego, complex(x, y), angle), moved(other, complex(x, y), angle))
    if np.isfinite(before.ttc_s).all() and np.isfinite(after.ttc_s).all():  # Touching exactly can round either way
        assert after.ttc_s == pytest.approx(before.ttc_s, abs=1e-6)


@settings(max_examples=60, deadline=None)
@given(BODIES, BODIES)
def test_contact_is_where_outlines_touch(ego: Motion, other: Motion) -> None:
    """An oracle of its own: corners and edges of both rectangles, sampled."""
    ttc = float(meet(ego, other).ttc_s[0])
    if not np.isfinite(ttc) or ttc == 0:
        return
    assert distance(ego, other, ttc) < 0.02
    assert distance(ego, other, max(ttc - 0.2, 0.0)) > 0


def distance(ego: Motion, other: Motion, time_s: float) -> float:
    outlines: list[Any] = []
    for motion, (length, width) in ((ego, (4.0, 2.0)), (other, CAR)):
        place, yaw = motion.move(np.array([[time_s]]))
        t = np.linspace(-0.5, 0.5, 400)
        rim = np.concatenate([length * t + 1j * s * width / 2 for s in (-1, 1)]
                             + [s * length / 2 + 1j * width * t for s in (-1, 1)])  # fmt: skip
        outlines.append(place[0, 0] + rim * np.exp(1j * yaw[0, 0]))
    return float(np.abs(outlines[0][:, None] - outlines[1][None]).min())


def test_the_outline_of_the_ego_is_what_the_log_says() -> None:
    assert outline_of({}) == Outline(3.7, 1.0, 0.9)
    assert outline_of({"simulated": "3"}) == Outline(2.25, 2.25, 0.9)
    assert outline_of({"kitti.camera0": "body", "ego.front_m": "3"}) == Outline(3.0, 2.1, 0.9)
    for wrong in ("wide", "0", "-1", "nan", "inf"):
        with pytest.raises(LogError, match=r"ego\.side_m"):
            outline_of({"ego.side_m": wrong})
