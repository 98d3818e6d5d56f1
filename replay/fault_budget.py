"""How much data may be lost before a run counts as incomplete."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from fbench.replay.errors import ConfigError
from fbench.replay.faults import FAULTS, FaultLog
from fbench.replay.names import did_you_mean


@dataclass(frozen=True)
class FaultBudget:
    """How many faults that lose data are allowed."""

    total: int | None = 0
    """Of all codes without a number of their own; `None`: any number."""
    by_code: Mapping[str, int] = field(default_factory=dict)

    def exceeded(self, faults: FaultLog) -> tuple[str, ...]:
        """Codes of which more were met than allowed, sorted."""
        lost = {code: num for code, num in sorted(faults.counts.items()) if num and FAULTS[code].behaviour == "count"}
        over = [code for code, num in lost.items() if num > self.by_code.get(code, num)]
        others = [code for code in lost if code not in self.by_code]
        if self.total is not None and sum(lost[code] for code in others) > self.total:
            over += others
        return tuple(sorted(over))


def parse_budget(on_fault: str, budgets: Sequence[str]) -> FaultBudget:
    """Read `strict` (nothing may be lost) or `tolerant` (anything), and budgets such as `5` or `DEC001=5`.

    Raises:
        ConfigError: naming what isn't one of these.
    """
    totals: dict[str, int | None] = {"strict": 0, "tolerant": None}
    if on_fault not in totals:
        raise ConfigError(f"--on-fault {on_fault}: expected 'strict' or 'tolerant'")
    total, by_code = totals[on_fault], {}
    for text in budgets:
        code, equals, number = text.rpartition("=")
        if not number.isdecimal() or not number.isascii():
            raise ConfigError(f"--fault-budget {text}: expected a number of faults such as 5, or CODE=5")
        if not equals:
            total = int(number)
            continue
        countable = [c for c, kind in FAULTS.items() if kind.behaviour == "count"]
        if code not in countable:
            hint = did_you_mean(code, countable)
            raise ConfigError(f"--fault-budget {text}: '{code}' isn't a fault that loses data{hint}")
        by_code[code] = int(number)
    return FaultBudget(total, by_code)
