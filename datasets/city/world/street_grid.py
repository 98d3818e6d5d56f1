"""The streets of the urban world: a closed grid, and coordinates along it."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fbench.replay.conditions.generators import generator
from fbench.replay.data.arrays import Float64

LANE_M, BIKE_M, PARKING_M, SIDEWALK_M = 3.25, 1.5, 2.1, 3.0
"""Widths of a drive lane, a bike lane, a parking strip and a sidewalk."""
MARGIN_M = 1.0
"""Asphalt between drive lanes and kerb where there is neither bike lane nor parking strip: a bus that turns left swings
out by 2.5 m to its right, and a lane's edge is only 1.6 m away."""
CORNER_M = 6.5
"""Radius of the drive lanes' inner edge where they turn right: kerbs bend only so near to the crossing street."""
STOP_M = 12.5
"""How far before the crossing street's drive lanes the lanes end: behind the crossing of pedestrians (7.2 to 10.8 m).

A body of 12 x 2.55 m whose middle follows the right turn's arc (radius 8.1 m) swings out by 2.9 m, but no more than
1.9 m from 4.9 m after the arc on; arcs end 7.5 m from the crossing lanes, so it passes whoever waits at the line."""
EAST, NORTH, WEST, SOUTH = range(4)
_WAYS = np.array([[1.0, 0], [0, 1], [-1, 0], [0, -1]])

Node = tuple[int, int]
Cell = tuple[int, int]
"""A block by the node at its south-west; those around the world, beyond the border streets, count too."""


@dataclass(frozen=True, eq=False)
class Arm:
    """One street as it leaves a junction. Seen outwards, its lanes towards the junction are on the left. Along it,
    distances count from where the drive lanes of the crossing street end.
    """

    node: Node
    way: int  # EAST, NORTH, WEST or SOUTH
    far: Node  # Where it leads
    origin_m: Float64  # (2,) the junction's middle
    num_lanes: int  # Drive lanes for each direction
    edge_m: float  # Half the width of the crossing street's drive lanes
    left_extra_m: float
    right_extra_m: float  # Width of bike lane, parking strip or margin between drive lanes and kerb
    has_bikes: bool  # Whether there is a bike lane on its left

    @property
    def out(self) -> Float64:
        """Unit vector (2,) away from the junction."""
        return np.asarray(_WAYS[self.way])

    @property
    def left(self) -> Float64:
        """Unit vector (2,) to the left of `out`."""
        return np.asarray(_WAYS[(self.way + 1) % 4])

    @property
    def half_m(self) -> float:
        """Half the width of its drive lanes."""
        return self.num_lanes * LANE_M

    @property
    def left_kerb_m(self) -> float:
        """From the street's middle to the kerb on its left."""
        return self.half_m + self.left_extra_m

    @property
    def right_kerb_m(self) -> float:
        """From the street's middle to the kerb on its right."""
        return self.half_m + self.right_extra_m

    @property
    def yaw_rad(self) -> float:
        """Heading of `out`."""
        return self.way * np.pi / 2

    def length_to(self, far: "Arm") -> float:
        """Distance between the crossing streets' drive lanes, where `far` is its other end."""
        way = far.origin_m - self.origin_m
        return float(np.abs(way).sum()) - self.edge_m - far.edge_m

    def at(self, along_m: float, left_m: float) -> Float64:
        """Point (2,) at a distance along it and to the left of its middle."""
        return self.origin_m + (self.edge_m + along_m) * self.out + left_m * self.left


