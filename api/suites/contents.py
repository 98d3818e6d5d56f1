"""Content of a cell: all that decides its run, and the key that is made of it."""

import inspect
import json
from collections.abc import Callable
from functools import cache
from hashlib import blake2b
from importlib.util import find_spec
from pathlib import Path

from pydantic import TypeAdapter

from fbench.replay.conditions.spec import parse_conditions
from fbench.replay.contracts.plugins import parse_name, pipeline_class, pipeline_parameters
from fbench.replay.contracts.protocols import KeepsStderr
from fbench.replay.contracts.sensor_settings import make_sensors
from fbench.replay.contracts.variants import SUFFIX, sensors_of
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.engine.service_queue import MEASURED, PROFILE
from fbench.replay.formats.text import digest_of
from fbench.replay.runs.host import describe_cuda, describe_host
from fbench.replay.runs.manifest import package_versions
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import log_source

FORMAT = 1  # Of what is written about a run's content; another number replays all
_OWN = "fbench"
_OPTIONS_OF_RUN = (
    "detect_every", "reference", "timeout_ms", "tolerance_ms", "max_gap_s", "offset", "stamps", "from_", "to", "frames",
    "interpolate_truth_ms", "on_fault", "fault_budget", "redact", "seed",
)  # fmt: skip
"""Fields of a request that decide what its run holds, beside those that are digested."""
_OPTIONS_OF_LATENCY = ("latency", "overload", "rate")
_PACKAGES = ("fbench.replay", "fbench.pipelines", "fbench.metrics", "fbench.api", "fbench.cli")
"""Those that decide what is in a run folder; weights inside them count, too."""
_OPTIONS = TypeAdapter(ScoreOptions)

Content = dict[str, object]


class Contents:
    """Tells what cells are made of; looks at each log, and at the code, once."""

    def __init__(self) -> None:
        self._digest_of: Callable[[Path], str] = cache(digest_of)
        self._package_of: Callable[[str], str] = cache(_digest_package)
        self._parts: dict[str, Content | None] = {}
        self._around: Content = {**describe_code(), "cpu": describe_host()["cpu"]}

    def of(self, cell: ReplayRequest) -> Content | None:
        """Return all that decides a cell's run, JSON-ready; `None` where nobody can tell: a pipeline that is a program
        may give something else each time, as measured latency does, and a plug-in that is isolated isn't imported
        here. Raises FbenchError where log, pipeline or parameters can't be used.
        """
        if cell.latency == MEASURED:
            return None
        pipeline = self._part(self._pipeline, cell, (cell.pipeline, cell.settings, cell.sensors, cell.isolate))
        if pipeline is None:
            return None
        names = _OPTIONS_OF_RUN if cell.latency is None else (*_OPTIONS_OF_RUN, *_OPTIONS_OF_LATENCY)
        options = {name: getattr(cell, name) for name in names}
        if cell.latency and cell.latency.startswith(PROFILE):
            options["latency"] = PROFILE + self._digest_of(Path(cell.latency.removeprefix(PROFILE)))
        return {
            "format": FORMAT,
            **(self._part(self._log, cell, cell.log) or {}),
            **pipeline,
            **(self._part(self._conditions, cell, cell.condition) or {}),
            "options": options,
            "scoring": _OPTIONS.dump_python(cell.scoring, mode="json"),
            "media": not cell.no_media,
            **({} if cell.device == "cpu" else {"cuda": dict(describe_cuda())}),
            **self._around,
        }

    def _part(self, make: Callable[[ReplayRequest], Content | None], cell: ReplayRequest, of: object) -> Content | None:
        """What cells have in common, made once: to look for plug-ins takes longer than all else."""
        key = f"{make.__name__} {of!r}"
        if key not in self._parts:
            self._parts[key] = make(cell)
        return self._parts[key]

    def _log(self, cell: ReplayRequest) -> Content:
        source = log_source(cell.log)
        truth = source.truth_entry()
        return {
            "log": self._digest_of(cell.log.path),
            "topics": list(cell.log.topics),
            "inputs": [entry.model_dump() for entry in source.input_entries()],
            "truth": None if truth is None else truth.model_dump(),
        }

    def _pipeline(self, cell: ReplayRequest) -> Content | None:
        if cell.isolate or isinstance(cls := pipeline_class(cell.pipeline), KeepsStderr):
            return None
        return {
            "pipeline": _without_folder(cell.pipeline),
            "source": self._source(cls),
            "parameters": pipeline_parameters(cell.pipeline, list(cell.settings)),
            "sensors": sensors_of(cell.pipeline, make_sensors(cell.sensors)),
        }

    def _conditions(self, cell: ReplayRequest) -> Content:
        parts = parse_conditions(cell.condition)
        return {
            "conditions": [
                [part.id, dict(part.level), part.sensors, part.from_ns, part.to_ns, self._source(type(part.condition))]
                for part in parts
            ]
        }

    def _source(self, cls: type) -> str:
        """Digest of the package that holds the class, or of its file; it may be anybody's."""
        package = cls.__module__.partition(".")[0]
        if package == _OWN:
            return ""  # counts already
        file = Path(inspect.getfile(cls))
        is_alone = "." not in cls.__module__ and file.name != "__init__.py"
        return self._digest_of(file) if is_alone else self._package_of(package)


def _without_folder(pipeline: str) -> str:
    """A pipeline's name; which file it is counts by its content, not by where it lies."""
    name = parse_name(pipeline)
    if name.file is not None or pipeline.endswith(SUFFIX):
        return Path(pipeline).name
    return pipeline


def key_of(content: Content) -> str:
    """Return the digest of a content."""
    text = json.dumps(content, sort_keys=True, allow_nan=False)
    return blake2b(text.encode("utf-8", "surrogatepass"), digest_size=16).hexdigest()


def _digest_package(package: str) -> str:
    spec = find_spec(package)
    places = [] if spec is None or spec.submodule_search_locations is None else spec.submodule_search_locations
    whole = blake2b(digest_size=16)
    for folder in map(Path, places):
        # Without what Python compiles and others write while we look.
        for name in sorted(file.relative_to(folder) for file in folder.rglob("*") if file.is_file()):
            if "__pycache__" not in name.parts:
                whole.update(f"{name.as_posix()}\n{digest_of(folder / name)}\n".encode())
    return whole.hexdigest()


def describe_code() -> Content:
    """Return digests of fbench's own code, and the versions of what it stands on."""
    return {"code": {name: _digest_package(name) for name in _PACKAGES}, "versions": package_versions()}


@cache
def digest_code() -> str:
    """Return the digest of `describe_code`, as it was when it was first asked for."""
    return key_of(describe_code())
