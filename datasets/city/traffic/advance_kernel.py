"""Compiled: everybody goes on as was decided, and chooses where to."""

from fbench.datasets.city.traffic.path_kernel import travelled
from fbench.datasets.city.traffic.state import HERE, NUM_CHOICES, WINDOW
from fbench.replay.arrays import Array, Float64
from fbench.replay.kernels import kernel


@kernel
def move(lanes: Array, movers: Array, way: Array, step_s: float) -> None:
    """Move all to the end of the step; who leaves a lane has one less to go along."""
    for i in range(len(movers)):
        me = movers[i]
        if me["frozen"]:
            me["speed_mps"] = 0.0
            continue
        gone, v = travelled(me["speed_mps"], me["accel_mps2"], step_s)
        me["at_m"] += gone
        me["speed_mps"] = v if v > 1e-3 else 0.0
        while me["at_m"] > lanes[way[i, HERE]]["length_m"]:
            passed = lanes[way[i, HERE]]["length_m"]
            me["at_m"] -= passed
            me["base_m"] += passed
            for k in range(WINDOW - 1):
                way[i, k] = way[i, k + 1]
            way[i, WINDOW - 1] = -1


@kernel
def extend(lanes: Array, nexts: Array, movers: Array, way: Array, choices: Float64) -> None:
    """Choose lanes for the places ahead on all ways that are -1, each after the one before."""
    for i in range(len(movers)):
        for k in range(HERE + 1, WINDOW):
            if way[i, k] < 0:
                drawn = choices[i, movers[i]["num_chosen"] % NUM_CHOICES]
                movers[i]["num_chosen"] += 1
                way[i, k] = chosen(lanes, nexts, way[i, k - 1], movers[i]["length_m"], drawn)


@kernel
def chosen(lanes: Array, nexts: Array, lane: int, length_m: float, drawn: float) -> int:
    """Choose a successor that bodies of this length may use."""
    first, last = lanes[lane]["next_from"], lanes[lane]["next_to"]
    total = 0.0
    for n in range(first, last):
        if lanes[nexts[n]["lane"]]["longest_m"] >= length_m:
            total += nexts[n]["weight"]
    if total == 0.0:
        found: int = nexts[first + int(drawn * (last - first))]["lane"]
        return found
    left = drawn * total
    for n in range(first, last):
        if lanes[nexts[n]["lane"]]["longest_m"] >= length_m:
            left -= nexts[n]["weight"]
            found = nexts[n]["lane"]
            if left < 0.0:
                return found
    return found
