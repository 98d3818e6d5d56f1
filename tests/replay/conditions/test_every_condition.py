"""What holds for every condition that is installed: identity, effect, growth, and no dependence on order or workers."""

from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from tests.replay.engine.test_run import content, play

from fbench.replay.conditions.disturb import Disturbance, DisturbedReader
from fbench.replay.conditions.effects import Effects
from fbench.replay.conditions.generators import generator
from fbench.replay.conditions.spec import load_condition, parse_conditions
from fbench.replay.contracts.conditions import DisturbsRig
from fbench.replay.contracts.entry_points import entry_points_of
from fbench.replay.contracts.street import Street, list_calls
from fbench.replay.contracts.testing import check_condition
from fbench.replay.data.messages import Tick
from fbench.replay.runs.digest import digest

NAMES = sorted(entry_points_of("conditions"))
NUM = 40
SEVERITY = 3


def test_the_catalog_is_large_and_has_all_kinds():
    conditions = [load_condition(name) for name in NAMES]
    assert {kind for condition in conditions for kind in condition.kinds} == {"camera", "lidar", "radar"}
    assert all((type(condition).__doc__ or "").strip() for condition in conditions)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_it_keeps_what_conditions_promise(name):
    check_condition(lambda: load_condition(name))


@pytest.mark.parametrize("name", NAMES)
def test_severity_0_is_no_condition(name):
    assert parse_conditions(f"{name}:0") == ()


def test_severity_0_is_the_clear_run_byte_for_byte(tmp_path):
    """That of all at once: each is none then, as the test above says."""
    street, none = Street(4), parse_conditions("+".join(f"{name}:0" for name in NAMES))
    play(street, tmp_path / "clear")
    play(street, tmp_path / "none", disturbance=Disturbance(none, 7, street.span))
    assert content(tmp_path / "none") == content(tmp_path / "clear")


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_log_under_it_is_the_same_whenever_it_is_read(name):
    """The messages of the first half are those of the whole, and a second pass gives the same."""
    street = Street(8)
    disturbance = Disturbance(parse_conditions(f"{name}:{SEVERITY}"), 2, street.span)
    reader = DisturbedReader(street, disturbance, Effects())
    first, second = ([digest(item) for item in reader.messages()] for _ in range(2))
    assert first == second
    half = DisturbedReader(Street(4), disturbance, Effects())
    last_ns = max(message.log_ns for message in Street(4).messages())

    def until(log):
        return [digest(item) for item in log.messages() if item.log_ns <= last_ns and not isinstance(item, Tick)]

    assert until(half) == until(reader)


@pytest.mark.parametrize("name", [name for name in NAMES if isinstance(load_condition(name), DisturbsRig)])
def test_rotations_stay_rotations(name):
    street = Street(1)
    for severity in range(1, 6):
        rig = Disturbance(parse_conditions(f"{name}:{severity}"), 1, street.span).rig(street.rig, "street-1")
        for sensor in rig.mounts:
            rotation = rig.body_T_sensor(sensor)[:3, :3]
            assert np.abs(rotation.T @ rotation - np.eye(3)).max() < 1e-12


@cache
def _calls(name):
    condition = load_condition(name)
    level = {key: float(values[SEVERITY - 1]) for key, values in condition.levels.items()}
    calls = list_calls(condition, Street(NUM), SEVERITY)
    first = calls[0].site.kind  # one kind of sensor a condition: 40 messages
    return condition, level, [call for call in calls if call.site.kind == first]


def _compute(tasks):
    """What becomes of messages; runs in another process, which knows nothing of other ones."""
    found = []
    for name, index in tasks:
        condition, level, calls = _calls(name)
        found.append((name, index, digest(list(calls[index].disturb(condition, level)))))
    return found


@pytest.mark.slow
def test_40_of_40_messages_are_equal_for_any_order_and_number_of_workers(monkeypatch):
    """One worker is this process. Seeding once in it and drawing on in workers, as others do, leaves 1 of 40 equal."""
    monkeypatch.syspath_prepend(Path(__file__).resolve().parents[3])  # where workers find this file
    tasks = [(name, index) for name in NAMES for index in range(NUM)]
    expected = {(name, index): value for name, index, value in _compute(tasks)}
    for workers in (2, 4):
        order = generator(workers, "order").permutation(len(tasks))
        parts = [[tasks[i] for i in order[part::workers]] for part in range(workers)]
        with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
            results = list(pool.map(_compute, parts))
        found = {(name, index): value for part in results for name, index, value in part}
        assert len(found) == len(tasks)
        for name in NAMES:
            equal = sum(found[name, index] == expected[name, index] for index in range(NUM))
            assert (name, equal) == (name, NUM)
