"""The machine that a run was measured on: facts, its speed by a fixed kernel, memory, and energy.

They live in `host.json`, apart from what is equal between runs.
"""

import ctypes
import os
import platform
import re
import resource
import sys
import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from statistics import median

import numpy as np

from fbench.replay.geometry.threads import num_threads

MOST_APART = 0.1
"""Machines whose times of the reference kernel differ by a larger share are of different speed."""
REPEATS = 5
_SYSTEM = Path("/sys")
_PACKAGE = re.compile(r"intel-rapl:\d+")
_FACTS = ("cpu", "cores", "platform", "governor", "threads", "omp_threads", "numba_threads")
_SIZE, _ROUNDS = 20_000, 16


def describe_host(system: Path = _SYSTEM) -> dict[str, str | int | float | None]:
    """Describe the machine, for reading timings: processor, cores, governor of their clock, threads that pipelines and
    libraries use, and the load (processes that ran or waited in the last minute); `None`: unknown, or not set.
    """
    governor = None
    with suppress(OSError):
        path = system / "devices/system/cpu/cpu0/cpufreq/scaling_governor"
        governor = path.read_text(encoding="utf-8", errors="replace").strip()
    load = None
    with suppress(OSError):
        load = round(os.getloadavg()[0], 2)
    return {
        "cpu": _cpu(), "cores": os.cpu_count(), "platform": platform.system(), "python": platform.python_version(),
        "governor": governor, "threads": num_threads(), "omp_threads": os.environ.get("OMP_NUM_THREADS"),
        "numba_threads": os.environ.get("NUMBA_NUM_THREADS"), "load": load,
    }  # fmt: skip


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()


_CUDA_PACKAGES = ("onnxruntime-gpu", "nvidia-cudnn-cu13", "nvidia-cublas", "nvidia-cuda-runtime")
_MAX_NAME = 256


@cache
def describe_cuda() -> Mapping[str, str]:
    """Describe the first GPU that CUDA finds, and what computes on it: the `card`, the newest CUDA that its `driver`
    knows, and versions of packages. Empty where there is none.
    """
    try:
        cuda = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return {}
    number, name = ctypes.c_int(), ctypes.create_string_buffer(_MAX_NAME)
    if cuda.cuInit(0) or cuda.cuDeviceGet(ctypes.byref(number), 0) or cuda.cuDeviceGetName(name, _MAX_NAME, number):
        return {}
    found = {"card": name.value.decode(errors="replace")}
    cuda.cuDriverGetVersion(ctypes.byref(number))
    found["driver"] = f"{number.value // 1000}.{number.value % 1000 // 10}"
    for package in _CUDA_PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            found[package] = "absent"
    return found


@cache
def measure_reference_ms() -> float:
    """Return how long a fixed computation takes here [ms, wall time]: the median of a few repeats, after one that
    doesn't count, on one thread. It sorts, adds and multiplies numbers in and out of order, as pipelines do. It is
    measured once a process, as it takes tens of milliseconds.
    """
    values = np.arange(_SIZE, dtype=np.float64) * 7919 % _SIZE
    order = values.astype(np.int64)
    times = []
    for _ in range(REPEATS + 1):
        start = time.perf_counter_ns()
        for _ in range(_ROUNDS):
            ranked = np.argsort(values, kind="stable")
            moved = values[order][ranked] * 0.5 + values
            np.sqrt(moved * moved + 1.0).cumsum()
        times.append(time.perf_counter_ns() - start)
    return median(times[1:]) / 1e6


