"""The tree that Embree builds, and so which of two equally near triangles is hit, depends on no number of CPUs."""

import subprocess
import sys

import pytest

SCRIPT = """
import hashlib, os, sys
import numpy as np
os.sched_setaffinity(0, set(list(os.sched_getaffinity(0))[: int(sys.argv[1])]))
from embreex.rtcore import EmbreeDevice
from fbench.datasets.city.mesh import merge_meshes
from fbench.datasets.city.rays.smooth import Scene
from fbench.datasets.city.mesh import Skin, box
rng = np.random.default_rng(1)
skin = Skin("concrete", (0.5, 0.5, 0.5))
sizes = rng.integers(1, 4, (3000, 3)) * 2.0  # many faces in one plane, many edges in one line
boxes = [box((*map(float, rng.integers(-40, 40, 2)), 2.0), tuple(size), skin) for size in sizes]
scene = Scene(merge_meshes(boxes), EmbreeDevice())
start = np.column_stack([rng.integers(-80, 80, (50_000, 2)) * 0.5, np.full(50_000, 30.0)]).astype(np.float32)
down = np.tile(np.float32([[0, 0, -1]]), (50_000, 1))
aslant = rng.integers(-40, 40, (50_000, 3)) * [0.5, 0.5, 0.0] - [0.25, 0.25, 30.0]
aslant = (aslant / np.sqrt((aslant * aslant).sum(axis=1))[:, None]).astype(np.float32)
found = [array for direction in (down, aslant) for array in scene.nearest(start, direction, 300.0)]
print(hashlib.sha256(b"".join(array.tobytes() for array in found)).hexdigest())
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="needs a way to choose CPUs")
def test_ties_fall_alike_on_any_number_of_cpus():
    def digest(cpus: int) -> str:
        return subprocess.run(
            [sys.executable, "-c", SCRIPT, str(cpus)], check=True, capture_output=True, text=True
        ).stdout.strip()

    one = digest(1)
    assert len(one) == 64
    assert digest(2) == digest(1024) == one
