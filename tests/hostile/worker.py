"""Runs many cases in this process, each within bounds of time and memory, and says of each what came of it.

`python -m tests.hostile.worker FIRST STOP KIND ...` prints one line of JSON a case: `[kind, number, outcome, detail]`.
`python -m tests.hostile.worker FILE ...` does so with cases of the corpus: `[file, 0, outcome, detail]`.
"""

import gc
import json
import re
import resource
import shutil
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from hashlib import blake2b
from pathlib import Path
from types import FrameType

from tests.hostile.target import Case, Found, Target, unpack

from fbench.replay.conditions.generators import generator
from fbench.replay.contracts.errors import FbenchError

MAX_S, MAX_MIB = 10.0, 512  # Of one case: CPU time, and memory beyond what the process had before
WARM_UP = 10**9  # The number of a case that is no other's
_GUARD = 6 * 2**30  # The address space that a case may add, so that one can't take the machine down [byte]
_STATUS, _REFS = Path("/proc/self/status"), Path("/proc/self/clear_refs")
_MAX_CHARS = 2000


class TooSlowError(BaseException):
    """A case took longer than `MAX_S`."""


class Worker:
    """Judges cases of one target; what whole files hold is read once."""

    def __init__(self, kind: str, target: Target, folder: Path) -> None:
        self.kind, self.target, self._folder = kind, target, folder
        self._whole: dict[bytes, Found] = {}
        warnings.simplefilter("error")  # a user would see it as lines of Python

    def case(self, number: int) -> Case:
        """Make case `number`."""
        return self.target.make(generator(number, "hostile", self.kind))

    def judge(self, case: Case) -> tuple[str, str]:
        """Return outcome and detail of a case."""
        whole = None if case.whole is None else self._read_whole(case)
        folder = self._empty()
        case.write(folder)
        _REFS.write_text("5")
        before = _peak_mib()
        try:
            with _limit(MAX_S):
                found = self.target.use(folder)
            outcome, detail = self.target.judge(found, whole)
        except FbenchError as error:
            text = str(error)
            outcome, detail = "refused", ""
            if not text or not text.isprintable() or len(text) > _MAX_CHARS:
                outcome, detail = "error", f"{type(error).__name__} isn't one line of text"
        except TooSlowError:
            outcome, detail = "time", f"over {MAX_S:.0f} s"
        except Exception as error:  # noqa: BLE001 (what this is about)
            outcome, detail = "error", _signature(error)
        taken = _peak_mib() - before
        return ("memory", f"over {MAX_MIB} MiB") if taken > MAX_MIB else (outcome, detail)

    def _read_whole(self, case: Case) -> Found:
        digest = blake2b(digest_size=16)
        for name, content in sorted((case.whole or {}).items()):
            digest.update(f"{name} {len(content)} ".encode() + content)
        key = digest.digest()
        if key not in self._whole:
            folder = self._empty()
            case.write(folder, case.whole)
            self._whole[key] = self.target.use(folder)
        return self._whole[key]

    def _empty(self) -> Path:
        folder = self._folder / "case"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        return folder


@contextmanager
def worker(kind: str, target: Target) -> Iterator[Worker]:
    """A worker with a folder of its own, in memory where there is such a place."""
    memory = Path("/dev/shm")  # noqa: S108 (files are made in a new folder there)
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as folder:
        yield Worker(kind, target, Path(folder))


@contextmanager
def _limit(seconds: float) -> Iterator[None]:
    """Interrupt what takes more CPU time than this: the clock on the wall would blame a busy machine's cases."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TooSlowError

    kept = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, seconds, 0.5)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, kept)


def _peak_mib() -> float:
    found = re.search(r"VmHWM:\s+(\d+) kB", _STATUS.read_text())
    assert found is not None
    return int(found[1]) / 1024


def _signature(error: Exception) -> str:
    """Type and place of an error, which tell one finding from another."""
    frames = traceback.extract_tb(error.__traceback__)
    own = [f for f in frames if "/site-packages/" not in f.filename and "/lib/python" not in f.filename] or frames
    place = own[-1] if own else None
    where = f"{Path(place.filename).name}:{place.name}" if place else ""
    return f"{type(error).__name__} in {where}: {(str(error).splitlines() or [''])[0][:120]}"


def main(arguments: list[str]) -> None:
    """Print what comes of numbered cases of some kinds, or of cases of the corpus."""
    from tests.hostile.targets import TARGETS

    if not arguments[0].isdecimal():
        for name in arguments:
            kind, case = unpack(Path(name))
            with worker(kind, TARGETS[kind]) as one:
                _say(name, 0, *one.judge(case))
        return
    first, stop = map(int, arguments[:2])
    for kind in arguments[2:]:
        with worker(kind, TARGETS[kind]) as one:
            one.judge(one.case(WARM_UP))  # imports, and code that is compiled when it is first called
            gc.collect()
            gc.freeze()  # of thousands of collections, each would look at all modules
            now = int(re.search(r"VmSize:\s+(\d+) kB", _STATUS.read_text())[1]) * 1024
            resource.setrlimit(resource.RLIMIT_AS, (now + _GUARD, resource.RLIM_INFINITY))
            for number in range(first, stop):
                _say(kind, number, *one.judge(one.case(number)))


def _say(*what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main(sys.argv[1:])
