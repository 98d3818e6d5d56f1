"""One simulation from the command line: logs, and the summary."""

import signal
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import typer

from fbench.cli.import_job import log_line
from fbench.cli.show import console, import_progress, print_json
from fbench.datasets.importing.run import ImportedLog, write_recording
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.logs.convert.target import Target

if TYPE_CHECKING:
    from fbench.datasets.city.request import CityRequest, Split
    from fbench.datasets.city.spec import CitySpec

_SUITE, _TRAINING = "suite", "training"
_NOT_OF_A_SUITE = (("condition", "clear", "--condition"), ("seed", 0, "--seed"))


@dataclass(frozen=True)
class SimulateJob:
    """Everything that `fbench log simulate` was asked for."""

    wish: "CityRequest"
    out: Path
    split: "Split | None" = None  # Of a suite; `dev` unless said otherwise
    threads: int | None = None
    form: Literal["mcap", "parquet"] | None = None  # Of a suite's logs; `mcap` unless said otherwise
    overwrite: bool = False
    as_json: bool = False


def run_simulation(job: SimulateJob) -> None:
    """Simulate, and print what was made. Raises ConfigError where something asked for isn't there, or the log can't or
    mustn't be written.
    """
    wanted = _wanted(job)
    _warn_of_idle(job.wish.settings, wanted[0][0])
    done: list[ImportedLog] = []
    try:
        _simulate(job, wanted, done)
    except KeyboardInterrupt:
        num = sum(log.state == "written" for log in done)
        written = f"{num} of {len(wanted)} logs written" if num else "nothing written"
        sys.stderr.write(f"fbench: interrupted; {written}\n")
        raise typer.Exit(128 + signal.SIGINT) from None
    if job.as_json:
        print_json({"logs": [_content(spec, log) for (spec, _), log in zip(wanted, done, strict=True)]})


def _wanted(job: SimulateJob) -> list[tuple["CitySpec", Path]]:
    if job.wish.world == _SUITE:
        return list(_suite_logs(job))
    return list(_training_logs(job)) if job.wish.world == _TRAINING else [_one_log(job)]


def _simulate(job: SimulateJob, wanted: Sequence[tuple["CitySpec", Path]], done: list[ImportedLog]) -> None:
    """Write all logs that are wanted, and put each that is whole into `done`."""
    from fbench.datasets.city.recording import CityRecording

    with import_progress(len(wanted)) as progress:
        for spec, path in wanted:
            target = Target(path, job.overwrite)
            log = write_recording(CityRecording(spec, path.stem, job.threads), target, progress)
            done.append(log)
            with progress.finished(0 if log.written is None else sum(log.written.messages.values())):
                if not job.as_json:
                    _print(log)


def _warn_of_idle(settings: Sequence[str], spec: "CitySpec") -> None:
    """Say which settings change nothing, as their sensor isn't simulated."""
    from fbench.datasets.city.request import split_setting
    from fbench.datasets.city.rig import WEATHER

    for setting in settings:
        name, _, _ = split_setting(setting)
        if name not in (WEATHER, *spec.rig.names):
            sys.stderr.write(f"note: --set {setting} changes nothing: --sensors leaves '{name}' out\n")


def _one_log(job: SimulateJob) -> tuple["CitySpec", Path]:
    if job.split is not None or job.form is not None:
        raise ConfigError(
            f"{'--form' if job.split is None else '--split'}: only of a suite; here --seed and --out say it"
        )
    spec = job.wish.spec()
    if not job.out.absolute().parent.is_dir():
        raise ConfigError(f"{job.out}: can't be written (no folder {job.out.absolute().parent})")
    Target(job.out, job.overwrite).form  # noqa: B018  # refuses a name without a form before anything is made
    return spec, job.out


def _suite_logs(job: SimulateJob) -> Iterator[tuple["CitySpec", Path]]:
    from fbench.datasets.city.request import SEEDS, SUITE

    for field, default, option in _NOT_OF_A_SUITE:
        if getattr(job.wish, field) != default:
            raise ConfigError(f"{option}: the suite has its own; choose seeds with --split dev or test")
    specs = [
        (replace(job.wish, world=scene.world, condition=scene.condition, seed=seed).spec(), scene.name(seed))
        for scene in SUITE
        for seed in SEEDS[job.split or "dev"]
    ]
    yield from _in_folder(job, specs)


def _training_logs(job: SimulateJob) -> Iterator[tuple["CitySpec", Path]]:
    from fbench.datasets.city.request import CityRequest, training_logs

    if job.wish != CityRequest(_TRAINING) or job.split is not None:
        raise ConfigError("training: these logs are fixed; of the options only --out, --form, --threads, --overwrite")
    yield from _in_folder(job, [(spec, name) for name, spec in training_logs()])


def _in_folder(job: SimulateJob, specs: Sequence[tuple["CitySpec", str]]) -> Iterator[tuple["CitySpec", Path]]:
    try:
        job.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{job.out}: can't be written ({error.strerror})") from error
    yield from ((spec, job.out / f"{name}.{job.form or 'mcap'}") for spec, name in specs)


def _content(spec: "CitySpec", log: ImportedLog) -> dict[str, object]:
    written = log.written
    return {
        "path": str(log.path), "state": log.state, "log_id": spec.log_id, "world": spec.world,
        "condition": spec.condition.name, "seed": spec.seed, "seconds": spec.seconds,
        "bytes": None if written is None else written.num_bytes,
        "messages": {} if written is None else dict(written.messages), "summary": list(log.lines),
    }  # fmt: skip


def _print(log: ImportedLog) -> None:
    for line in (*log.lines, f"log: {log_line(log)}"):
        console().print(line, markup=False, soft_wrap=True)
