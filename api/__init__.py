"""Entry points for programs and notebooks: plain functions with frozen requests; the command line calls the same.

Each loads what it needs when it is first asked for, so that scoring doesn't wait for suites, conditions and kernels.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from fbench.api.controls import estimate_by_controls
    from fbench.api.logs import OpenLog, SimulateRequest, open_log, simulate
    from fbench.api.profiles import ProfileRequest, RecordedProfile, profile
    from fbench.api.relations import Relations, check_relations
    from fbench.api.replays import replay, verify
    from fbench.api.runs import OpenRun, RunComparison, compare, open_run, report
    from fbench.api.scores import FileScoreRequest, Resampling, ScoreRequest, ScoreResult, score, score_files
    from fbench.api.suites.bench import BenchRequest, OpenSuite, bench
    from fbench.api.sweeps import RateSweep, SweepRequest, sweep
    from fbench.datasets.city.request import CityRequest
    from fbench.metrics.comparison.control import Controlled
    from fbench.replay.data.scores import ScoreOptions
    from fbench.replay.logs.setup import BoxSource
    from fbench.replay.setup.request import ReplayRequest
    from fbench.replay.setup.source import LogRequest

_HOMES = {
    "api.controls": ("estimate_by_controls",),
    "api.logs": ("OpenLog", "SimulateRequest", "open_log", "simulate"),
    "api.profiles": ("ProfileRequest", "RecordedProfile", "profile"),
    "api.relations": ("Relations", "check_relations"),
    "api.replays": ("replay", "verify"),
    "api.runs": ("OpenRun", "RunComparison", "compare", "open_run", "report"),
    "api.scores": ("FileScoreRequest", "Resampling", "ScoreRequest", "ScoreResult", "score", "score_files"),
    "api.suites.bench": ("BenchRequest", "OpenSuite", "bench"),
    "api.sweeps": ("RateSweep", "SweepRequest", "sweep"),
    "datasets.city.request": ("CityRequest",),
    "metrics.comparison.control": ("Controlled",),
    "replay.data.scores": ("ScoreOptions",),
    "replay.logs.setup": ("BoxSource",),
    "replay.setup.request": ("ReplayRequest",),
    "replay.setup.source": ("LogRequest",),
}

__all__ = [
    "BenchRequest",
    "BoxSource",
    "CityRequest",
    "Controlled",
    "FileScoreRequest",
    "LogRequest",
    "OpenLog",
    "OpenRun",
    "OpenSuite",
    "ProfileRequest",
    "RateSweep",
    "RecordedProfile",
    "Relations",
    "ReplayRequest",
    "Resampling",
    "RunComparison",
    "ScoreOptions",
    "ScoreRequest",
    "ScoreResult",
    "SimulateRequest",
    "SweepRequest",
    "bench",
    "check_relations",
    "compare",
    "estimate_by_controls",
    "open_log",
    "open_run",
    "profile",
    "replay",
    "report",
    "score",
    "score_files",
    "simulate",
    "sweep",
    "verify",
]


def __getattr__(name: str) -> object:
    """Load an entry point."""
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(f"fbench.{home}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
