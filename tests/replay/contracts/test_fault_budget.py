"""Budgets of lost data."""

import pytest

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultBudget, FaultLog, parse_budget


def met(**counts):
    faults = FaultLog()
    for code, num in counts.items():
        faults.add(code, "somewhere", num)
    return faults


@pytest.mark.parametrize(
    ("on_fault", "budgets", "counts", "over"),
    [
        ("strict", [], {}, ()),
        ("strict", [], {"TIM007": 9}, ()),  # degrades only
        ("strict", [], {"DEC001": 1, "TIM007": 9}, ("DEC001",)),
        ("strict", ["2"], {"DEC001": 1, "LOG004": 1}, ()),
        ("strict", ["1"], {"DEC001": 1, "LOG004": 1}, ("DEC001", "LOG004")),
        ("strict", ["DEC001=3"], {"DEC001": 3}, ()),
        ("strict", ["DEC001=3"], {"DEC001": 4}, ("DEC001",)),
        ("strict", ["DEC001=3"], {"DEC001": 3, "LOG004": 1}, ("LOG004",)),
        ("strict", ["DEC001=3", "1"], {"DEC001": 3, "LOG004": 1}, ()),
        ("tolerant", [], {"DEC001": 99}, ()),
        ("tolerant", ["DEC001=3"], {"DEC001": 4, "LOG004": 99}, ("DEC001",)),
        ("tolerant", ["5"], {"DEC001": 4, "LOG004": 2}, ("DEC001", "LOG004")),
    ],
)
def test_budget(on_fault, budgets, counts, over):
    assert parse_budget(on_fault, budgets).find_exceeded(met(**counts)) == over


@pytest.mark.parametrize(
    ("on_fault", "budgets", "text"),
    [
        ("lenient", [], "--on-fault lenient: expected 'strict' or 'tolerant'"),
        ("strict", ["some"], "--fault-budget some: expected a number of faults such as 5, or CODE=5"),
        ("strict", ["-1"], "--fault-budget -1: expected a number"),
        ("strict", ["DEC001="], "--fault-budget DEC001=: expected a number"),
        ("strict", ["DEC01=3"], "'DEC01' isn't a fault that loses data; did you mean 'DEC001'"),
        ("strict", ["TIM007=3"], "'TIM007' isn't a fault that loses data"),
    ],
)
def test_bad_budget(on_fault, budgets, text):
    with pytest.raises(ConfigError) as error:
        parse_budget(on_fault, budgets)
    assert text in str(error.value)


def test_default_is_strict():
    assert FaultBudget() == parse_budget("strict", [])
