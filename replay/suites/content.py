"""What a run is made of: equal content gives an equal run, so it needs no other replay."""

import inspect
import json
from collections.abc import Callable
from functools import cache
from hashlib import blake2b
from importlib.util import find_spec
from pathlib import Path

from pydantic import TypeAdapter

from fbench.replay.boxfiles.digest import digest_of
from fbench.replay.config.source import log_source
from fbench.replay.host import describe_host, package_versions
from fbench.replay.plugins import pipeline_class, pipeline_parameters
from fbench.replay.protocols import KeepsStderr
from fbench.replay.scores import ScoreOptions
from fbench.replay.suites.cell import Cell
from fbench.replay.variants import sensors_of

FORMAT = 1
"""Of what is written about a run's content; another number replays all."""
_OWN = "fbench"
_PACKAGES = ("fbench.replay", "fbench.pipelines", "fbench.metrics")
"""Those that decide what is in a run folder; weights inside them count, too."""
_OPTIONS = TypeAdapter(ScoreOptions)

Content = dict[str, object]


class Contents:
    """Tells what cells are made of; looks at each log, and at the code, once."""

    def __init__(self) -> None:
        self._digest_of: Callable[[Path], str] = cache(digest_of)
        self._package_of: Callable[[str], str] = cache(self._package)
        self._around: Content = {
            "code": {name: self._package(name) for name in _PACKAGES},
            "versions": package_versions(),
            "cpu": describe_host()["cpu"],
        }

    def of(self, cell: Cell) -> Content | None:
        """Return all that decides a cell's run, JSON-ready; `None` where nobody can tell: a pipeline that is a
        program may give something else each time.

        Raises:
            FbenchError: where log, pipeline or parameters can't be used.
        """
        cls = pipeline_class(cell.pipeline)
        if isinstance(cls, KeepsStderr):
            return None
        return {
            "format": FORMAT,
            "log": self._digest_of(cell.log.log),
            **self._beside(cell),
            "pipeline": cell.pipeline,
            "source": self._source(cls),
            "parameters": pipeline_parameters(cell.pipeline, cell.settings),
            "sensors": sensors_of(cell.pipeline, ()),
            "scoring": _OPTIONS.dump_python(cell.scoring, mode="json"),
            "media": cell.media,
            **self._around,
        }

    def _beside(self, cell: Cell) -> Content:
        """Files beside the log, and which of its topics are read."""
        source = log_source(cell.log)
        truth = source.truth_entry()
        return {
            "topics": list(cell.log.topics),
            "inputs": [entry.model_dump() for entry in source.used()],
            "truth": None if truth is None else truth.model_dump(),
        }

    def _source(self, cls: type) -> str:
        """Digest of the package that holds the class, or of its file; it may be anybody's."""
        package = cls.__module__.partition(".")[0]
        if package == _OWN:
            return ""  # counts already
        file = Path(inspect.getfile(cls))
        is_alone = "." not in cls.__module__ and file.name != "__init__.py"
        return self._digest_of(file) if is_alone else self._package_of(package)

    @staticmethod
    def _package(package: str) -> str:
        spec = find_spec(package)
        places = [] if spec is None or spec.submodule_search_locations is None else spec.submodule_search_locations
        whole = blake2b(digest_size=16)
        for folder in map(Path, places):
            # Without what Python compiles and others write while we look.
            for name in sorted(file.relative_to(folder) for file in folder.rglob("*") if file.is_file()):
                if "__pycache__" not in name.parts:
                    whole.update(f"{name.as_posix()}\n{digest_of(folder / name)}\n".encode())
        return whole.hexdigest()


def key_of(content: Content) -> str:
    """Return the digest of a content."""
    text = json.dumps(content, sort_keys=True, allow_nan=False)
    return blake2b(text.encode("utf-8", "surrogatepass"), digest_size=16).hexdigest()
