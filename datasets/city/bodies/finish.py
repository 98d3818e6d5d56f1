"""From parts to a body whose box is exact."""

from collections.abc import Sequence

import numpy as np

from fbench.datasets.city.actor import Body
from fbench.datasets.city.bodies.shell import shifted
from fbench.datasets.city.mesh import Mesh, merged


def body(label: str, phases: Sequence[Sequence[Mesh]]) -> Body:
    """Centre the parts of all phases on their common box and set that box; each phase stands on the ground."""
    wholes = [merged(parts) for parts in phases]
    low = np.min([whole.vertices_m.min(0) for whole in wholes], axis=0).astype(np.float64)
    high = np.max([whole.vertices_m.max(0) for whole in wholes], axis=0).astype(np.float64)
    x, y, _ = (low + high) / 2
    meshes = tuple(shifted(whole, (-x, -y, -float(whole.vertices_m[:, 2].min()))) for whole in wholes)
    reach = np.max([np.abs(mesh.vertices_m).max(0) for mesh in meshes], axis=0).astype(np.float64)
    return Body(label, (2 * float(reach[0]), 2 * float(reach[1]), float(reach[2])), meshes)
