"""Writing the report.

Charts are drawn by a few hundred lines of plain JavaScript instead of plotly: its bundle alone weighs 4.5 MB a
report, and the frame viewer (points, boxes and image linked to each other) would have to be written by hand anyway.
"""

import os
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from fbench.replay.errors import ConfigError
from fbench.replay.result_table import Results
from fbench.replay.store import Run
from fbench.reports.html.page import page


class HtmlReport:
    """One self-contained HTML file about one run, or about several side by side.

    It loads nothing, works offline, and is equal byte by byte for equal run folders; all that was measured on the
    host's clock stands inside the one section `timing`.
    """

    def write(self, runs: Sequence[Run], out: Path) -> None:
        """Write the report of `runs` to `out`, which appears only when whole.

        Raises:
            ConfigError: without runs, or where `out` can't be written.
            RunError: where a run folder is damaged.
        """
        if not runs:
            raise ConfigError("report: no runs given; name at least one run folder")
        _write_whole(out, page(runs).encode("utf-8"))

    def write_results(self, results: Results, runs: Sequence[Run], out: Path) -> None:
        """Write a report that begins with the tables of an experiment, and goes on with `runs`, some of its own; see
        `write`.
        """
        _write_whole(out, page(runs, results).encode("utf-8"))


def _write_whole(out: Path, content: bytes) -> None:
    partial = out.with_name(f".{out.name}.partial-{os.getpid()}")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(out)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        why = f"{out}: the report can't be written ({error.strerror}); choose another with --out"
        raise ConfigError(why) from error
