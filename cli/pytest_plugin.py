"""A pytest plug-in: `fbench_gate(base, head, policy)` fails a test with what became worse.

It imports nothing heavy before a test asks for the fixture.
"""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from fbench.api.runs import RunComparison

Gate = Callable[..., "RunComparison"]


@pytest.fixture
def fbench_gate() -> Gate:
    """Return a function of base, head and a policy file (or a tolerance): it returns the comparison, or fails the test
    with the numbers and objects that became worse.
    """

    def gate(
        base: Path | str, head: Path | str, policy: Path | str | None = None, tolerance: float = 0.0
    ) -> "RunComparison":
        from fbench.api.runs import compare

        found = compare(base, head, tolerance, policy)
        if found.is_worse:
            comparison = found.comparison
            bad = [f"{row.name}: {row.base} -> {row.head}; {row.reason}" for row in comparison.gating
                   if row.verdict == "REGRESSED"]  # fmt: skip
            lines = [comparison.headline, *bad, *comparison.failures, *map(str, comparison.objects[:10])]
            pytest.fail("\n".join(lines), pytrace=False)
        return found

    return gate
