"""Runs: replay a log, open a run as tables, compare runs, verify a replay, and write reports."""

import json
import re
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import asdict, dataclass, replace
from html import escape
from pathlib import Path
from shutil import copytree
from typing import TYPE_CHECKING, Any, Literal

from fbench.api.scores import IN_LOCKSTEP, open_folder, score_folder
from fbench.replay.conditions.effects import Effects
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog, explain_losses
from fbench.replay.contracts.plugins import give_log, guard, load, open_pipeline, parse_name
from fbench.replay.contracts.protocols import KeepsStderr, Overlaps, Pipeline, Reader
from fbench.replay.contracts.variants import variant_of
from fbench.replay.data.files import replace_text
from fbench.replay.data.scores import format_count, score_rows
from fbench.replay.engine.clock import make_clock
from fbench.replay.engine.loop import replay as replay_plan
from fbench.replay.engine.overlap import Overlap
from fbench.replay.engine.plan import NUM_MEDIA, Plan
from fbench.replay.engine.read_ahead import open_ahead
from fbench.replay.engine.service_queue import MEASURED
from fbench.replay.engine.shared import SharedLogs, SharedReader
from fbench.replay.runs.folder import Run
from fbench.replay.runs.host import EnergyMeter, describe_host, measure_reference_ms, peak_memory_mib
from fbench.replay.runs.manifest import VariantEntry
from fbench.replay.runs.redaction import public_name, public_pipeline
from fbench.replay.runs.secrets import without_secrets
from fbench.replay.setup.request import ReplayOptions, ReplayRequest

if TYPE_CHECKING:
    import pandas as pd

    from fbench.replay.check.verify import Verified
    from fbench.replay.data.comparison import Comparison

_VERIFY_WORKER = "fbench.api.verify_child"


@dataclass(frozen=True)
class OpenRun:
    """A run whose tables are pandas DataFrames; each is read when it is asked for."""

    run: Run

    @property
    def folder(self) -> Path:
        """The run folder."""
        return self.run.folder

    @property
    def complete(self) -> bool:
        """Whether no data was lost beyond the fault budget."""
        return self.run.manifest.complete

    def scores(self) -> "pd.DataFrame":
        """Return the scores: `metric`, `class`, `slice`, `matching`, `value`, `reason`, `unit`, `counts`."""
        import pandas as pd

        return pd.DataFrame(score_rows(self.run.scores))

    def detections(self) -> "pd.DataFrame":
        """Return the detections: a row a box with the index of its `frame`; columns as in `replay/data/boxes.py`."""
        return self._read("detections.parquet")

    def tracks(self) -> "pd.DataFrame":
        """Return the tracks, in the form of `detections`."""
        return self._read("tracks.parquet")

    def truth(self) -> "pd.DataFrame":
        """Return the 3D truth, in the form of `detections`; empty where the log has none."""
        return self._read("truth.parquet")

    def frames(self) -> "pd.DataFrame":
        """Return the frames: a row each with stamps [ns], segment, missing sensors and digests."""
        return self._read("frames.parquet")

    def latency(self) -> "pd.DataFrame":
        """Return the latency of each stage [ms], and of the whole frame in the last row."""
        import pandas as pd

        return pd.DataFrame(self.run.json("latency.json")["stages"]).set_index("stage")

    def _read(self, name: str) -> "pd.DataFrame":
        import pandas as pd

        path = self.folder / name
        return pd.read_parquet(path) if path.is_file() else pd.DataFrame()

    def _repr_html_(self) -> str:
        """Show what ran and the primary scores in a notebook."""
        manifest = self.run.manifest
        state = "" if manifest.complete else ", incomplete"
        head = f"{manifest.log.name} → {manifest.pipeline}: {format_count(manifest.num_frames, 'frame')}{state}"
        scores = self.scores()
        shown = scores[scores["slice"] == "all"] if len(scores) else scores
        columns = [name for name in ("metric", "class", "matching", "value", "unit") if name in shown]
        return f"<p><b>{escape(head)}</b><br>{escape(str(self.folder))}</p>{shown[columns].to_html(index=False)}"


