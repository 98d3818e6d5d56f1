"""Whether networks can run on a GPU here."""

import onnxruntime
import pytest

from fbench.pipelines.sensors.camera.providers import CUDA
from fbench.replay.runs.host import describe_cuda

HAS_CUDA = CUDA in onnxruntime.get_available_providers() and bool(describe_cuda())
needs_cuda = pytest.mark.skipif(not HAS_CUDA, reason="onnxruntime has no CUDA provider here, or there is no GPU")
