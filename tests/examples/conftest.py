"""Examples as users have them: compiled, or on the path."""

import importlib
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples" / "exec"


@pytest.fixture(scope="session")
def cpp(tmp_path_factory):
    """Folder with the compiled C++ examples."""
    if not shutil.which("cmake") or not shutil.which("g++"):
        pytest.skip("no cmake or no g++ here")
    build = tmp_path_factory.mktemp("build")
    for command in (["cmake", "-S", EXAMPLES / "cpp", "-B", build], ["cmake", "--build", build]):
        result = subprocess.run(command, capture_output=True, text=True)
        assert result.returncode == 0, result.stdout + result.stderr
        assert "warning" not in result.stdout + result.stderr
    return build


@pytest.fixture
def importable(monkeypatch):
    """Imports a Python example by its name; it is forgotten afterwards."""
    for folder in ("python", "ros2"):
        monkeypatch.syspath_prepend(str(EXAMPLES / folder))
    yield importlib.import_module
    for name in ("client", "nearest", "conversions", "bridge_node"):
        sys.modules.pop(name, None)


@pytest.fixture(scope="session")
def boxes(tmp_path_factory):
    """Three seconds of the built-in log."""
    from tests.city_log import write_city_log

    path: Path = tmp_path_factory.mktemp("log") / "city.mcap"
    write_city_log(path, 3.0)
    return path
