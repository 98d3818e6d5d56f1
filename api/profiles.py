"""Profiles of latency: replay a log some times, and fit how long each stage takes by what the frames hold."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from fbench.api.replays import name_pipeline, replay
from fbench.metrics.latency import BUDGET_MS, summarize, warm_up_frames
from fbench.replay.contracts.errors import ConfigError, LogError
from fbench.replay.data.arrays import Float64
from fbench.replay.data.files import replace_text
from fbench.replay.engine.latency_profile import REST, FrameContent, LatencyProfile, StageModel, digest_parameters
from fbench.replay.runs.folder import Run
from fbench.replay.runs.timings import WHOLE
from fbench.replay.setup.request import ReplayRequest

MOST_REPEATS = 1000
_FEWEST_FRAMES = 5
_HOST = ("cpu", "cores", "platform", "governor", "threads", "omp_threads", "numba_threads", "reference_ms", "card")


@dataclass(frozen=True)
class ProfileRequest:
    """The recording of a profile. Raises ConfigError where an option isn't as expected."""

    replay: ReplayRequest
    """In lockstep; its `out` is the profile's file."""
    repeats: int = 3

    def __post_init__(self) -> None:
        if self.replay.overlap > 1:
            raise ConfigError("a profile records latency, so frames can't overlap")
        if self.replay.latency is not None:
            raise ConfigError("a profile records latency, so it takes no --latency")
        if not 1 <= self.repeats <= MOST_REPEATS:
            raise ConfigError(f"--repeat {self.repeats}: expected 1 to {MOST_REPEATS}")
        if (out := self.replay.out) is not None and out.exists() and not (self.replay.overwrite and out.is_file()):
            raise ConfigError(f"{out}: exists already; choose another with --out, or --overwrite it")


@dataclass(frozen=True)
class RecordedProfile:
    """A profile that was written."""

    path: Path
    profile: LatencyProfile
    latency: Mapping[str, object]
    """Summary of the times that it was made from, as in `latency.json`."""
    fps: float
    """Frames a second of the pipeline alone, one after the other."""
    real_time_factor: float | None
    """How many times as fast as the log the pipeline alone is; `None`: the log has one frame only."""


def profile(
    request: ProfileRequest, progress: Callable[[int, int], None] = lambda done, total: None
) -> RecordedProfile:
    """Replay the log some times in lockstep, fit a profile, and write it. Frames of warm-up don't count. `progress`
    gets how many replays are done, of how many. Raises as `replay` does. Raises ConfigError where the results were
    computed elsewhere. Raises LogError where too few frames are left.
    """
    name, path = name_pipeline(request.replay), request.replay.out or Path("profile.json")
    try:  # before anything takes long
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{path}: can't be written ({error.strerror})") from error
    with TemporaryDirectory() as folder:
        runs = []
        for num in range(request.repeats):
            progress(num, request.repeats)
            one = replace(request.replay, out=Path(folder) / str(num), no_media=True, report=False, overwrite=False)
            runs.append(replay(one).run)
        if any(run.clock != "host" for run in runs):
            raise ConfigError(
                f"the results of pipeline '{name}' were computed elsewhere, so there is nothing to measure here"
            )
        times, contents = _gather(runs)
        if len(contents) < _FEWEST_FRAMES:
            raise LogError(
                f"only {len(contents)} frames are left that warmed nothing up, a profile needs {_FEWEST_FRAMES}: take "
                "a longer part of the log, or more repeats"
            )
        parameters = digest_parameters(runs[0].manifest.parameters)
        host = {key: value for key, value in runs[0].json("host.json").items() if key in _HOST}
        found = fit_profile(name, runs[0].manifest.log.name, request.repeats, host, times, contents)
        found = found.model_copy(update={"parameters": parameters})
        stamps = [frame.stamp_ns for frame in runs[0].frames]
    replace_text(path, found.model_dump_json() + "\n")
    stages = dict.fromkeys(stage for own in times for stage in own)
    table = {stage: {row: own[stage] for row, own in enumerate(times) if stage in own} for stage in stages}
    # Those of warm-up are left out already, so all count.
    summary = summarize(table, clock="log", budget_ms=BUDGET_MS) | {"clock": "host"}
    mean_ns = sum(own[WHOLE] for own in times) / len(times)
    period_ns = (stamps[-1] - stamps[0]) / (len(stamps) - 1) if len(stamps) > 1 else math.nan
    return RecordedProfile(path, found, summary, 1e9 / mean_ns, period_ns / mean_ns if period_ns > 0 else None)


def _gather(runs: Sequence[Run]) -> tuple[list[dict[str, int]], list[FrameContent]]:
    """Return times [ns] by stage, `total` included, and content of all frames that didn't fail or warm anything up."""
    times, contents = list[dict[str, int]](), list[FrameContent]()
    for run in runs:
        cold = warm_up_frames(run.frame_times, run.compiled_frames)
        for frame in run.frames:
            own = {stage: ns[frame.index] for stage, ns in run.frame_times.items() if frame.index in ns}
            if frame.failed is None and frame.index not in cold and WHOLE in own:
                times.append(own)
                num_boxes = len(run.detections.at(frame.index))
                contents.append(FrameContent(frame.num_points or 0, num_boxes, frame.num_pixels or 0))
    return times, contents


def fit_profile(
    pipeline: str,
    log: str,
    repeats: int,
    host: Mapping[str, object],
    times: Sequence[Mapping[str, int]],
    contents: Sequence[FrameContent],
) -> LatencyProfile:
    """Fit how long each stage takes: base and rates by least squares, none of them negative, and what they leave.

    Args:
        pipeline: Its name.
        log: Name of the log.
        repeats: How often it was replayed.
        host: The machine, for readers.
        times: Times [ns] of each frame by stage, with `total`.
        contents: What the frames held.
    """
    stages = [stage for stage in dict.fromkeys(stage for own in times for stage in own) if stage != WHOLE]
    measured = [{**own, REST: 2 * own[WHOLE] - sum(own.values())} for own in times]  # total less all others
    held = np.array([(c.num_points, c.num_boxes, c.num_pixels) for c in contents], np.float64)
    models = []
    for stage in (*stages, REST):
        rows = [row for row, own in enumerate(measured) if stage in own]
        models.append(_fit_stage(stage, held[rows], np.array([measured[row][stage] for row in rows], np.float64)))
    residuals = [
        [own[m.stage] - m.predict_ns(content) if m.stage in own else None for m in models]
        for own, content in zip(measured, contents, strict=True)
    ]
    return LatencyProfile(
        pipeline=pipeline, log=log, repeats=repeats, host=dict(host), stages=models, residuals_ns=residuals
    )


def _fit_stage(stage: str, held: Float64, times_ns: Float64) -> StageModel:
    """Fit a stage. `held`: (N, 3) points, boxes and pixels of frames; `times_ns`: (N,). What is the same in all frames
    can't be told from the base, and has no rate.
    """
    from scipy.optimize import nnls  # which takes a while to import

    scale = held.max(axis=0)
    varies = held.min(axis=0) < scale
    columns = np.column_stack([np.ones(len(held)), held[:, varies] / scale[varies]])
    found, _ = nnls(columns, times_ns)
    rates = np.zeros(held.shape[1])
    rates[varies] = found[1:] / scale[varies]
    points, boxes, pixels = (round(1000 * float(rate)) for rate in rates)
    return StageModel(
        stage=stage, base_ns=round(float(found[0])), ps_per_point=points, ps_per_box=boxes, ps_per_pixel=pixels
    )
