"""The sensor branches of one frame run in parallel, with the results that they have one after the other."""

from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, Generic, TypeVar, overload

from fbench.pipelines.sensors.camera.detector import CameraDetections
from fbench.pipelines.sensors.camera.stage import CameraStage
from fbench.replay.contracts.params import StageClock
from fbench.replay.contracts.sensor_settings import SensorSettings
from fbench.replay.data.frames import Fault, Frame
from fbench.replay.data.rig import LogInfo, Rig
from fbench.replay.geometry.kernels import num_threads

A = TypeVar("A")
B = TypeVar("B")
C = TypeVar("C")
D = TypeVar("D")


class Branches:
    """Threads for the branches of a frame; what decodes, detects and clusters runs without Python's lock.

    A branch takes the clock that times its stages, and gives its result. What it writes to (state of its stages, lists
    of faults) must be its own. The calling thread works too, so that there are no others where one is all there is.
    The others are started when first needed, and end with this object.

    Args:
        threads: How many may work at once; `None`: `num_threads()`.
    """

    def __init__(self, threads: int | None = None) -> None:
        self._num_others = (num_threads() if threads is None else threads) - 1
        self._pool: ThreadPoolExecutor | None = None

    @overload
    def run(self, clock: StageClock, a: Callable[[StageClock], A], b: Callable[[StageClock], B], /) -> tuple[A, B]: ...

    @overload
    def run(
        self,
        clock: StageClock,
        a: Callable[[StageClock], A],
        b: Callable[[StageClock], B],
        c: Callable[[StageClock], C],
        /,
    ) -> tuple[A, B, C]: ...

    @overload
    def run(
        self,
        clock: StageClock,
        a: Callable[[StageClock], A],
        b: Callable[[StageClock], B],
        c: Callable[[StageClock], C],
        d: Callable[[StageClock], D],
        /,
    ) -> tuple[A, B, C, D]: ...

    def run(self, clock: StageClock, *branches: Callable[[StageClock], Any]) -> tuple[Any, ...]:
        """Run all branches, and return their results in the order given; name first what takes longest.

        All of them run, also when one fails; none is left running. `clock` gets the times of all stages in the order of
        branches; their sum may be more than the time that passed. Raises Exception that of the first branch, in the
        order given, that failed.
        """
        runs = [_Run(branch) for branch in branches]
        self._work(deque(runs))
        for run in runs:
            if run.error is not None:
                raise run.error
            clock.include(run.clock)
        return tuple(run.result for run in runs)

    def _work(self, waiting: "deque[_Run[Any]]") -> None:
        others = min(self._num_others, len(waiting) - 1)
        helpers = [self._threads().submit(_work_off, waiting) for _ in range(others)]
        try:
            _work_off(waiting)
        finally:  # also when interrupted
            waiting.clear()
            wait([helper for helper in helpers if not helper.cancel()])

    def _threads(self) -> ThreadPoolExecutor:
        if self._pool is None:
            self._pool = ThreadPoolExecutor(self._num_others, "fbench-branch")
        return self._pool


class _Run(Generic[A]):
    """One branch of one frame."""

    def __init__(self, branch: Callable[[StageClock], A]) -> None:
        self._branch = branch
        self.clock = StageClock()
        self.result: A | None = None
        self.error: BaseException | None = None

    def __call__(self) -> None:
        try:
            self.result = self._branch(self.clock)
        except BaseException as error:  # noqa: BLE001 - raised again by `Branches.run`
            self.error = error


def _work_off(waiting: "deque[_Run[Any]]") -> None:
    """Run what waits, until nothing does; other threads may do the same."""
    while True:
        try:
            run = waiting.popleft()
        except IndexError:  # asking first could be too late when it is answered
            return
        run()


First = TypeVar("First")
Second = TypeVar("Second")


class SideBySide:
    """Runs the branches of a pipeline that merges cameras with two other kinds of sensors."""

    def __init__(self, cameras: CameraStage) -> None:
        self._cameras, self._branches = cameras, Branches()

    @property
    def identity(self) -> Mapping[str, object]:
        """Which weights are used, where no parameter names them."""
        return self._cameras.identity

    @property
    def missing(self) -> Mapping[str, str]:
        """Cameras of the rig that aren't used, with the reason."""
        return self._cameras.missing

    def start(self, rig: Rig, log_info: LogInfo, settings: SensorSettings) -> None:
        """Take all cameras of the rig. Raises LogError where one that is used can't be projected into."""
        self._cameras.start(rig, log_info, settings)
        self._cameras.require_projections()

    def view(
        self,
        frame: Frame,
        clock: StageClock,
        faults: list[Fault],
        a: Callable[[Frame, StageClock], First],
        b: Callable[[Frame, StageClock], Second],
    ) -> tuple[dict[str, CameraDetections], First, Second]:
        """Return what the cameras see, by name, and what `a` and `b` give; a corrupt image is one of the `faults`."""
        return self._branches.run(
            clock,
            lambda clock: self._cameras.view(frame, clock, faults),
            lambda clock: a(frame, clock),
            lambda clock: b(frame, clock),
        )
