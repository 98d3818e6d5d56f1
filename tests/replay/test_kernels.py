import subprocess
import sys
from pathlib import Path

import numba
import pytest

from fbench.replay.geometry import kernels
from fbench.replay.geometry.kernels import user_cache

SOURCE = """
from fbench.replay.geometry.kernels import kernel

@kernel
def twice(value: int) -> int:
    return 2 * value

print(twice(21))
"""


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
    (folder / "other.py").write_text("a = 1\n")
    return folder


def run(sources: Path) -> str:
    return subprocess.run([sys.executable, sources / "loops.py"], capture_output=True, text=True, check=True).stdout


@pytest.mark.slow
def test_kernels_run_and_leave_machine_code_in_the_folder_of_their_digest(cache: Path, sources: Path):
    assert run(sources) == "42\n"
    folder = cache / "fbench" / "kernels" / kernels.kernel_digest(sources)
    assert list(folder.rglob("*.nbc"))
    assert run(sources) == "42\n"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["*.nbi", "*.nbc"])
@pytest.mark.parametrize("damage", ["empty", "half", "garbage"])
def test_damaged_machine_code_is_replaced(cache: Path, sources: Path, kind: str, damage: str):
    run(sources)
    (path,) = cache.rglob(kind)
    whole = path.read_bytes()
    path.write_bytes({"empty": b"", "half": whole[: len(whole) // 2], "garbage": b"\xffgarbage"}[damage])
    assert run(sources) == "42\n"
    assert len(path.read_bytes()) == len(whole)
    assert run(sources) == "42\n"


@pytest.mark.slow
def test_a_disk_that_fills_while_machine_code_is_saved(cache: Path, sources: Path):
    # No file may grow beyond a byte: the folder can be made, and nothing can be kept in it.
    code = "import resource, runpy, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
    code += "resource.setrlimit(resource.RLIMIT_FSIZE, (1, 1)); runpy.run_path(sys.argv[1])"
    done = subprocess.run([sys.executable, "-c", code, sources / "loops.py"], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "42\n", "")
    assert not list(cache.rglob("*.nbc"))


def test_a_change_beside_the_kernel_starts_an_empty_cache(cache: Path, sources: Path):
    before = kernels.cache_folder(sources)
    (sources / "other.py").write_text("a = 2\n")
    after = kernels.cache_folder(sources)
    assert before is not None
    assert after is not None
    assert before != after
    assert not list(after.iterdir())


def test_renamed_sources_change_the_digest(sources: Path):
    before = kernels.kernel_digest(sources)
    (sources / "other.py").rename(sources / "another.py")
    assert kernels.kernel_digest(sources) != before


def test_versions_change_the_digest(sources: Path, monkeypatch: pytest.MonkeyPatch):
    before = kernels.kernel_digest(sources)
    monkeypatch.setattr(numba, "__version__", "0.0")
    assert kernels.kernel_digest(sources) != before


@pytest.mark.slow
def test_without_a_writable_cache_kernels_still_run(sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    assert kernels.cache_folder(sources) is None
    assert run(sources) == "42\n"


def test_without_a_home_there_is_no_cache(sources: Path, monkeypatch: pytest.MonkeyPatch):
    def homeless() -> Path:
        raise RuntimeError("no home")

    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(Path, "home", homeless)
    assert kernels.cache_folder(sources) is None


def test_a_relative_cache_folder_is_ignored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "here")
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    assert user_cache() == tmp_path / ".cache"


def test_all_caches_may_be_elsewhere(cache: Path, sources: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("FBENCH_CACHE", str(tmp_path / "mine"))
    assert kernels.cache_folder(sources).is_relative_to(tmp_path / "mine" / "kernels")
    monkeypatch.setenv("FBENCH_CACHE", "")
    assert kernels.cache_folder(sources).is_relative_to(cache / "fbench" / "kernels")


def test_decorating_leaves_numbas_own_cache_folder_alone(cache: Path):
    before = numba.config.CACHE_DIR
    kernels.kernel(lambda value: value)
    assert before == numba.config.CACHE_DIR


def test_the_command_line_starts_without_numba():
    code = "import sys, fbench.cli; assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
