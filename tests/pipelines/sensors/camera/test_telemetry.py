"""onnxruntime keeps no id of the machine, and fbench works where no network is."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

LOAD = """
import time
from pathlib import Path
from fbench.pipelines.sensors.camera import model
model.load(Path(model.__file__).with_name("city.onnx"), 1)
time.sleep(0.5)  # telemetry has a thread of its own
"""


def run_at_home(home: Path, *before: str) -> list[Path]:
    """Load the built-in detector in a process of its own, and return the files that it left in its home folder."""
    names = ("FBENCH_CACHE", "XDG_CACHE_HOME", "XDG_DATA_HOME", "ORT_DISABLE_TELEMETRY", "PYTHONPYCACHEPREFIX")
    env = {**{k: v for k, v in os.environ.items() if k not in names}, "HOME": str(home)}
    subprocess.run([*before, sys.executable, "-c", LOAD], env=env, check=True, capture_output=True)
    return [path for path in sorted(home.rglob("*")) if path.is_file()]


def test_a_detector_leaves_nothing_in_the_home_folder(tmp_path):
    assert run_at_home(tmp_path) == []


def test_a_detector_needs_no_network(tmp_path):
    without_network = ["unshare", "--map-root-user", "--net"]
    if not shutil.which("unshare") or subprocess.run([*without_network, "true"], capture_output=True).returncode:
        pytest.skip("this system gives no namespace without a network")
    run_at_home(tmp_path, *without_network)
