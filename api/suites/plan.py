"""The cells of a suite file."""

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from glob import glob, has_magic
from itertools import product
from pathlib import Path
from typing import TypeVar

from fbench.api.replays import short_name
from fbench.api.suites.file import LogTable, PipelineTable, Place, ReplayTable, SuiteText, field_names
from fbench.api.suites.logs import Drive
from fbench.api.suites.store import find_logs, is_url, log_place
from fbench.api.suites.suite import LOGS, Suite, SuiteLog, SuitePipeline
from fbench.metrics.profiles.choose import choose_profile
from fbench.replay.conditions.spec import CLEAR, has_strength, parse_conditions
from fbench.replay.contracts.errors import ConfigError, FbenchError, LogError, did_you_mean
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.plugins import pipeline_parameters
from fbench.replay.contracts.sensor_settings import make_sensors
from fbench.replay.data.files import file_name
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.engine.clock import make_clock
from fbench.replay.engine.service_queue import PROFILE, make_latency
from fbench.replay.logs.open import open_container
from fbench.replay.logs.setup import BoxSource
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import NO_CONFIG, LogRequest, log_source

T = TypeVar("T")
_NAME = re.compile(r"[A-Za-z0-9][\w.+-]{0,99}")
_SEVERITY = "3"
_NO_LOG = "LOG001"
_OPTION = re.compile(r"(?:--([a-z-]+) )?(.*)", re.DOTALL)  # What an error of the command line begins with


def read_suite(path: Path, out: Path | None = None) -> Suite:
    """Read a suite file; `out` is the suite's folder, `runs/NAME` by default. Raises ConfigError with file, line and
    key of what isn't as expected.
    """
    return make_suite(SuiteText.read(path), path.parent, out or Path("runs") / file_name(path.stem))


def make_suite(text: SuiteText, beside: Path, out: Path) -> Suite:
    """Return what a suite file asks for, whose relative paths begin in the folder `beside`. Raises ConfigError as
    `read_suite` does.
    """
    file = text.file
    logs = list(_logs(text, beside, out))
    pipelines = list(_pipelines(text, beside))
    conditions = _conditions(text, beside)
    for number, rate in enumerate(file.rates):
        with _Place(text, ("rates", number)):
            make_clock(rate, 0)
    for number, profile in enumerate(file.scoring.profiles):
        with _Place(text, ("scoring", "profiles", number)):
            choose_profile(profile, None)
    _require_unique(text, ("rates",), [rate if rate == "max" else float(rate) for rate in file.rates])
    _require_unique(text, ("seeds",), file.seeds)
    _require_unique(text, ("scoring", "profiles"), file.scoring.profiles)
    given, scoring = file.replay, file.scoring
    latency = given.latency
    if latency and latency.startswith(PROFILE):
        latency = PROFILE + os.path.join(beside, latency.removeprefix(PROFILE))
    for rate in file.rates:
        with _Place(text, ("replay", "latency")):
            make_latency(latency, None, make_clock(rate, 0).rate)
        with _Place(text, ("replay", "overload")):
            make_latency(latency, given.overload, None)
    options = ReplayRequest(
        logs[0].request, pipelines[0].base, reference=given.reference, timeout_ms=given.timeout_ms,
        tolerance_ms=given.tolerance_ms, max_gap_s=given.max_gap_s, offset=given.offset, stamps=given.stamps,
        from_=given.from_, to=given.to, frames=given.frames, interpolate_truth_ms=given.interpolate_truth_ms,
        latency=latency, overload=given.overload,
        on_fault=given.on_fault, fault_budget=given.fault_budget, overwrite=True, no_media=not given.media,
        scoring=ScoreOptions(
            scoring.range_m, scoring.in_view, scoring.distance_m, scoring.iou, tuple(scoring.regions), scoring.seen,
            tuple(scoring.cameras),
        ),
    )  # fmt: skip
    suite = Suite(
        file.title, logs, pipelines, conditions, file.rates, file.seeds, options, file.scoring.profiles, out,
        text.content, text.where, {str(log.request.path.absolute()): log.url for log in logs if log.url},
    )  # fmt: skip
    checked: list[tuple[object, ...]] = []
    for log in logs:
        one = log.request.config or log.request.path, *log.request.rig
        if one not in checked:
            checked.append(one)
            with _Place(text, log.place):
                replace(options, log=log.request).resolve()
    _require_regions(text, logs)
    _require_cameras(text, logs)
    return suite


class _Place:
    """Adds file, line and key to errors inside a `with` block; options of a replay have a key of their own."""

    def __init__(self, text: SuiteText, place: Place) -> None:
        self._text, self._place = text, place

    def __enter__(self) -> None: ...

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if isinstance(error, OSError):
            raise self._text.error(self._place, f"can't be read ({error.strerror})") from error
        if isinstance(error, FbenchError):
            option, shown = _OPTION.fullmatch(str(error)).groups()  # type: ignore[union-attr]  # fits any text
            key = (option or "").replace("-", "_")
            known = [name for name in field_names(ReplayTable) if key and name.startswith(key)]
            raise self._text.error(("replay", known[0]) if known else self._place, shown) from error


