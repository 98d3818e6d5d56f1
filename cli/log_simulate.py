"""`fbench log simulate`."""

import signal
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Option

from fbench.cli import options
from fbench.cli.progress import import_progress
from fbench.cli.show import print_json, say
from fbench.replay.contracts.errors import ConfigError, output_error
from fbench.replay.data.files import make_parent

if TYPE_CHECKING:
    from fbench.datasets.city.request import CityRequest, Split
    from fbench.datasets.city.spec import CitySpec
    from fbench.datasets.importing.run import ImportedLog

_SUITE, _TRAINING, _POINTS = "suite", "training", "training-points"


def simulate(
    world: Annotated[
        str,
        Argument(
            metavar="WORLD",
            help="urban or highway; suite: the fixed suite; training, training-points: for built-in detectors.",
        ),
    ],
    out: Annotated[
        Path, Option("--out", "-o", help="FILE.mcap or FOLDER.parquet; for a suite, the folder of its logs.")
    ],
    condition: Annotated[
        str,
        Option(metavar="NAME", help="clear, traffic, rain, heavy-rain, fog, night ..., or a combination: rain+night."),
    ] = "clear",
    seconds: Annotated[float, Option(metavar="S", help="Length of the log, in s.")] = 10.0,
    seed: Annotated[int, Option(metavar="N", help="Random seed. Equal seeds give equal bytes.")] = 0,
    split: Annotated[
        Literal["dev", "test"] | None, Option(help="Seeds of a suite: 'dev' to develop on (default), 'test' to report.")
    ] = None,
    rig: Annotated[
        Path | None, Option(metavar="FILE", help="TOML with the sensors (default: the thesis's rig).")
    ] = None,
    sensors: Annotated[
        list[str] | None, Option(metavar="PATTERN", help="Only these sensors ('!PATTERN' excludes); repeatable.")
    ] = None,
    settings: Annotated[
        list[str] | None, Option("--set", metavar="NAME=VALUE", help="Change a sensor or the weather; repeatable.")
    ] = None,
    threads: Annotated[
        int | None, Option(metavar="N", min=1, max=256, help="Number of threads; the output doesn't depend on it.")
    ] = None,
    form: Annotated[Literal["mcap", "parquet"] | None, Option(help="Format of a suite's logs (default: mcap).")] = None,
    overwrite: Annotated[bool, Option("--overwrite", help="Replace existing logs.")] = False,
    json: options.Json = False,
) -> None:
    """Simulate a drive through a city or along a highway, with every sensor and perfect truth."""
    from fbench.cli.import_lines import log_line
    from fbench.datasets.city.recording import CityRecording
    from fbench.datasets.city.request import CityRequest, split_setting
    from fbench.datasets.city.rig import WEATHER
    from fbench.datasets.importing.run import write_recording
    from fbench.replay.logs.convert.target import Target

    request = CityRequest(world, condition, seconds, seed, rig, tuple(sensors or ()), tuple(settings or ()))
    if world in (_SUITE, _TRAINING, _POINTS):
        specs = _suite_specs(request, split) if world == _SUITE else _training_specs(request, split)
        try:
            out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise output_error(out, error) from error
        wanted = [(spec, Target(out / f"{name}.{form or 'mcap'}", overwrite)) for spec, name in specs]
    else:
        if split is not None or form is not None:
            raise ConfigError(
                f"{'--form' if split is None else '--split'} is only for a suite; for one log, use --seed and --out"
            )
        wanted = [(request.spec(), Target(out, overwrite))]
        make_parent(out)
        wanted[0][1].form  # noqa: B018  # refuses a name without a form before anything is made
    used = (WEATHER, *wanted[0][0].rig.names)
    idle = [(setting, name) for setting in request.settings if (name := split_setting(setting)[0]) not in used]
    sys.stderr.writelines(f"note: --set {s} changes nothing: --sensors leaves '{name}' out\n" for s, name in idle)
    done: list[ImportedLog] = []
    try:
        with import_progress(len(wanted)) as progress:
            for spec, target in wanted:
                log = write_recording(CityRecording(spec, target.path.stem, threads), target, progress)
                done.append(log)
                with progress.finish(0 if log.written is None else log.written.num_messages):
                    if not json:
                        say(*log.lines, f"log: {log_line(log)}")
    except KeyboardInterrupt:
        num = sum(log.state == "written" for log in done)
        written = f"{num} of {len(wanted)} logs written" if num else "nothing written"
        sys.stderr.write(f"fbench: interrupted; {written}\n")
        raise typer.Exit(128 + signal.SIGINT) from None
    if json:
        print_json({"logs": [_content(spec, log) for (spec, _), log in zip(wanted, done, strict=True)]})


def _suite_specs(request: "CityRequest", split: "Split | None") -> list[tuple["CitySpec", str]]:
    from fbench.datasets.city.request import SEEDS, SUITE

    for is_default, option in ((request.condition == "clear", "--condition"), (request.seed == 0, "--seed")):
        if not is_default:
            raise ConfigError(f"{option}: not for the suite, which has its own; choose seeds with --split dev or test")
    return [
        (replace(request, world=scene.world, condition=scene.condition, seed=seed).spec(), scene.name(seed))
        for scene in SUITE
        for seed in SEEDS[split or "dev"]
    ]


def _training_specs(request: "CityRequest", split: "Split | None") -> list[tuple["CitySpec", str]]:
    from fbench.datasets.city.request import CityRequest, point_training_logs, training_logs

    if request != CityRequest(request.world) or split is not None:
        raise ConfigError(f"{request.world}: these logs are fixed; use only --out, --form, --threads and --overwrite")
    logs = training_logs() if request.world == _TRAINING else point_training_logs()
    return [(spec, name) for name, spec in logs]


def _content(spec: "CitySpec", log: "ImportedLog") -> dict[str, object]:
    written = log.written
    return {
        "path": str(log.path), "state": log.state, "log_id": spec.log_id, "world": spec.world,
        "condition": spec.condition.name, "seed": spec.seed, "seconds": spec.seconds,
        "bytes": None if written is None else written.num_bytes,
        "messages": {} if written is None else dict(written.messages), "summary": list(log.lines),
    }  # fmt: skip
