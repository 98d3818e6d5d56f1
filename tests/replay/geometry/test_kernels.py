import subprocess
import sys
from pathlib import Path

import numba
import pytest

from fbench.replay.data.files import fbench_cache
from fbench.replay.geometry import kernels
from fbench.replay.geometry.kernels import kernel, kernel_part

SOURCE = """
import other
from fbench.replay.geometry.kernels import kernel, kernel_digest
from other import FACTOR

@kernel
def scale(value: int) -> int:
    return FACTOR * other.double(value)

print(scale(21), kernel_digest(scale))
"""
OTHER = """
from fbench.replay.geometry.kernels import kernel, kernel_part

FACTOR = 1

@kernel_part
def double(value: int) -> int:
    return 2 * value

@kernel
def unused(value: int) -> int:
    return 3 * value
"""


LIMIT = 7


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(sys, "platform", "linux")
    return tmp_path / "cache"


@pytest.fixture
def sources(tmp_path: Path) -> Path:
    folder = tmp_path / "sources"
    folder.mkdir()
    (folder / "loops.py").write_text(SOURCE)
    (folder / "other.py").write_text(OTHER)
    return folder


def run(sources: Path) -> str:
    """What the program prints: 42, and the digest of its kernel."""
    return subprocess.run(
        [sys.executable, "-B", sources / "loops.py"], capture_output=True, text=True, check=True
    ).stdout


def machine_code(cache: Path) -> dict[str, int]:
    return {path.name: path.stat().st_mtime_ns for path in cache.rglob("*.nbc")}


@pytest.mark.slow
def test_kernels_run_and_leave_machine_code_under_their_digest(cache: Path, sources: Path):
    answer, digest = run(sources).split()
    assert answer == "42"
    before = machine_code(cache / "fbench" / "kernels")
    assert [name for name in before if f"scale-{digest}" in name]
    assert len(before) == 2
    assert run(sources).split() == ["42", digest]
    assert machine_code(cache) == before


@pytest.mark.slow
def test_kernels_on_disk_run_without_what_only_a_compiler_needs(cache: Path, sources: Path):
    (sources / "loops.py").write_text("""
import sys
import numpy as np
from fbench.replay.geometry.kernels import kernel

@kernel
def double(values):
    result = np.empty(len(values))  # allocated by numba's runtime
    for i in range(len(values)):
        result[i] = 2 * values[i]
    return result

print(double(np.ones(1000)).sum(), double(np.arange(3)).tolist(), "scipy.linalg" in sys.modules)
""")
    assert run(sources) == "2000.0 [0.0, 2.0, 4.0] True\n"
    assert run(sources) == "2000.0 [0.0, 2.0, 4.0] False\n"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("kernel_part\n", "kernel_part  # a comment\n"),
        ("3 * value", "4 * value"),
        ("FACTOR = 1\n", "\nFACTOR = 1\n\n\n"),
    ],
)
def test_what_a_kernel_does_not_call_costs_it_nothing(cache: Path, sources: Path, old: str, new: str):
    first = run(sources)
    before = machine_code(cache)
    (sources / "other.py").write_text(OTHER.replace(old, new))
    (sources / "loops.py").write_text(SOURCE.replace("@kernel", "# Another comment.\n@kernel"))
    assert run(sources) == first
    assert machine_code(cache) == before


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "answer"), [("FACTOR = 1", "FACTOR = 2", "84"), ("2 * value", "3 * value", "63")]
)
def test_what_a_kernel_calls_in_another_file_compiles_it_anew(
    cache: Path, sources: Path, old: str, new: str, answer: str
):
    digest = run(sources).split()[1]
    (sources / "other.py").write_text(OTHER.replace(old, new))
    now = run(sources).split()
    assert now[0] == answer
    assert now[1] != digest


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "damage"), [("*.nbi", "empty"), ("*.nbi", "garbage"), ("*.nbc", "half")])
def test_damaged_machine_code_is_replaced(cache: Path, sources: Path, kind: str, damage: str):
    wanted = run(sources)
    (path,) = cache.rglob(f"loops.scale-{kind}")
    whole = path.read_bytes()
    path.write_bytes({"empty": b"", "half": whole[: len(whole) // 2], "garbage": b"\xffgarbage"}[damage])
    assert run(sources) == wanted
    assert len(path.read_bytes()) == len(whole)
    assert run(sources) == wanted


@pytest.mark.slow
def test_a_disk_that_fills_while_machine_code_is_saved(cache: Path, sources: Path):
    # No file may grow beyond a byte: the folder can be made, and nothing can be kept in it.
    code = "import resource, runpy, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
    code += "sys.path.insert(0, sys.argv[1].rpartition('/')[0]); "
    code += "resource.setrlimit(resource.RLIMIT_FSIZE, (1, 1)); runpy.run_path(sys.argv[1])"
    done = subprocess.run([sys.executable, "-c", code, sources / "loops.py"], capture_output=True, text=True)
    assert (done.returncode, done.stdout[:3], done.stderr) == (0, "42 ", "")
    assert not list(cache.rglob("*.nbc"))


@kernel_part
def part(value: int) -> int:
    return 2 * value


@kernel
def whole(value: int) -> int:
    return part(value) + 1


def test_python_cannot_call_a_part_of_a_kernel(cache: Path):
    assert whole(3) == 7
    for value in (3, 3.0):  # of these types one is compiled already
        with pytest.raises(TypeError, match="part is part of a kernel: only kernels can call it"):
            part(value)


def test_versions_and_globals_change_the_digest(monkeypatch: pytest.MonkeyPatch):
    def loop(values):
        """Read a constant of this module."""
        return [value * LIMIT for value in values]

    before = kernels.kernel_digest(loop)
    monkeypatch.setitem(globals(), "LIMIT", 8)
    other = kernels.kernel_digest(loop)
    monkeypatch.setattr(numba, "__version__", "0.0")
    assert len({before, other, kernels.kernel_digest(loop)}) == 3


@pytest.mark.slow
def test_without_a_writable_cache_kernels_still_run(sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert run(sources).startswith("42 ")


def test_a_relative_cache_folder_is_ignored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("FBENCH_CACHE", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", "here")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert fbench_cache() == tmp_path / ".cache" / "fbench"


def test_all_caches_may_be_elsewhere(cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("FBENCH_CACHE", str(tmp_path / "mine"))
    assert fbench_cache() == tmp_path / "mine"
    monkeypatch.setenv("FBENCH_CACHE", "")
    assert fbench_cache() == cache / "fbench"


def test_decorating_leaves_numbas_own_cache_folder_alone(cache: Path):
    before = numba.config.CACHE_DIR
    kernels.kernel(lambda value: value)
    assert before == numba.config.CACHE_DIR


def test_the_command_line_starts_without_numba():
    code = "import sys, fbench.cli; assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