def _logs(text: SuiteText, beside: Path, out: Path) -> Iterator[SuiteLog]:
    names: dict[str, SuiteLog] = {}
    paths: set[str] = set()
    for number, entry in enumerate(text.file.logs):
        place: Place = ("logs", number)
        table = LogTable(path=entry) if isinstance(entry, str) else entry
        if (table.path is None) == (table.simulate is None):
            raise text.error(place, "expected either path or simulate")
        is_recorded = table.path is not None
        found = _open_recorded(text, place, table, beside) if is_recorded else _plan_simulated(text, place, table, out)
        for log in found:
            if not _NAME.fullmatch(log.name):
                what = "expected letters, digits and '_.+-' between them, as it names a folder"
                raise text.error((*place, "name"), f"'{log.name}' can't be a name: {what}")
            path = log.url or str(log.request.path.resolve())
            other = names.setdefault(log.name, log)
            if log == other is not log or (path in paths and log.drive is None):
                raise text.error(place, f"'{log.name}' is listed twice")
            if other is not log:
                raise text.error(place, f"two logs are called '{log.name}'; give one a name")
            paths.add(path)
            yield replace(log, place=place)


def _open_recorded(text: SuiteText, place: Place, table: LogTable, beside: Path) -> Iterator[SuiteLog]:
    given = table.path or ""
    for key in ("condition", "seconds", "seed", "sensors", "set"):
        if key in table.model_fields_set:
            raise text.error((*place, key), "is for a simulated log")
    where = (*place, "path")
    with _Place(text, where):
        urls = find_logs(given) if is_url(given) else []
    paths = [log_place(url) for url in urls]
    if not urls:
        pattern = str(beside / given)
        paths = [Path(one) for one in sorted(glob(pattern, recursive=True))] if has_magic(given) else [Path(pattern)]
        if not paths:
            raise text.error(where, f"no such log: {given}")
        _require_there(text, where, paths[0], f"no such log: {given}")
    if table.name is not None and len(paths) > 1:
        raise text.error((*place, "name"), f"the pattern fits {len(paths)} logs, which can't all have one name")
    truth = _open_truth(text, place, table, beside)
    files: list[tuple[Place, str | None]] = [(("config",), None if table.config == NO_CONFIG else table.config)]
    files += [(("rig", at), file) for at, file in enumerate(table.rig)]
    for own, file in files:
        if file is not None:
            _require_file(text, (*place, *own), beside / file, file)
    config = None if table.config is None else NO_CONFIG if table.config == NO_CONFIG else str(beside / table.config)
    rig = [beside / file for file in table.rig]
    for path, url in zip(paths, urls or [""] * len(paths), strict=True):
        if not url:
            _require_log(text, where, path)
        name = file_name(path.stem).strip("_.-") if table.name is None else table.name
        request = LogRequest(path, NO_CONFIG if url else config, rig, truth, topics=text.file.replay.topics)
        yield SuiteLog(name, request, url)


def _open_truth(text: SuiteText, place: Place, table: LogTable, beside: Path) -> BoxSource | None:
    if table.truth_format is not None:
        from fbench.replay.formats.open import FORMATS

        where = (*place, "truth_format")
        if table.truth is None:
            raise text.error(where, "goes with truth")
        if table.truth_format not in FORMATS:
            raise text.error(where, f"'{table.truth_format}' isn't a format{did_you_mean(table.truth_format, FORMATS)}")
    if table.truth is None:
        return None
    from fbench.replay.formats.open import form_of

    source = BoxSource(beside / table.truth, table.truth_format)
    _require_there(text, (*place, "truth"), source.path, f"no such file: {table.truth}")
    with _Place(text, (*place, "truth")):
        form_of(source)
    return source


def _require_there(text: SuiteText, place: Place, path: Path, what: str) -> None:
    with _Place(text, place):
        if not path.exists():
            raise ConfigError(what)


def _require_file(text: SuiteText, place: Place, path: Path, name: str) -> None:
    _require_there(text, place, path, f"no such file: {name}")
    if not path.is_file():  # a FIFO would block
        raise text.error(place, f"not a file: {name}")


def _require_log(text: SuiteText, place: Place, path: Path) -> None:
    """Refuse what is no log at all; one that is damaged fails as a cell, so that the others run."""
    with _Place(text, place):
        try:
            open_container(path, FaultLog())
        except LogError as error:
            if error.code == _NO_LOG:
                raise


def _require_regions(text: SuiteText, logs: Sequence[SuiteLog]) -> None:
    """Refuse kinds of regions that none of the recorded logs has, where all logs are."""
    kinds = text.file.scoring.regions
    if not kinds or any(log.url or log.drive for log in logs):
        return
    known: dict[str, None] = {}
    for log in logs:
        with _Place(text, log.place), suppress(LogError):  # of a damaged one the cell will say so
            regions = log_source(log.request).open(FaultLog()).info.regions
            known |= dict.fromkeys(region.kind for region in regions)
    for number, kind in enumerate(kinds):
        if kind not in known:
            raise text.error(("scoring", "regions", number), f"no log has a region '{kind}'{did_you_mean(kind, known)}")


