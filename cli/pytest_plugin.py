"""A pytest plug-in: `fbench_gate(base, head, policy)` fails a test with what became worse.

It imports nothing heavy before a test asks for the fixture.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from fbench.api.runs import RunComparison


def require_no_regression(
    base: Path | str, head: Path | str, policy: Path | str | None = None, tolerance: float = 0.0
) -> "RunComparison":
    """Compare two runs or suites by a policy, or a tolerance; fail the test with the numbers and objects that became
    worse, else return the comparison.
    """
    from fbench.api.runs import compare

    found = compare(base, head, tolerance, policy)
    if found.is_worse:
        comparison = found.comparison
        bad = [row for row in comparison.gating if row.verdict == "REGRESSED"]
        numbers = [f"{row.name}: {row.values}; {row.reason}" for row in bad]
        lines = [comparison.headline, *numbers, *comparison.failures, *map(str, comparison.objects[:10])]
        pytest.fail("\n".join(lines), pytrace=False)
    return found


@pytest.fixture
def fbench_gate() -> Callable[..., "RunComparison"]:
    """Return `require_no_regression`."""
    return require_no_regression
