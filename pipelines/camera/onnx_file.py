"""Reading weights: a file from a stranger becomes a session, or an error in one line."""

from pathlib import Path
from typing import Any

import onnxruntime

from fbench.pipelines.camera.external import refers_to_files
from fbench.pipelines.camera.layouts import ModelHeader, Port
from fbench.replay.errors import ConfigError, ModelError

# onnxruntime's exceptions derive from Exception one by one; these are all that loading and running raise.
ORT_ERRORS = (
    onnxruntime.capi.onnxruntime_pybind11_state.EPFail,
    onnxruntime.capi.onnxruntime_pybind11_state.Fail,
    onnxruntime.capi.onnxruntime_pybind11_state.InvalidArgument,
    onnxruntime.capi.onnxruntime_pybind11_state.InvalidGraph,
    onnxruntime.capi.onnxruntime_pybind11_state.InvalidProtobuf,
    onnxruntime.capi.onnxruntime_pybind11_state.NoSuchFile,
    onnxruntime.capi.onnxruntime_pybind11_state.NotImplemented,
    onnxruntime.capi.onnxruntime_pybind11_state.RuntimeException,
    RuntimeError,
    ValueError,
)


def load(path: Path, threads: int) -> Any:
    """Open weights on the CPU.

    Raises:
        ConfigError: where the file is missing.
        ModelError: where it isn't an ONNX model, refers to other files, or can't be run.
    """
    data = _content(path)
    if refers_to_files(data):
        raise ModelError("the model keeps weights in other files, export it as one file")
    try:
        # Its fallback prints, and tries the same provider again.
        return onnxruntime.InferenceSession(
            data, _options(threads), providers=["CPUExecutionProvider"], enable_fallback=0
        )
    except ORT_ERRORS as error:
        raise ModelError(f"not an ONNX model that can be run ({first_line(error)})") from error


def _content(path: Path) -> bytes:
    try:
        if path.exists() and not path.is_file():  # a FIFO would block, a device could go on for ever
            raise ConfigError(f"{path}: weights can't be read (not a regular file)")
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: weights can't be read ({error.strerror or error})") from error
    except ValueError as error:  # a name that no file can have
        raise ConfigError(f"{path}: weights can't be read ({error})") from error


def header(session: Any) -> ModelHeader:
    """Inputs, outputs and metadata of a session."""
    return ModelHeader(
        tuple(_port(p) for p in session.get_inputs()),
        tuple(_port(p) for p in session.get_outputs()),
        dict(session.get_modelmeta().custom_metadata_map),
    )


def first_line(error: Exception) -> str:
    """The first line of an error's text, shortened."""
    return (str(error).splitlines() or [type(error).__name__])[0][:200]


def _port(value: Any) -> Port:
    return Port(value.name, value.type, tuple(s if isinstance(s, int) else None for s in value.shape))


def _options(threads: int) -> Any:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.execution_mode = onnxruntime.ExecutionMode.ORT_SEQUENTIAL
    options.use_deterministic_compute = True
    # Idle threads that spin cost half as much CPU again, and slow everything where cores are shared.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.log_severity_level = 4  # what matters comes back as an exception
    return options
