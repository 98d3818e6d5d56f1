"""Entry points for programs and notebooks: plain functions with frozen requests; the command line calls the same."""

from fbench.api.bench import BenchRequest, OpenSuite, bench
from fbench.api.controls import estimate_by_controls
from fbench.api.logs import OpenLog, SimulateRequest, open_log, simulate
from fbench.api.profile import ProfileRequest, RecordedProfile, profile
from fbench.api.relations import Relations, check_relations
from fbench.api.runs import OpenRun, RunComparison, compare, open_run, replay, report, verify
from fbench.api.scores import FileScoreRequest, Resampling, ScoreRequest, ScoreResult, score, score_files
from fbench.api.sweep import RateSweep, SweepRequest, sweep
from fbench.datasets.city.request import CityRequest
from fbench.metrics.comparison.control import Controlled
from fbench.replay.data.scores import ScoreOptions
from fbench.replay.logs.setup import BoxSource
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import LogRequest

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
