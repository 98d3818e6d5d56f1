"""Putting objects together."""

import numpy as np
import pytest

from fbench.pipelines.fusion.observations import are_one
from fbench.replay.data.boxes import Boxes3D, concatenate


def found(x, y, length=4.0, yaw=0.0):
    return Boxes3D(np.array([[x, y, 0.8]]), np.array([[length, 2.0, 1.5]]), np.array([yaw]))


@pytest.mark.parametrize(
    ("a", "b", "one"),
    [
        (found(10, 0), found(12.9, 0), True),
        (found(10, 0), found(13.1, 0), False),
        (found(10, 0, length=12), found(5, 0.5), True),  # the near end of a bus
        (found(5, 0.5), found(10, 0, length=12), True),
        (found(10, 0, length=12), found(6, 3.1), False),  # beside it
        (found(10, 0, length=12, yaw=np.pi / 2), found(10, 5), True),
    ],
)
def test_are_one(a, b, one):
    assert are_one(concatenate([a, b]), merge_m=3.0).tolist() == [[True, one], [one, True]]
