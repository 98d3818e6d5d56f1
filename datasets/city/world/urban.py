"""The urban world: a closed grid of streets with junctions, blocks and all that stands there.

A junction, outwards from the crossing street's drive lanes: kerbs bend up to 6.5 m, people cross from 7.2 to 10.8 m,
vehicles wait at 12.5 m. Approaches that face each other are green together, then the others, then all crossings: see
`urban_signals`. Right turns of cars and bicycles are arcs about one centre, bicycles inside; left turns are as wide as
fits, 12.4 m and more.
"""

from fbench.datasets.city.world.buildings import block_placements
from fbench.datasets.city.world.city_map import CityMap
from fbench.datasets.city.world.lane_graph import joined
from fbench.datasets.city.world.layout import Layout
from fbench.datasets.city.world.street_grid import drawn_grid
from fbench.datasets.city.world.urban_drives import bike_lanes, drive_lanes
from fbench.datasets.city.world.urban_furniture import furniture, street_lamps_m
from fbench.datasets.city.world.urban_ground import ground_patches, regions
from fbench.datasets.city.world.urban_markings import marking_patches
from fbench.datasets.city.world.urban_parking import parkings
from fbench.datasets.city.world.urban_signals import signal_groups, signal_plan
from fbench.datasets.city.world.urban_walks import walk_lanes


def urban_layout(seed: int) -> Layout:
    """Lay out a world of 4 x 4 junctions, about 400 m wide."""
    grid = drawn_grid(seed)
    groups = signal_groups(grid)
    drafts = [
        *drive_lanes(grid, groups.approaches),
        *bike_lanes(grid, groups.approaches),
        *walk_lanes(grid, groups.walks),
    ]
    signals = signal_plan(seed, grid, groups, drafts)
    city_map = CityMap("urban", joined(drafts), signals, regions(grid), parkings(grid), street_lamps_m(grid))
    patches = (*ground_patches(seed, grid), *marking_patches(grid))
    return Layout(city_map, patches, (*block_placements(seed, grid), *furniture(seed, grid, groups)))