@dataclass(frozen=True, eq=False)
class RunComparison:
    """Two runs or suites side by side."""

    comparison: "Comparison"

    @property
    def notes(self) -> tuple[str, ...]:
        """What else differs between the runs."""
        return self.comparison.notes

    @property
    def is_worse(self) -> bool:
        """Whether the gate fails: a number that gates became worse, or lost its value, or a budget was exceeded."""
        return self.comparison.is_worse

    def rows(self) -> "pd.DataFrame":
        """Return all metrics of both sides, a row each."""
        import pandas as pd

        return pd.DataFrame([asdict(row) for row in self.comparison.rows])

    def _repr_html_(self) -> str:
        """Show the verdict and the rows in a notebook."""
        notes = "".join(f"<li>{escape(note)}</li>" for note in self.notes)
        verdict = escape(self.comparison.headline)
        return f"<p><b>{verdict}</b></p><ul>{notes}</ul>{self.rows().to_html(index=False)}"


def open_run(folder: Path | str) -> OpenRun:
    """Open a run folder. Raises ConfigError where there is no such folder. Raises RunError where it isn't a run."""
    return OpenRun(open_folder(Path(folder)))


def compare(
    base: Path | str,
    head: Path | str,
    tolerance: float = 0.0,
    policy: Path | str | None = None,
    reference: Literal["truth", "base"] = "truth",
) -> RunComparison:
    """Compare two runs, or two suites cell by cell.

    Args:
        base: Folder of the run or suite to compare with, or a baseline file.
        head: Folder of the run or suite that should not be worse.
        tolerance: How much F1 and MOTA may fall, where there is no policy.
        policy: A `gate.toml` that says what gates.
        reference: `base`: without labels, the results of the base stand for truth.

    Raises:
        ConfigError: where a folder isn't there, or the policy isn't as expected.
        RunError: where one isn't a run.
        MetricError: where the two can't be compared, or nothing was measured.
    """
    from fbench.api.gates import CompareRequest, compare_sides

    file = None if policy is None else Path(policy)
    return RunComparison(compare_sides(CompareRequest(Path(base), Path(head), tolerance, file, reference)))


def report(runs: Sequence[Path | str], out: Path | None = None, kind: str = "html") -> Path:
    """Write one self-contained report of one or several runs and return its path.

    Args:
        runs: Run folders.
        out: The file; `None`: `report.html` in the first run.
        kind: Name of the report plug-in.

    Raises:
        ConfigError: where a folder isn't there, or there is no such plug-in.
    """
    opened = [open_folder(Path(folder)) for folder in runs]
    path = out or opened[0].folder / "report.html"
    load("reports", kind)().write(opened, path)
    return path