def _require_cameras(text: SuiteText, logs: Sequence[SuiteLog]) -> None:
    """Refuse cameras to score that none of the logs has, where all logs are."""
    cameras = text.file.scoring.cameras
    if not cameras or any(log.url for log in logs):
        return
    known: dict[str, None] = {}
    for log in logs:
        with _Place(text, log.place), suppress(LogError):
            rig = log_source(log.request).open(FaultLog()).rig if log.drive is None else log.drive.spec.rig.rig()
            known |= dict.fromkeys(rig.sensors("camera"))
    for number, name in enumerate(cameras):
        if name not in known:
            raise text.error(("scoring", "cameras", number), f"no log has a camera '{name}'{did_you_mean(name, known)}")


def _plan_simulated(text: SuiteText, place: Place, table: LogTable, out: Path) -> Iterator[SuiteLog]:
    from fbench.datasets.city.request import CityRequest

    for key in ("config", "truth", "truth_format", "rig"):
        if key in table.model_fields_set:
            raise text.error((*place, key), "is for a recorded log")
    every = list(product(_as_list(table.simulate or ""), _as_list(table.seed), _as_list(table.condition)))
    if table.name is not None and len(every) > 1:
        raise text.error((*place, "name"), f"{len(every)} logs can't all have one name")
    for world, seed, condition in every:
        with _Place(text, place):
            request = CityRequest(world, condition, table.seconds, seed, None, table.sensors, table.set)
            drive = Drive(request.spec(), Path())
        name = table.name or drive.name
        path = out / LOGS / f"{name}.mcap"
        yield SuiteLog(
            name, LogRequest(path, NO_CONFIG, topics=text.file.replay.topics), drive=replace(drive, log=path)
        )


def _as_list(value: T | list[T]) -> list[T]:
    return value if isinstance(value, list) else [value]


def _pipelines(text: SuiteText, beside: Path) -> Iterator[SuitePipeline]:
    given = text.file.pipelines
    named: list[tuple[str, PipelineTable, Place]] = []
    if isinstance(given, dict):
        for name, entry in given.items():
            table = PipelineTable(base=entry) if isinstance(entry, str) else entry
            named.append((name, table, ("pipelines", name)))
    else:
        for number, base in enumerate(given):
            with _Place(text, ("pipelines", number)):
                named.append((short_name(_file_beside(base, beside)), PipelineTable(base=base), ("pipelines", number)))
    seen: set[str] = set()
    for name, table, place in named:
        if not _NAME.fullmatch(name):
            what = "expected letters, digits and '_.+-' between them, as it names a folder"
            raise text.error(place, f"'{name}' can't be a name: {what}")
        if name in seen:
            raise text.error(place, f"'{name}' is listed twice")
        seen.add(name)
        base = _file_beside(table.base or name, beside)
        with _Place(text, place):
            known = pipeline_parameters(base, [])
            if table.detect_every is not None and "detect_every" not in known:
                raise ConfigError("this pipeline has no parameter detect_every")
            make_sensors(table.sensors)
        with _Place(text, (*place, "set")):
            pipeline_parameters(base, table.set)
        yield SuitePipeline(name, base, tuple(table.set), tuple(table.sensors), table.detect_every)


def _file_beside(name: str, beside: Path) -> str:
    """A pipeline or condition whose file lies beside the suite's."""
    is_file = name.endswith(".toml") or (".py:" in name and not name.startswith("exec:"))
    return os.path.join(beside, name) if is_file else name  # keeps what follows the colon


def _conditions(text: SuiteText, beside: Path) -> dict[str, str]:
    """What replays take, by the name with the severity: empty for `clear`."""
    found: dict[str, str] = {}
    severities = [str(number) for number in text.file.severities] or [_SEVERITY]
    _require_unique(text, ("severities",), text.file.severities)
    for number, given in enumerate(text.file.conditions):
        place: Place = ("conditions", number)
        with _Place(text, place):
            if given == CLEAR:
                every = {CLEAR: ""}
            elif has_strength(given):
                every = {given: _file_beside(given, beside)}
            else:
                every = {"+".join(f"{part.strip()}:{own}" for part in given.split("+")): "" for own in severities}
                every = {name: _file_beside(name, beside) for name in every}
            for name, condition in every.items():
                parts = parse_conditions(condition)
                if not parts and name != CLEAR:
                    raise ConfigError(f"'{name}' changes nothing; write '{CLEAR}'")
                if name in found:
                    raise ConfigError(f"'{name}' is listed twice")
                found[name] = condition
    return found


def _require_unique(text: SuiteText, place: Place, values: Sequence[object]) -> None:
    for number, value in enumerate(values):
        if value in values[:number]:
            raise text.error((*place, number), f"{value} is listed twice")