@dataclass(frozen=True, eq=False)
class Grid:
    """Streets along both axes; junctions where they cross."""

    x_m: tuple[float, ...]
    y_m: tuple[float, ...]  # Where streets along y, and along x, lie
    lanes: tuple[tuple[int, ...], tuple[int, ...]]
    """Drive lanes a direction of streets along x (by their place in `y_m`) and along y."""
    bikes: frozenset[Cell]  # Blocks that bicycles circle
    parkings: frozenset[tuple[Cell, int]]  # Sides of blocks with a parking strip

    def is_inner(self, cell: Cell) -> bool:
        """Whether a block is surrounded by streets."""
        return 0 <= cell[0] < len(self.x_m) - 1 and 0 <= cell[1] < len(self.y_m) - 1

    @property
    def nodes(self) -> list[Node]:
        """All junctions."""
        return [(i, j) for j in range(len(self.y_m)) for i in range(len(self.x_m))]

    @property
    def cells(self) -> list[Cell]:
        """All inner blocks."""
        return [(i, j) for i, j in self.nodes if self.is_inner((i, j))]

    def extra_m(self, cell: Cell, side: int) -> float:
        """Width between drive lanes and kerb at one side of a block."""
        return max(MARGIN_M, BIKE_M * (cell in self.bikes) + PARKING_M * ((cell, side) in self.parkings))

    def arms(self, node: Node) -> list[Arm]:
        """Streets that leave a junction, from the east counter-clockwise."""
        return [self.arm[node, way] for way in range(4) if (node, way) in self.arm]

    def opposite(self, arm: Arm) -> Arm:
        """The same street as it leaves the junction at its other end."""
        return self.arm[arm.far, (arm.way + 2) % 4]

    @cached_property
    def arm(self) -> dict[tuple[Node, int], Arm]:
        """All arms by junction and way."""
        arms: dict[tuple[Node, int], Arm] = {}
        for i, j in self.nodes:
            around: list[Cell] = [(i, j), (i - 1, j), (i - 1, j - 1), (i, j - 1)]
            for way, (x, y) in enumerate(_WAYS.astype(int).tolist()):
                far, along_y = (i + x, j + y), way % 2
                if 0 <= far[0] < len(self.x_m) and 0 <= far[1] < len(self.y_m):
                    arms[(i, j), way] = Arm(
                        (i, j), way, far, np.array([self.x_m[i], self.y_m[j]]),
                        num_lanes=self.lanes[along_y][i if along_y else j],
                        edge_m=LANE_M * self.lanes[1 - along_y][j if along_y else i],
                        left_extra_m=self.extra_m(around[way], (way - 1) % 4),
                        right_extra_m=self.extra_m(around[way - 1], (way + 1) % 4),
                        has_bikes=around[way] in self.bikes,
                    )  # fmt: skip
        return arms

    @cached_property
    def rings(self) -> list[list[Arm]]:
        """Around each block, and last around the world: the arms along whose left side its kerb goes, in order."""
        rings = []
        for i, j in self.cells:
            starts: list[Node] = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
            rings.append([self.arm[start, way] for way, start in enumerate(starts)])
        nx, ny = len(self.x_m) - 1, len(self.y_m) - 1
        outer = [
            *(self.arm[(0, j), NORTH] for j in range(ny)), *(self.arm[(i, ny), EAST] for i in range(nx)),
            *(self.arm[(nx, ny - j), SOUTH] for j in range(ny)), *(self.arm[(nx - i, 0), WEST] for i in range(nx)),
        ]  # fmt: skip
        return [*rings, outer]


_JUNCTIONS = 4


def draw_grid(seed: int) -> Grid:
    """Draw a grid of `_JUNCTIONS` x `_JUNCTIONS` junctions, about the origin. Border streets have one lane a direction,
    so that corners join equals; one or two inner streets are avenues. A border street has its outer parking strip
    everywhere or nowhere, so that the kerb stays straight.
    """
    draw, num = generator(seed, "urban layout", "grid"), _JUNCTIONS
    blocks = (draw.uniform(75, 110, num - 1) for _ in range(2))  # with some meters for the streets between them
    ends = [np.concatenate([[0.0], np.cumsum(np.round(long + 12.0, 1))]) for long in blocks]
    x_m, y_m = (tuple((places - np.round(places[-1] / 2, 1)).tolist()) for places in ends)
    lanes = [[1] * num, [1] * num]
    for axis in range(2):
        if axis == 0 or draw.random() < 0.5:
            lanes[axis][int(draw.integers(1, num - 1))] = 2
    cells = [(i, j) for j in range(num - 1) for i in range(num - 1)]
    bikes = frozenset(cell for cell in cells if draw.random() < 0.45)
    inner = frozenset((cell, side) for cell in cells for side in range(4) if draw.random() < 0.6)
    outer = [[((num - 1, k), WEST) for k in range(num - 1)], [((k, num - 1), SOUTH) for k in range(num - 1)],
             [((-1, k), EAST) for k in range(num - 1)], [((k, -1), NORTH) for k in range(num - 1)]]  # fmt: skip
    strips = inner.union(*(side for side in outer if draw.random() < 0.6))
    return Grid(x_m, y_m, (tuple(lanes[0]), tuple(lanes[1])), bikes, strips)
