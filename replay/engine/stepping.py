"""Steps of a pipeline: a frame goes in, and what comes out is checked and timed; a failure is a fault of the frame."""

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

from fbench.replay.contracts.errors import (
    INTERRUPTS,
    LogError,
    MissingPackageError,
    ReportedError,
    RunError,
    one_line,
)
from fbench.replay.contracts.faults import FaultLog
from fbench.replay.contracts.params import synchronize_cuda
from fbench.replay.contracts.plugins import guard
from fbench.replay.contracts.protocols import Overlaps, Pipeline, SkipsFrames, TellsCpuTime
from fbench.replay.data.frames import Frame, Output
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.engine.cleaning import OutputCheck
from fbench.replay.engine.overlap import ObservedFrame
from fbench.replay.engine.plan import Plan
from fbench.replay.engine.warm_up import WarmUp
from fbench.replay.runs.secrets import without_secrets

MAX_FAILURES_IN_A_ROW = 10  # A pipeline that fails on so many frames in a row is given up


@dataclass(frozen=True, eq=False)
class Step:
    """What running the pipeline on a frame gave."""

    output: Output | None = None
    failed: str | None = None
    total_ns: int = 0  # Of the wall clock
    cpu_ns: int | None = None  # Of all threads of the process in which the pipeline runs; `None`: unknown
    compiled: bool = False  # Whether code was compiled or loaded meanwhile


class Stepper:
    """Runs the pipeline of a plan, frame by frame. `reason` says why a segment after the first begins; `disturb` makes
    the rig that the pipeline is given of the true one.
    """

    def __init__(
        self, plan: Plan, rig: Rig, info: LogInfo, faults: FaultLog, warm_up: WarmUp,
        disturb: Callable[[Rig], Rig], reason: Callable[[int], str],
    ) -> None:  # fmt: skip
        self._plan, self.rig, self._info, self._faults, self._warm_up = plan, rig, info, faults, warm_up
        self._disturb, self._reason = disturb, reason
        self._check = OutputCheck(rig)
        self._failures = 0
        self._segment: int | None = None
        self._recursion_limit = sys.getrecursionlimit()

    def start(self) -> None:
        """Start the pipeline. Raises LogError, naming a variant's base, where the log doesn't fit it, else RunError."""
        for name in sorted({*self.rig.mounts, *self.rig.cameras}):
            if (plain := without_secrets(name)) != name:
                raise LogError(
                    f"sensor '{plain}' has credentials or a query in its name; give it another in fbench.toml "
                    "([sensors.NAME] with its topic), or leave it out with --topics"
                )
        rig = self._disturb(self.rig)
        try:
            with guard(f"pipeline '{self._plan.name}' can't start"):
                self._plan.pipeline.start(rig, self._info)
        except LogError as error:
            if self._plan.variant is None:
                raise
            base = self._plan.variant.base
            raise LogError(f"{error}; {self._plan.name} is a variant of {base}", error.code) from error

    def step(self, frame: Frame, rig: Rig, observed: ObservedFrame | None = None) -> Step:
        """Run the pipeline on a frame that was measured with a rig, or conclude what another process `observed` in it.
        Raises RunError after many failures in a row.
        """
        num_compiled, start, cpu_start = self._warm_up.count(), time.perf_counter_ns(), self._cpu_ns()
        output, failed = self._run(frame, rig, observed)
        synchronize_cuda()
        total_ns, cpu_end = time.perf_counter_ns() - start, self._cpu_ns()
        # Less where the program was started again meanwhile, whose clock then began anew.
        is_known = cpu_start is not None and cpu_end is not None and cpu_end >= cpu_start
        cpu_ns = (cpu_end or 0) - (cpu_start or 0) if is_known else None
        compiled = self._warm_up.count() > num_compiled
        if observed is not None:
            total_ns, cpu_ns = total_ns + observed.wall_ns, (cpu_ns or 0) + observed.cpu_ns
            compiled = compiled or observed.compiled
        return Step(output, failed, total_ns, cpu_ns, compiled)

    def _cpu_ns(self) -> int | None:
        """CPU time so far of the process that the pipeline runs in."""
        if not isinstance(self._plan.pipeline, TellsCpuTime):
            return time.process_time_ns()
        with guard(f"pipeline '{self._plan.name}' can't tell its CPU time"):
            used_ns: object = self._plan.pipeline.cpu_ns()
        return used_ns if isinstance(used_ns, int) else None

    def skip(self, frame: Frame) -> None:
        """Tell the pipeline of a frame that it doesn't get, if it wants to know."""
        if isinstance(self._plan.pipeline, SkipsFrames):
            with guard(f"pipeline '{self._plan.name}' can't skip frame {frame.index}"):
                self._plan.pipeline.skip(frame)

    def _run(self, frame: Frame, rig: Rig, observed: ObservedFrame | None) -> tuple[Output | None, str | None]:
        pipeline, changed = self._plan.pipeline, None
        if self.rig is not rig:
            self.rig = rig
            changed = self._disturb(rig)
        try:
            if changed is not None:
                pipeline.start(changed, self._info)
            if frame.segment != self._segment:  # a segment begins, or an excerpt in the middle of one
                is_first, self._segment = self._segment is None, frame.segment
                if frame.index:
                    begins = f"replay begins with frame {frame.index}"
                    pipeline.reset(begins if is_first else self._reason(frame.segment))
            output = self._check(pipeline.step(frame) if observed is None else _conclude(pipeline, frame, observed))
        except (MissingPackageError, *INTERRUPTS):
            raise
        except BaseException as error:
            self._failures += 1
            self._plan.failed(error)
            why, times = one_line(error), self._failures
            if times >= MAX_FAILURES_IN_A_ROW:
                raise RunError(f"pipeline '{self._plan.name}' failed on {times} frames in a row: {why}") from error
            self._faults.add("PRD002", f"frame {frame.index}: {why}")
            return None, why
        finally:
            sys.setrecursionlimit(self._recursion_limit)  # a plug-in may have changed it
        self._failures = 0
        for fault in output.faults:
            self._faults.add(fault.code, f"frame {frame.index}: {fault.where}")
        return output, None


def _conclude(pipeline: Pipeline, frame: Frame, observed: ObservedFrame) -> object:
    if not isinstance(pipeline, Overlaps):
        raise TypeError("the pipeline has no frames that overlap")
    pipeline.pass_by(frame)
    if observed.failed is not None:
        raise MissingPackageError(observed.failed) if observed.is_missing else ReportedError(observed.failed)
    return pipeline.conclude(frame, observed.content)
