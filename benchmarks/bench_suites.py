"""What suites cost beside replays: scheduling, two processes against one, and what sharing messages saves.

    python benchmarks/bench_suites.py scheduling [--cells N]
    python benchmarks/bench_suites.py sleeping [--cells N] [--seconds S] [--scheduler ADDRESS]
    python benchmarks/bench_suites.py sharing LOG.mcap [--pipelines NAME,NAME]

`scheduling` runs N cells whose processes write one small file each, and prints CPU time a cell and the memory at both
ends: CPU time, because other programs may have the cores. `sleeping` runs cells that wait, by one and by two processes,
or by a Dask scheduler, whose workers need PYTHONPATH=benchmarks and FBENCH_BENCH_SLEEP_S=S. `sharing` replays a log
under 4 weathers x 5 severities through each pipeline, one process, with and without shared messages, compares the run
folders, and prints the CPU time of both.
"""

import argparse
import os
import resource
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from fbench.api.replays import replay
from fbench.api.suites.cells import RESPONSE, Response, folder_of
from fbench.api.suites.run import run_suite
from fbench.api.suites.runner import RunOptions
from fbench.replay.engine.shared import SharedLogs
from fbench.replay.setup.request import ReplayRequest
from fbench.replay.setup.source import NO_CONFIG, LogRequest

_MEASURED = {"timings.parquet", "latency.json", "host.json"}
_FAKE = "bench_suites"  # This file, as the module that a process runs
_SLEEP = "FBENCH_BENCH_SLEEP_S"


def respond() -> None:
    """Do as a worker does, but write one small file a cell."""
    pause_s = float(os.environ.get(_SLEEP, "0"))
    for line in sys.stdin:
        cell = ReplayRequest.from_json(line)
        folder_of(cell).mkdir(parents=True, exist_ok=True)
        time.sleep(pause_s)
        (folder_of(cell) / "result.txt").write_text(str(cell.seed), encoding="utf-8")
        print(RESPONSE.dump_json(Response()).decode(), flush=True)


def cells_of(folder: Path, num: int) -> list[ReplayRequest]:
    log = folder / "log.mcap"
    log.write_bytes(b"nobody reads it")
    given = LogRequest(log, config=NO_CONFIG)
    return [
        ReplayRequest(given, "lidar3d", condition="fog:3", seed=n, out=folder / "runs" / str(n), overwrite=True)
        for n in range(num)
    ]


def cpu_s() -> float:
    return sum(sum(resource.getrusage(who)[:2]) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))


def resident_mib() -> float:
    pages = int(Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
    return pages * resource.getpagesize() / 2**20


def measure_scheduling(num: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        cells, memory = cells_of(Path(folder), num), list[float]()
        run_suite(cells_of(Path(folder), 1), RunOptions(1, module=_FAKE))  # code is digested once
        start_s, start_cpu_s = time.perf_counter(), cpu_s()

        def progress(done: int, of: int) -> None:
            if done in (of // 10, of):
                memory.append(resident_mib())

        results = run_suite(cells, RunOptions(1, module=_FAKE), progress)
        wall_s, used_s = time.perf_counter() - start_s, cpu_s() - start_cpu_s
        assert all(result.has_run for result in results)
        print(f"{num} cells: {1000 * used_s / num:.2f} ms of CPU a cell (wall {1000 * wall_s / num:.2f} ms)")
        print(f"memory: {memory[0]:.0f} MiB after a tenth of the cells, {memory[-1]:.0f} MiB at the end")


def measure_sleeping(num: int, seconds: float, scheduler: str) -> None:
    os.environ[_SLEEP] = str(seconds)
    ways = [RunOptions(jobs, module=_FAKE) for jobs in (1, 2)]
    ways += [RunOptions(2, scheduler, module=_FAKE)] if scheduler else []
    for options in ways:
        with tempfile.TemporaryDirectory() as folder:
            start_s = time.perf_counter()
            results = run_suite(cells_of(Path(folder), num), options)
            wall_s = time.perf_counter() - start_s
            assert all(result.has_run for result in results), results[0].reason
            how = options.scheduler or f"{options.jobs} processes"
            print(f"{how}: {num} cells of {seconds:g} s in {wall_s:.2f} s")


def measure_sharing(log: Path, pipelines: Sequence[str]) -> None:
    texts = [f"{weather}:{severity}" for weather in ("fog", "rain", "snow", "night") for severity in range(1, 6)]
    given = LogRequest(log, config=NO_CONFIG)
    with tempfile.TemporaryDirectory() as folder:
        for name in pipelines:  # kernels are compiled or loaded
            replay(ReplayRequest(given, name, frames=":2", condition=texts[0], out=Path(folder) / f"warm-{name}"))
        used_s = {}
        for way in ("alone", "shared"):
            start_s = cpu_s()
            with SharedLogs(1 << 30) as logs:
                for text in texts:
                    for name in pipelines:
                        out = Path(folder) / way / text.replace(":", "-") / name
                        shared = logs if way == "shared" else None
                        replay(ReplayRequest(given, name, condition=text, out=out, no_media=True), shared=shared)
            used_s[way] = cpu_s() - start_s
        alone, together = (_contents(Path(folder) / way) for way in ("alone", "shared"))
        assert alone == together
        num = len(texts) * len(pipelines)
        gain = 1 - used_s["shared"] / used_s["alone"]
        print(
            f"{num} cells: {used_s['alone']:.1f} s of CPU alone, {used_s['shared']:.1f} s shared ({100 * gain:.0f} %)"
        )


def _contents(folder: Path) -> dict[str, bytes]:
    files = (path for path in sorted(folder.rglob("*")) if path.is_file() and path.name not in _MEASURED)
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in files}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("scheduling", "sleeping", "sharing"))
    parser.add_argument("log", nargs="?", type=Path)
    parser.add_argument("--cells", type=int, default=10_000)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--scheduler", default="")
    parser.add_argument("--pipelines", default="lidar3d,radar3d")
    given = parser.parse_args()
    os.environ["PYTHONPATH"] = str(Path(__file__).parent)
    if given.what == "scheduling":
        measure_scheduling(given.cells)
    elif given.what == "sleeping":
        measure_sleeping(given.cells, given.seconds, given.scheduler)
    else:
        measure_sharing(given.log, given.pipelines.split(","))


if __name__ == "__main__":
    # A process of a suite gets how much it may keep as its only argument.
    respond() if len(sys.argv) == 2 and sys.argv[1].isdecimal() else main()
