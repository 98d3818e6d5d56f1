"""On which lanes bodies are found, and the lanes behind them at the beginning."""

import numpy as np
from tests.datasets.city.traffic.test_traffic_long import overlapping

from fbench.datasets.city.bodies.make import make_body
from fbench.datasets.city.traffic.network import HERE, LANE, MOVER, WINDOW, Network, network_of
from fbench.datasets.city.traffic.occupancy_kernel import occupancy
from fbench.datasets.city.traffic.placing import TrafficParams, place_movers
from fbench.datasets.city.traffic.traffic import Traffic
from fbench.datasets.city.world.city_map import CityMap, Lane, Layout, SignalPlan

SHORT_M = 1.5


def test_a_body_is_on_every_lane_that_it_reaches_into_and_on_those_that_it_leaves() -> None:
    # Two rows of 20 lanes, each shorter than the bodies; who changes to the right one is still on the left one too.
    lanes = np.zeros(40, LANE)
    lanes["length_m"], lanes["left"], lanes["right"] = SHORT_M, -1, -1
    lanes["left"][20:], lanes["right"][:20] = np.arange(20), np.arange(20, 40)
    lanes["point_from"], lanes["point_to"] = np.arange(40) * 2, np.arange(40) * 2 + 2
    path = np.zeros((80, 7))
    path[:, 5] = np.tile([0.0, SHORT_M], 40)
    movers, way = np.zeros(12, MOVER), np.tile(np.arange(WINDOW) + 22, (12, 1))
    movers["length_m"], movers["at_m"] = np.linspace(1.0, 11.5, 12), np.linspace(0.1, 1.4, 12)
    movers["side_m"], movers["side_from_m"], movers["side_for_m"] = 3.5, 100.0, 10.0
    taken = occupancy(path, lanes, movers, way)
    assert len(taken.who) > 12 * 8
    middle = HERE * SHORT_M + movers["at_m"]  # from the beginning of the first lane of the way
    low, high = middle - movers["length_m"] / 2, middle + movers["length_m"] / 2
    for lane in range(40):
        begin = (lane % 20 - 2) * SHORT_M
        rows = slice(taken.first[lane], taken.first[lane + 1])
        inside = (low < begin + SHORT_M) & (high > begin) & (begin >= 0) & (begin < WINDOW * SHORT_M)
        assert sorted(taken.who[rows].tolist()) == np.flatnonzero(inside).tolist()
        assert (np.diff(taken.at_m[rows]) >= 0).all()
        assert np.allclose(taken.at_m[rows], middle[taken.who[rows]] - begin)


def _ramps() -> CityMap:
    """Two lanes beside each other that nothing leads to, on to a ring of two lanes."""
    x, angle = np.arange(-200.0, 0.5, 1.0), np.linspace(-np.pi / 2, 1.5 * np.pi, 630)
    lanes = []
    for y, radius in ((0.0, 100.0), (-3.5, 103.5)):
        ring = np.column_stack([radius * np.cos(angle), 100.0 + radius * np.sin(angle), 0 * angle])
        lanes += [np.column_stack([x, 0 * x + y, 0 * x]), ring]
    return CityMap("ramps", (
        Lane(lanes[1], 3.5, 15.0, "drive", (0,), right=1), Lane(lanes[3], 3.5, 15.0, "drive", (1,), left=0),
        Lane(lanes[0], 3.5, 15.0, "drive", (0,), right=3), Lane(lanes[2], 3.5, 15.0, "drive", (1,), left=2),
    ), SignalPlan(60.0, np.zeros(0), np.zeros(0)), (), (), np.zeros((0, 3)))  # fmt: skip


def test_lanes_behind_lead_to_each_other_or_there_are_none() -> None:
    city_map = _ramps()
    net: Network = network_of(city_map)
    bodies = [make_body("car", np.random.default_rng(i)) for i in range(30)]
    kept, state = place_movers(net, bodies, 0.1, 7)
    assert len(kept) > 15
    starts = 0
    for way in state.way:
        for before, after in zip(way[:-1].tolist(), way[1:].tolist(), strict=True):
            assert before < 0 or after in city_map.lanes[before].successors
        assert (way[HERE:] >= 0).all()
        starts += way[HERE] >= 2
        assert (way[:HERE] < 0).all() == (way[HERE] >= 2)
    assert starts > 2


def test_who_begins_where_no_lane_leads_to_drives_on() -> None:
    traffic = Traffic(Layout(_ramps(), (), ()), TrafficParams(12.0, mix={"car": 1.0}, speed_spread=0.15), 3)
    motion = traffic.motion(0.0, 60.0)
    sizes = np.array([actor.body.size_lwh_m for actor in traffic.actors])
    states = [motion.at(float(k)) for k in range(61)]
    assert not any(overlapping(state, sizes) for state in states)
    assert (states[-1].position_m[:, 0] > -110).all()  # all are on the ring
    assert traffic.num_emergencies == 0
