"""Replays: a log into a pipeline, scored, and whether it gives the same whatever the circumstances."""

import json
import re
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from shutil import copytree
from typing import TYPE_CHECKING, Any

from fbench.api.runs import OpenRun
from fbench.api.scores import IN_LOCKSTEP, score_folder
from fbench.replay.conditions.effects import Effects
from fbench.replay.contracts.devices import Device, check_device, use_device
from fbench.replay.contracts.entry_points import load
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.contracts.faults import FaultLog, explain_losses
from fbench.replay.contracts.plugins import give_log, guard, open_pipeline, parse_name
from fbench.replay.contracts.protocols import KeepsStderr, Overlaps, Pipeline, Reader, UsesLog
from fbench.replay.contracts.variants import variant_of
from fbench.replay.data.files import replace_text
from fbench.replay.engine.clock import Pace, make_clock
from fbench.replay.engine.loop import replay as replay_plan
from fbench.replay.engine.overlap import Overlap
from fbench.replay.engine.plan import NUM_MEDIA, Plan
from fbench.replay.engine.read_ahead import open_ahead
from fbench.replay.engine.service_queue import MEASURED
from fbench.replay.engine.shared import SharedLogs, SharedReader
from fbench.replay.runs.folder import Run
from fbench.replay.runs.host import EnergyMeter, describe_host, measure_reference_ms, peak_memory_mib
from fbench.replay.runs.manifest import VariantEntry, execution_entry
from fbench.replay.runs.redaction import public_name, public_pipeline
from fbench.replay.runs.secrets import without_secrets
from fbench.replay.setup.request import ReplayOptions, ReplayRequest

if TYPE_CHECKING:
    from fbench.replay.check.verify import Verified

_VERIFY_WORKER = "fbench.api.verify_child"


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
    require_device(request.device)
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
        host |= {"isolated": True} if request.isolate else {}
        host |= {"device": request.device} if request.device != "cpu" else {}
        host |= {"card": card} if (card := execution_entry().cuda.get("card")) else {}
        host |= {"overlap": 1 if plan.overlap is None else plan.overlap.num, "frames_per_s": speed.frames_per_s}
        replace_text(folder / "host.json", json.dumps({**host, **_describe_pace(clock.pace)}, indent=1) + "\n")
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
        if request.overlap > 1 and isinstance(pipeline, Overlaps) and not isinstance(pipeline, UsesLog):
            with guard(f"pipeline '{name}' can't overlap frames"):
                processes = Overlap(request.pipeline, options.settings, request.overlap)
                plan = replace(plan, overlap=opened.enter_context(processes))
        if options.log.setup.truth is not None:  # What scores need, and is wrong, must not cost a whole replay
            next(options.log.open(FaultLog()).truths(), None)
        with _open_reader(request, options, faults, shared) as reader:
            _ = reader.info.outline
            log = public_name(reader.info) if request.redact else reader.info.name
            under = "".join(f"-{part}" for part in options.disturbance.parts)
            under = re.sub(r"[^\w.]+", "-", under).rstrip("-")
            folder = request.out or Path("runs") / f"{log}-{name.replace('/', '-')}{under}"
            replay_plan(reader, plan, folder, faults, request.overwrite, complete)
    run = Run(folder)
    if request.report:
        load("reports", "html")().write([run], folder / "report.html")
    return OpenRun(run)


def _describe_pace(pace: Pace) -> dict[str, float]:
    values = {
        "achieved_rate": pace.achieved,
        "p99_late_ms": pace.p99_late_ms,
        "max_late_ms": pace.max_late_ms,
        "drift_ms_per_min": pace.drift_ms_per_min,
    }
    return {name: round(value, 3) for name, value in values.items() if value is not None}


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


@contextmanager
def open_requested(request: ReplayRequest, settings: list[str]) -> Iterator[tuple[Pipeline, dict[str, object]]]:
    """Open a request's pipeline with its parameters, in a process of its own where that is requested; the program of
    `exec` has one anyway. What it loads in the `with` block runs on the request's device; see `require_device`.
    """
    require_device(request.device)
    with use_device(request.device):
        if not request.isolate or parse_name(request.pipeline).plugin == "exec":
            opened = open_pipeline(request.pipeline, settings)
        else:
            from fbench.pipelines.external.isolated import open_isolated

            opened = open_isolated(request.pipeline, settings, request.frame_timeout_s)
        with opened as found:
            yield found


def require_device(device: Device) -> None:
    """Try whether networks run on a device. Raises ConfigError where they don't: why, and what to install."""
    check_device(device)
    if device == "cuda":
        from fbench.pipelines.sensors.camera.detector import require_cuda

        require_cuda()


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
