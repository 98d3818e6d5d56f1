"""Whether networks can run on a GPU here."""

import pytest

from fbench.pipelines.sensors.camera.providers import has_cuda
from fbench.replay.runs.host import describe_cuda

HAS_CUDA = has_cuda() and bool(describe_cuda())
needs_cuda = pytest.mark.skipif(not HAS_CUDA, reason="onnxruntime has no CUDA provider here, or there is no GPU")
