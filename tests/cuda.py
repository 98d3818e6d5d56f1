"""Whether networks can run on a GPU here."""

import pytest

from fbench.pipelines.sensors.camera import providers
from fbench.replay.runs.host import describe_cuda

HAS_CUDA = providers.CUDA in providers.onnxruntime.get_available_providers() and bool(describe_cuda())
needs_cuda = pytest.mark.skipif(not HAS_CUDA, reason="onnxruntime has no CUDA provider here, or there is no GPU")
