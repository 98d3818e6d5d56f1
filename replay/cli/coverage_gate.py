"""The gate on truth: too few outputs that could be scored."""

import sys

from fbench.replay.errors import EXIT_NO, EXIT_OK
from fbench.replay.store import Run
from fbench.replay.truth.coverage import coverage_of


def gated(run: Run, min_coverage: float, code: int) -> int:
    """Return the exit code of a command that ends with `code`: 1 where all else is good, but less than that share of
    outputs had truth, which a line on stderr says.
    """
    coverage = coverage_of(run)
    if coverage.share >= min_coverage:
        return code
    sys.stderr.write(f"too little truth: {coverage}, fewer than --min-coverage {min_coverage:g} asks for\n")
    return EXIT_NO if code == EXIT_OK else code
