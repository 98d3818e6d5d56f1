"""Forms of a report besides its page: an overlay for viewers, tables, figures, and what localhost serves."""

from collections.abc import Sequence
from pathlib import Path

from fbench.api.scores import open_folder
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.logs.open import open_log


def overlay(run: Path | str, out: Path, log: Path | None = None, options: ScoreOptions | None = None) -> list[Path]:
    """Write the results of a run as MCAP with Foxglove's schemas, and a layout for Foxglove and Lichtblick.

    Args:
        run: The run folder.
        out: The MCAP file; the layout is written beside it.
        log: The log that was replayed, whose messages are copied; `None`: open the overlay together with the log.
        options: Which boxes count and match, for their colors.

    Returns:
        Paths of the overlay and the layout.

    Raises:
        ConfigError: where there is no such run, the log isn't the one that was replayed, or nothing can be written.
        LogError: where the log can't be read.
        MetricError: where an id is twice in a frame.
    """
    from fbench.metrics.runs.outcomes import outcomes_of
    from fbench.reports.overlay.file import write_overlay

    opened = open_folder(Path(run))
    reader = None if log is None else open_log(log, FaultLog())
    entry = opened.manifest.log
    if reader is not None and not opened.manifest.redacted and reader.info.log_id != entry.log_id:
        raise ConfigError(f"{log}: isn't the log of {run}, which is '{entry.name}' with id {entry.log_id}")
    outcomes = outcomes_of(opened, options or ScoreOptions())
    return write_overlay(opened, outcomes, out, None if reader is None else reader.container)


def tables(runs: Sequence[Path | str], folder: Path) -> list[Path]:
    """Write every table of the report of runs as CSV, Parquet and Markdown into a folder, and return the paths. Raises
    ConfigError where there is no such run or nothing can be written; RunError where a run is damaged.
    """
    from fbench.reports.tables import write_tables

    return write_tables([open_folder(Path(run)) for run in runs], folder)