def peak_memory_mib() -> float:
    """Return the most memory [MiB] that this process had so far, or a program that it ran, if that is more."""
    unit = 1 if sys.platform == "darwin" else 1024
    peaks = (resource.getrusage(who).ru_maxrss for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return max(peaks) * unit / 2**20


@dataclass(frozen=True)
class EnergyMeter:
    """Counters of the energy that the machine used up to some time, by everything that ran on it."""

    cpu_uj: Mapping[str, tuple[int, int]]  # Of each processor [µJ], and at which number the counter begins again
    cpu_reason: str
    gpu_mj: Mapping[int, int]  # Of each GPU [mJ]
    gpu_reason: str

    @classmethod
    def read(cls, system: Path = _SYSTEM) -> "EnergyMeter":
        """Read the counters: RAPL of processors, NVML of GPUs where its Python package is installed."""
        return cls(*_read_rapl(system / "class/powercap"), *_read_nvml())

    def describe_use(self, system: Path = _SYSTEM) -> dict[str, str | float | None]:
        """Return the energy [J] used since; `None`, with a reason, where the machine doesn't tell."""
        now = EnergyMeter.read(system)
        cpu: list[float] = [
            (used if (used := now.cpu_uj[name][0] - begin) >= 0 else used + limit) / 1e6
            for name, (begin, limit) in self.cpu_uj.items()
            if name in now.cpu_uj
        ]
        gpu: list[float] = [
            (now.gpu_mj[index] - begin) / 1e3 for index, begin in self.gpu_mj.items() if index in now.gpu_mj
        ]
        found: dict[str, str | float | None] = {}
        for name, joules, reason in (("cpu", cpu, now.cpu_reason), ("gpu", gpu, now.gpu_reason)):
            found[f"{name}_energy_j"] = round(sum(joules), 3) if joules else None
            found |= {} if joules else {f"{name}_energy_reason": reason or "its counter couldn't be read at the start"}
        return found


def _read_rapl(folder: Path) -> tuple[dict[str, tuple[int, int]], str]:
    counters: dict[str, tuple[int, int]] = {}
    try:
        names = sorted(path.name for path in folder.iterdir() if _PACKAGE.fullmatch(path.name))
        for name in names:
            used, limit = (
                int((folder / name / file).read_text(encoding="ascii")) for file in ("energy_uj", "max_energy_range_uj")
            )
            counters[name] = used, limit
    except PermissionError:
        return {}, "RAPL counters can be read by root only"
    except (OSError, ValueError):
        return {}, "no RAPL counter can be read"
    return counters, "" if counters else "no RAPL counter here"


def _read_nvml() -> tuple[dict[int, int], str]:
    if find_spec("pynvml") is None:
        return {}, "no Python package of NVML (pynvml) is installed"
    nvml = import_module("pynvml")
    try:
        nvml.nvmlInit()
        handles = [nvml.nvmlDeviceGetHandleByIndex(index) for index in range(nvml.nvmlDeviceGetCount())]
        used = {index: int(nvml.nvmlDeviceGetTotalEnergyConsumption(handle)) for index, handle in enumerate(handles)}
        nvml.nvmlShutdown()
    except nvml.NVMLError as error:
        return {}, f"NVML gives no energy ({error})"
    return used, "" if used else "no GPU here"


def compare_hosts(base: Mapping[str, object], head: Mapping[str, object]) -> list[str]:
    """Return why latencies of two runs can't be compared, by their `host.json`; empty where they can: the same
    processor and settings, and times of the reference kernel at most 10 % apart.
    """
    shown = [{name: "unknown" if side.get(name) is None else side[name] for name in _FACTS} for side in (base, head)]
    found = [f"{name} {shown[0][name]} and {shown[1][name]}" for name in _FACTS if shown[0][name] != shown[1][name]]
    overlaps = [side.get("overlap", 1) for side in (base, head)]
    cards = [side.get("card", "the CPU") for side in (base, head)]
    found += [f"networks on {cards[0]} and {cards[1]}"] if cards[0] != cards[1] else []
    found += [f"frames overlapped in {overlaps[0]} and {overlaps[1]} processes"] if overlaps[0] != overlaps[1] else []
    times = [side.get("reference_ms") for side in (base, head)]
    known = [float(value) for value in times if isinstance(value, int | float) and value > 0]
    if len(known) < len(times):
        return [*found, "the time of the reference kernel isn't known of both"]
    if max(known) > min(known) * (1 + MOST_APART):
        found.append(f"the reference kernel took {known[0]:.3g} ms and {known[1]:.3g} ms")
    return found
