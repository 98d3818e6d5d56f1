"""`fbench robust`: how much weather, faults and late messages cost pipelines, on any log."""

import json as json_
import os
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Option

from fbench.cli import options
from fbench.cli.progress import replay_progress
from fbench.cli.show import print_json, say, show_results
from fbench.replay.contracts.errors import EXIT_LOSSY, EXIT_OK, ConfigError
from fbench.replay.runs.secrets import without_secrets

if TYPE_CHECKING:
    from fbench.api.robust import RobustCell, RobustSuite
    from fbench.api.suites.cells import CellResult
    from fbench.replay.data.scores import Results

_NAMED_APART = ("logs", "pipelines", "suite", "out", "jobs", "json")


def robust(
    context: typer.Context,
    logs: Annotated[list[Path], Argument(metavar="LOG...", help="Logs with ground truth.", show_default=False)],
    pipelines: Annotated[
        list[str], Option("--pipeline", "-p", metavar="NAME[,NAME]", help="Pipelines; repeatable.", show_default=False)
    ],
    suite: Annotated[
        Literal["thesis", "weather", "faults", "timing", "all"] | None,
        Option(help="Conditions to run (default: thesis, unless --condition names some)."),
    ] = None,
    condition: Annotated[
        list[str] | None,
        Option(metavar="NAME", help="A condition, such as fog or dropout.radar:2; repeatable; see fbench plugins."),
    ] = None,
    severity: Annotated[
        str, Option(metavar="S", help="Severities of conditions without one: 1-5, 3, or 1,3,5.")
    ] = "1-5",
    seed: options.Seed = 0,
    baseline: Annotated[
        str | None, Option(metavar="NAME", help="Pipeline that mCE and mRRA compare with (default: the first).")
    ] = None,
    settings: options.Settings = None,
    sensors: options.Sensors = None,
    config: options.Config = None,
    rig: options.RigFiles = None,
    decoder: options.Decoders = None,
    truth: options.TruthFile = None,
    truth_format: options.TruthFormat = None,
    truth_frame: options.TruthFrame = "",
    interpolate_truth_ms: options.InterpolateTruthMs = 0.0,
    from_: options.From = None,
    to: options.To = None,
    frames: options.Frames = None,
    range_m: options.RangeM = 50.0,
    in_view: options.InView = True,
    distance_m: options.DistanceM = 2.0,
    iou: options.Iou = 0.5,
    out: Annotated[Path, Option("--out", "-o", help="Folder for runs, tables and the report.")] = Path("runs/robust"),
    jobs: options.Jobs = None,
    device: options.Device = "cpu",
    json: options.Json = False,
) -> None:
    """Replay logs under conditions, and print what each costs each pipeline.

    Cells that exist already aren't replayed again.
    """
    from fbench.api.robust import RobustSuite, fitting_settings, parse_severities, suite_conditions
    from fbench.replay.data.scores import ScoreOptions
    from fbench.replay.setup.request import ReplayRequest, choose_pipeline
    from fbench.replay.setup.source import LogRequest

    names = [choose_pipeline(name.strip(), None) for text in pipelines for name in text.split(",")]
    asked = tuple(condition or ())
    chosen = suite or (None if asked else "thesis")
    wanted = list(dict.fromkeys([*(suite_conditions(chosen) if chosen else ()), *asked]))
    if baseline is not None and baseline not in names:
        raise ConfigError(f"--baseline {baseline}: isn't among the pipelines: {', '.join(names)}")
    own_settings = fitting_settings(names, settings or ())
    boxes = options.box_source(truth, truth_format, truth_frame)
    requests = [
        ReplayRequest(
            LogRequest(log, config, rig or (), boxes, decoder=decoder or ()), name, settings=own_settings[name],
            sensors=sensors or (), from_=from_, to=to, frames=frames, interpolate_truth_ms=interpolate_truth_ms,
            seed=seed, device=device, on_fault="tolerant", scoring=ScoreOptions(range_m, in_view, distance_m, iou),
        )
        for log in logs for name in dict.fromkeys(names)
    ]  # fmt: skip
    what = RobustSuite(
        requests, wanted, parse_severities(severity), out, _command(context, logs, names, chosen),
        baseline or (names[0] if len(set(names)) > 1 else None), asked,
    )  # fmt: skip
    raise typer.Exit(_run(what, jobs or len(os.sched_getaffinity(0)), json))


