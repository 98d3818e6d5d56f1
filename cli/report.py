"""`fbench report`."""

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option


def report(
    runs: Annotated[list[Path], Argument(metavar="RUN...", help="One or more run folders.")],
    out: Annotated[
        Path | None, Option("--out", "-o", help="The report (default: report.html in the first RUN).")
    ] = None,
    kind: Annotated[str, Option(help="Report plug-in to use.")] = "html",
    budget_mb: Annotated[
        float | None,
        Option(metavar="MB", help="Size that the report may have, in MB: frames with errors first (default: 25)."),
    ] = None,
    base: Annotated[
        Path | None,
        Option(metavar="BASE", help="Run or baseline file to compare one RUN with: the verdict comes first."),
    ] = None,
    overlay: Annotated[
        Path | None,
        Option(
            metavar="FILE.mcap", help="Also write the results of one RUN for Foxglove and Lichtblick, and a layout."
        ),
    ] = None,
    log: Annotated[
        Path | None,
        Option(
            metavar="LOG",
            help="The log that was replayed: copied into the overlay, and drawn in the sheet (or its folder).",
        ),
    ] = None,
    rerun: Annotated[
        Path | None, Option(metavar="FILE.rrd", help="Also write one RUN as a recording for the Rerun viewer.")
    ] = None,
    tables: Annotated[
        Path | None, Option(metavar="FOLDER", help="Also write every table as CSV, Parquet and Markdown.")
    ] = None,
    figures: Annotated[
        Path | None,
        Option(
            metavar="FOLDER", help="Also draw figures for papers as SVG and PNG; a folder of fbench robust may be RUN."
        ),
    ] = None,
    sheet: Annotated[
        Path | None,
        Option(metavar="FILE", help="Also draw one frame, pipelines by conditions (.png or .svg); also of a suite."),
    ] = None,
    frame: Annotated[
        int | None, Option(metavar="N", min=0, help="Frame of the sheet (default: the one with the most truth).")
    ] = None,
) -> None:
    """Write one self-contained report of one or several runs, and other forms of it."""
    from fbench.api import reports
    from fbench.api.runs import open_run
    from fbench.api.runs import report as write_report
    from fbench.cli.show import say
    from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK, ConfigError

    is_suite, num = reports.is_suite(runs), len(runs)
    of_run = any(path is not None for path in (overlay, rerun, out, base))
    others = "is a suite, which has its report; of it there are --tables, --figures and --sheet"
    wrong = (
        (overlay is not None and num > 1, f"--overlay shows the results of one RUN, not of {num}"),
        (rerun is not None and num > 1, f"--rerun shows one RUN, not {num}"),
        (
            log is not None and overlay is None and sheet is None,
            "--log goes with --overlay FILE.mcap, into which its messages are copied, or --sheet",
        ),
        (frame is not None and sheet is None, "--frame goes with --sheet FILE, which shows one frame"),
        (is_suite and (of_run or not (tables or figures or sheet)), f"{runs[0]}: {others}"),
    )
    for is_wrong, text in wrong:
        if is_wrong:
            raise ConfigError(text)
    if sheet is not None:
        from fbench.api import sheets

        planned = sheets.plan_sheet(sheets.SheetRequest(runs, sheet, frame, log))  # refuses before anything is written
    if not is_suite:
        say(f"report: {write_report(runs, out, kind, budget_mb, base)}")
    if overlay is not None:
        say(*(f"overlay: {path}" for path in reports.overlay(runs[0], overlay, log)))
    if rerun is not None:
        say(f"rerun: {reports.rerun_recording(runs[0], rerun)}")
    if tables is not None:
        say(f"tables: {tables} ({len(reports.tables(runs, tables))} files)")
    if figures is not None:
        say(f"figures: {figures} ({len(reports.figures(runs, figures))} files)")
    if sheet is not None:
        say(*sheets.describe(sheets.draw(planned), sheet))
    whole = is_suite or all(open_run(folder).complete for folder in runs)
    raise typer.Exit(EXIT_OK if whole else EXIT_LOSSY)