def verify(
    request: ReplayRequest,
    num_repeats: int = 2,
    quick: bool = False,
    keep: Path | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> "Verified":
    """Replay in fresh processes under other rates, containers, hash seeds and threads, and find what differs first.

    Args:
        request: The replay.
        num_repeats: How often the same is replayed, the first time included.
        quick: Only the circumstances that find most.
        keep: Folder for the runs; `None`: they are removed.
        progress: Gets the number of replays that are done, and of all.

    Raises:
        ConfigError: where an option isn't as expected, or latency is measured, which no two replays have in common.
        LogError: where the log can't be replayed at all.
    """
    from fbench.replay.check.verify import verify_in, workplace

    _resolve(request)  # so that a wrong option is found before any process starts
    if request.latency == MEASURED:
        raise ConfigError("--latency measured: differs from replay to replay; give a time, such as fixed:80ms")
    with workplace(keep) as folder:
        return verify_in(request, num_repeats, quick, folder, _VERIFY_WORKER, progress)


def _resolve(request: ReplayRequest) -> ReplayOptions:
    """Read a request's options. Raises ConfigError also where latency is from a profile of another pipeline."""
    options = request.resolve()
    if options.latency is not None and options.latency.profile is not None:
        options.latency.profile.require_pipeline(name_pipeline(replace(request, redact=False)))
    return options


def replay(
    request: ReplayRequest,
    progress: Callable[[int], None] = lambda num_frames: None,
    failed: Callable[[BaseException], None] = lambda error: None,
    shared: SharedLogs | None = None,
    lockstep: Path | None = None,
) -> OpenRun:
    """Replay a log into a pipeline, score the run, and report if that is requested. With latency it is replayed twice:
    the second time in lockstep, into the folder `lockstep` of the run.

    Args:
        request: The log, the pipeline and all options.
        progress: Gets the number of frames that are done, those of a replay in lockstep included.
        failed: Gets every exception that counts as a failed frame.
        shared: Messages that earlier replays of the same log under the same condition read.
        lockstep: Folder of the same replay without latency, which is copied; `None`: it is replayed where it is needed.

    Raises:
        ConfigError: where an option isn't as expected, or the run folder exists or can't be written.
        LogError: where the log can't be used by this pipeline.
        RunError: where the pipeline keeps failing.
    """
    options, name = _resolve(request), name_pipeline(request)
    rate = "max" if request.latency is not None else request.rate  # with latency the queue has it, and nobody waits
    clock, start = make_clock(rate, options.sync.max_gap_ns), time.monotonic()
    machine, energy = describe_host(), EnergyMeter.read()
    faults, variant, entry, speed = FaultLog(), request.variant, None, _Speed(progress)
    if variant is not None:
        sets = [parameter for parameter, _ in variant.settings]
        entry = VariantEntry(name=variant.name, title=variant.title, base=variant.base, sets=sets)

    def complete(folder: Path) -> None:
        host = {**machine, "rate": rate, "wall_s": round(time.monotonic() - start, 3), **energy.describe_use()}
        host |= {"peak_memory_mib": round(peak_memory_mib(), 1), "reference_ms": round(measure_reference_ms(), 3)}
        pace = clock.pace
        known = {"achieved_rate": pace.achieved, "p99_late_ms": pace.p99_late_ms, "max_late_ms": pace.max_late_ms}
        known |= {"drift_ms_per_min": pace.drift_ms_per_min}
        host |= {"isolated": True} if request.isolate else {}
        host |= {"overlap": 1 if plan.overlap is None else plan.overlap.num, "frames_per_s": speed.frames_per_s}
        host |= {name: round(value, 3) for name, value in known.items() if value is not None}
        replace_text(folder / "host.json", json.dumps(host, indent=1) + "\n")
        if not request.redact:
            with guard(f"pipeline '{name}' can't give its stderr"):
                keep_stderr(pipeline, folder)
        if lockstep is not None:
            copytree(lockstep, folder / IN_LOCKSTEP)
        elif request.latency is not None:  # so that both can be compared
            opened.close()  # a second pipeline beside the first may not fit, and would share its processors
            same = replace(request, latency=None, overload=None, rate="max", no_media=True, report=False)
            num_before = Run(folder).manifest.num_frames
            replay(replace(same, out=folder / IN_LOCKSTEP), lambda num: progress(num_before + num), shared=shared)
        score_folder(folder, request.scoring, budget_ms=request.budget_ms)

    with ExitStack() as opened, explain_losses(faults):
        pipeline, parameters = opened.enter_context(open_requested(request, options.settings))
        if options.latency is not None and options.latency.profile is not None:
            options.latency.profile.require_parameters(parameters)
        plan = replace(
            make_plan(options, pipeline, name, parameters),
            variant=entry,
            max_between_ns=options.max_between_ns,
            clock=clock,
            latency=options.latency,
            budget=options.budget,
            redact=request.redact,
            num_media=0 if request.no_media else NUM_MEDIA,
            progress=speed.count,
            failed=failed,
        )
        give_log(pipeline, name, lambda: options.log.open(faults))
        if request.overlap > 1 and isinstance(pipeline, Overlaps):
            with guard(f"pipeline '{name}' can't overlap frames"):
                processes = Overlap(request.pipeline, options.settings, request.overlap)
                plan = replace(plan, overlap=opened.enter_context(processes))
        with _open_reader(request, options, faults, shared) as reader:
            log = public_name(reader.info) if request.redact else reader.info.name
            under = "".join(f"-{part}" for part in options.disturbance.parts)
            under = re.sub(r"[^\w.]+", "-", under).rstrip("-")
            folder = request.out or Path("runs") / f"{log}-{name.replace('/', '-')}{under}"
            replay_plan(reader, plan, folder, faults, request.overwrite, complete)
    run = Run(folder)
    if request.report:
        load("reports", "html")().write([run], folder / "report.html")
    return OpenRun(run)


class _Speed:
    """Frames a second, from the end of the first frame on: what starts with it doesn't count."""

    def __init__(self, progress: Callable[[int], None]) -> None:
        self._progress, self._begin_ns, self._end_ns, self._num = progress, 0, 0, 0

    def count(self, num_frames: int) -> None:
        """Take note that so many frames are done."""
        self._end_ns, self._num = time.monotonic_ns(), num_frames
        self._begin_ns = self._end_ns if num_frames == 1 else self._begin_ns
        self._progress(num_frames)

    @property
    def frames_per_s(self) -> float | None:
        """`None`: there was one frame only."""
        passed_ns = self._end_ns - self._begin_ns
        return round((self._num - 1) * 1e9 / passed_ns, 3) if passed_ns else None


def _open_reader(
    request: ReplayRequest, options: ReplayOptions, faults: FaultLog, shared: SharedLogs | None
) -> AbstractContextManager[Reader]:
    if shared is None:
        return open_ahead(options.log.open, faults, options.read_ahead)
    key = (request.log, request.condition, request.seed if options.disturbance else 0)
    how = options.disturbance, faults, Effects(), options.read_ahead
    return nullcontext(SharedReader(shared, key, options.log.open, *how))


def open_requested(
    request: ReplayRequest, settings: list[str]
) -> AbstractContextManager[tuple[Pipeline, dict[str, object]]]:
    """Return the context of a request's pipeline with its parameters, in a process of its own where that is requested;
    the program of `exec` has one anyway.
    """
    if not request.isolate or parse_name(request.pipeline).plugin == "exec":
        return open_pipeline(request.pipeline, settings)
    from fbench.pipelines.external.isolated import open_isolated

    return open_isolated(request.pipeline, settings, request.frame_timeout_s)


def make_plan(options: ReplayOptions, pipeline: Pipeline, name: str, parameters: Mapping[str, Any]) -> Plan:
    """Plan a replay in lockstep, with all options that decide what the pipeline gets of the log."""
    inputs, truth = options.log.input_entries(), options.log.truth_entry()
    selection = options.sync, options.stamps, options.excerpt, options.log.topics, options.sensors
    disturbance = options.disturbance
    return Plan(pipeline, name, parameters, *selection, inputs=inputs, truth=truth, disturbance=disturbance)


def name_pipeline(request: ReplayRequest) -> str:
    """Return the pipeline's name for the manifest."""
    if (variant := request.variant) is not None:
        return without_secrets(variant.name)
    return short_name(public_pipeline(request.pipeline) if request.redact else request.pipeline)


def short_name(pipeline: str) -> str:
    """Return a pipeline's name as part of a file name: `dir/mine.py:Mine` becomes `mine-Mine`. Raises ConfigError where
    the file of a variant can't be used.
    """
    variant = variant_of(pipeline)
    return parse_name(without_secrets(pipeline)).short if variant is None else without_secrets(variant.file_name)


def keep_stderr(pipeline: Pipeline, folder: Path) -> None:
    """Write what the pipeline's program wrote to stderr, if anything, without credentials."""
    data = pipeline.stderr() if isinstance(pipeline, KeepsStderr) else b""
    if data:
        text = without_secrets(data.decode(errors="surrogateescape"))
        (folder / "stderr.txt").write_bytes(text.encode(errors="surrogateescape"))
