"""Everybody who moves, as arrays that compiled code changes."""

from typing import NamedTuple

import numpy as np

from fbench.replay.data.arrays import Array, Float64

WINDOW, HERE = 14, 4
"""How many lanes of its way each mover keeps, and which of them it is on."""
NUM_CHOICES = 512
"""Numbers drawn for each mover to choose its ways with, over and over."""
AXLE = 0.3
"""Axles before and behind the middle of the footprint, as a share of the length."""
EMERGENCY, CHANGE = 0, 1
"""Counters: bodies stopped at once because they would have touched another; lane changes."""


MOVER = np.dtype([
    # what each is like
    ("length_m", "f8"), ("width_m", "f8"), ("kind", "i8"), ("factor", "f8"), ("fastest_mps", "f8"), ("headway_s", "f8"),
    ("standing_gap_m", "f8"), ("acceleration_mps2", "f8"), ("braking_mps2", "f8"), ("margin_m", "f8"),
    ("keeps_right", "?"), ("cycle_m", "f8"),
    # where it is, at the beginning of a step
    ("at_m", "f8"), ("base_m", "f8"), ("speed_mps", "f8"), ("side_m", "f8"), ("side_from_m", "f8"),
    ("side_for_m", "f8"),
    # what it does until the end of the step
    ("accel_mps2", "f8"), ("frozen", "?"), ("braking", "?"),
    # what it has in mind
    ("right_to_m", "f8"), ("waited_s", "f8"), ("num_chosen", "i8"),
])  # fmt: skip
"""One mover.

kind: of its lanes. factor: on speed limits. headway_s, standing_gap_m, acceleration_mps2, braking_mps2: T, s0, a, b of
the IDM. margin_m: before a line to stop at. keeps_right: never uses the leftmost lane. cycle_m: how far a cycle of gait
or pedals goes, 0 for none. at_m: the middle of its footprint along the lane `HERE` of its way. base_m: distance
travelled up to the beginning of that lane. side_m: how far left of its lane it was when it began
a change of lanes, which each of its axles makes from `side_from_m` of the distance travelled on, over `side_for_m`.
accel_mps2: constant, until it stands. frozen: was stopped at once.
right_to_m: distance travelled up to which it may enter gates. waited_s: at a gate, where only others are in its way.
"""


CHANGE_S = 3.5
"""How long a change of lanes takes."""


class State(NamedTuple):
    """N movers; compiled code changes the arrays."""

    movers: Array
    """(N,) of `MOVER`."""
    way: Array
    """(N, WINDOW) lanes in the order of travel; -1 far behind where the first one has none that leads to it. Movers
    begin wholly on their lane, so no body is there.
    """
    choices: Float64
    """(N, NUM_CHOICES) from 0 to below 1."""
    counters: Array
    """(2,): `EMERGENCY`, `CHANGE`."""