def _command(context: typer.Context, logs: list[Path], pipelines: list[str], suite: str | None) -> str:
    """The command without what changes no result: where logs and files lie, where it writes, how many processes."""
    words = ["fbench", "robust", *(log.name for log in logs), "-p", ",".join(pipelines)]
    words += ["--suite", suite] if suite else []
    for option in context.command.params:
        name, value = str(option.name), context.params.get(str(option.name))
        is_given = str(context.get_parameter_source(name)).endswith("COMMANDLINE")
        if name in _NAMED_APART or not (is_given or name in ("severity", "seed")):
            continue
        switch = option.opts[0] if value is not False else option.secondary_opts[0]
        for one in value if isinstance(value, tuple | list) else [value]:
            words += [switch] if isinstance(one, bool) else [switch, one.name if isinstance(one, Path) else str(one)]
    return without_secrets(shlex.join(words))


def _run(what: "RobustSuite", num_jobs: int, json: bool) -> int:
    """Replay what isn't there, print and write the results, and return the exit code."""
    from fbench.api.robust import is_lossy, results_of
    from fbench.api.suites.run import run_suite
    from fbench.api.suites.runner import RunOptions
    from fbench.datasets.importing.run import claim

    cells = list(what.cells())
    try:
        what.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{what.folder}: can't be written ({error.strerror}); choose another with --out") from error
    try:
        with claim(what.folder / "robust", lambda: say("waiting for another fbench robust in this folder")):
            with replay_progress("replays") as progress:
                found = run_suite([cell.request for cell in cells], RunOptions(num_jobs), progress)
            done = list(zip(cells, found, strict=True))
            results = results_of(what, done)
            paths = _write(what, results, done)
    except KeyboardInterrupt:
        sys.stderr.write("fbench: interrupted; finished work is kept, and the same command continues from there\n")
        raise
    if json:
        print_json(_content(what, results, done))
    else:
        show_results(results)
        num = {state: sum(result.state == state for result in found) for state in ("there", "replayed")}
        total = f"{num['there'] + num['replayed']} of {len(found)}"
        say(f"runs: {total} ({num['replayed']} replayed, {num['there']} there already)")
        say(*(f"{path.stem}: {path}" for path in paths))
    return EXIT_LOSSY if is_lossy(done) else EXIT_OK


def _content(what: "RobustSuite", results: "Results", done: "list[tuple[RobustCell, CellResult]]") -> dict[str, object]:
    from fbench.replay.data.scores import curve_rows, table_rows
    from fbench.replay.runs.folder import Run

    runs = []
    for cell, result in done:
        run = Run(result.folder) if result.has_run else None
        runs.append({
            "log": cell.log, "pipeline": cell.request.pipeline, "condition": cell.condition, "severity": cell.severity,
            "run": result.folder.relative_to(what.folder).as_posix(), "reason": result.reason,
            "digest": run.manifest.digest if run else None, "effects": run.manifest.effects if run else {},
        })  # fmt: skip
    tables = {table.name: table_rows(table) for table in results.tables}
    tables["severity_curves"] = [row for curves in results.curves for row in curve_rows(curves)]
    return {"facts": dict(results.facts), "tables": tables, "problems": list(results.problems), "runs": runs}


def _write(what: "RobustSuite", results: "Results", done: "list[tuple[RobustCell, CellResult]]") -> list[Path]:
    """Write the results in every form, and return the paths worth naming."""
    from fbench.api.suites.tables import write_tables
    from fbench.replay.data.files import replace_text
    from fbench.replay.runs.folder import Run
    from fbench.reports.html.page import HtmlReport
    from fbench.reports.markdown import markdown

    folder, content = what.folder, _content(what, results, done)
    replace_text(folder / "results.json", json_.dumps(content, indent=1, allow_nan=False) + "\n")
    replace_text(folder / "results.md", markdown(results))
    named = [(cell.cell, result) for cell, result in done]
    write_tables(folder, named, what.requests[0].scoring)
    clear = [Run(result.folder) for cell, result in done if result.has_run and cell.condition == "clear"]
    if not clear:
        return [folder / "results.md"]
    HtmlReport().write_results(
        results, clear[: len({cell.request.pipeline for cell, _ in done})], folder / "report.html"
    )
    return [folder / "results.md", folder / "report.html"]
