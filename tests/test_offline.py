"""Whole commands in a process that the system kills when it opens a socket of any kind."""

import ctypes
import platform
import struct
import subprocess
import sys
from pathlib import Path

import pytest
from tests.cli.conftest import messages, truths, write_log

_SOCKET = {"x86_64": (0xC000003E, 41), "aarch64": (0xC00000B7, 198)}
"""The architecture as the kernel audits it, and the number of the call."""
_KILLED_BY_SIGSYS = -31
WEIGHTS = Path(__file__).resolve().parents[1] / "pipelines" / "sensors" / "camera" / "city.onnx"


def forbid_sockets() -> None:
    """Have this process and all that it starts killed at the first call of socket() (seccomp, without privileges)."""
    arch, number = _SOCKET[platform.machine()]
    load, jump_if, end = 0x20, 0x15, 0x06  # BPF_LD|W|ABS, BPF_JMP|JEQ|K, BPF_RET|K
    allow, kill = 0x7FFF0000, 0x80000000
    code = [(load, 0, 0, 4), (jump_if, 0, 3, arch), (load, 0, 0, 0), (jump_if, 0, 1, number), (end, 0, 0, kill)]
    program = b"".join(struct.pack("HBBI", *line) for line in [*code, (end, 0, 0, allow)])
    kept = ctypes.create_string_buffer(program)
    filter_ = struct.pack("HxxxxxxQ", len(code) + 1, ctypes.addressof(kept))
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.prctl(38, 1, 0, 0, 0) or libc.prctl(22, 2, ctypes.c_char_p(filter_)):
        raise OSError(ctypes.get_errno(), "no seccomp")


_CHILD = """
import sys
from tests.test_offline import forbid_sockets
try:
    forbid_sockets()
except OSError:
    sys.exit(77)
from fbench.cli import main
for line in sys.argv[1].split(";"):
    sys.argv[1:] = line.split()
    try:
        main()
    except SystemExit as stop:
        if stop.code:
            sys.exit(f"{line}: {stop.code}")
"""


def run(folder: Path, *lines: str, code: str = _CHILD) -> subprocess.CompletedProcess[str]:
    root = Path(__file__).resolve().parents[1]
    command = [sys.executable, "-c", f"import sys; sys.path.insert(0, {str(root)!r})\n{code}", ";".join(lines)]
    result = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    if result.returncode == 77 or platform.machine() not in _SOCKET:
        pytest.skip("this system has no seccomp filters")
    return result


@pytest.fixture
def folder(tmp_path):
    write_log(tmp_path / "car.mcap", [*messages(), *truths()])
    return tmp_path


def test_a_socket_would_be_noticed(tmp_path):
    code = _CHILD.replace("from fbench.cli import main", "import socket\nsocket.socket(socket.AF_UNIX)")
    assert run(tmp_path, code=code).returncode == _KILLED_BY_SIGSYS


@pytest.mark.slow
def test_no_command_opens_a_socket(folder):
    result = run(
        folder,
        "log info car.mcap",
        "log check car.mcap",
        "init car.mcap",
        "log convert car.mcap -o car.parquet",
        "replay car.mcap -p lidar3d -o lidar --report",
        f"replay car.mcap -p late3d --set camera.weights={WEIGHTS} -o late",  # onnxruntime
        f"replay car.mcap -p late3d --set camera.weights={WEIGHTS} -o apart --isolate",
        "score late",
        "compare late apart",
        "report lidar late -o report.html",
        "log preview car.mcap -o preview.html",
        "plugins",
        "weights list",
    )
    assert (result.returncode, result.stderr) == (0, "")
