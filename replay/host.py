"""What a run depends on beyond its inputs: package versions, and the machine."""

import os
import platform
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = (
    "fbench", "numpy", "scipy", "scikit-learn", "numba", "llvmlite", "opencv-python-headless", "onnxruntime", "embreex",
    "pyarrow", "mcap", "protobuf", "rosbags",
)  # fmt: skip
"""Those that compute, compile what computes, cast the rays of simulated logs, or read values out of logs."""


def package_versions() -> dict[str, str]:
    """Versions of Python and of the packages that decide results."""
    versions = {"python": platform.python_version()}
    for name in _PACKAGES:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            versions[name] = "absent"
    return versions


def describe_host() -> dict[str, object]:
    """The machine, for reading timings."""
    return {"cpu": _cpu(), "cores": os.cpu_count(), "platform": platform.system(), "python": platform.python_version()}


def _cpu() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.machine()
