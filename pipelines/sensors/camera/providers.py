"""Execution providers of onnxruntime: the CPU, or CUDA with settings under which results repeat; never one for another.

Settings: https://onnxruntime.ai/docs/execution-providers/CUDA-ExecutionProvider.html
"""

import contextlib
import io
from collections.abc import Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Any

import onnxruntime

from fbench.replay.contracts.devices import current_execution, note_provider
from fbench.replay.contracts.errors import ConfigError
from fbench.replay.runs.host import describe_cuda

CPU, CUDA = "CPUExecutionProvider", "CUDAExecutionProvider"
CUDA_OPTIONS: Mapping[str, str] = {
    "use_tf32": "0",  # TF32 keeps 10 bits of each factor
    # cuDNN's heuristic gave equal bytes in each session and run on an H100; without it, convolutions that keep float32
    # fall back to code that is twenty times as slow.
    "cudnn_conv_algo_search": "HEURISTIC",
    "do_copy_in_default_stream": "1",
}
_PACKAGE = f"onnxruntime-gpu[cuda,cudnn]=={onnxruntime.__version__}"
INSTALL_LIBRARIES = f"pip install '{_PACKAGE}' brings NVIDIA's libraries"
_INSTALL = f"pip uninstall onnxruntime onnxruntime-gpu, then pip install '{_PACKAGE}' (see docs/learned.md)"
_FATAL = 4  # Of its levels of logging


def open_session(data: bytes, options: Any) -> Any:
    """Open a model on the device that was chosen. Raises ConfigError where that is CUDA and it can't be used; else as
    onnxruntime does.
    """
    if current_execution().device == "cpu":
        providers: list[Any] = [CPU]
    else:
        _require_cuda()
        onnxruntime.set_default_logger_severity(_FATAL)  # what matters is raised below
        lines = _preload()
        providers = [(CUDA, dict(CUDA_OPTIONS)), CPU]
    # Its fallback prints, and tries the same provider again.
    session = onnxruntime.InferenceSession(data, options, providers=providers, enable_fallback=0)
    used = session.get_providers()
    if len(providers) > 1 and used[:1] != [CUDA]:  # it goes on with the CPU
        raise ConfigError(f"--device cuda: onnxruntime can't load its CUDA provider ({lines}); {INSTALL_LIBRARIES}")
    note_provider(used[0])
    return session


def _require_cuda() -> None:
    if CUDA not in onnxruntime.get_available_providers():
        try:
            found = f"onnxruntime was installed over onnxruntime-gpu {version('onnxruntime-gpu')}, and hides it"
        except PackageNotFoundError:
            found = f"onnxruntime {onnxruntime.__version__} runs networks on the CPU only"
        raise ConfigError(f"--device cuda: {found}; {_INSTALL}")
    if not describe_cuda():
        raise ConfigError("--device cuda: NVIDIA's driver isn't installed here, or finds no GPU; see nvidia-smi")


def _preload() -> str:
    """Load NVIDIA's libraries from Python packages, where there are such; return why one can't be loaded."""
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        onnxruntime.preload_dlls()
    return next(iter(printed.getvalue().splitlines()), "it doesn't say why")
