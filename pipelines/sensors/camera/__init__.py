"""Detection by camera: `detector.py`, with ONNX models in `model.py` and their families in `families.py`."""

import os

# Read when onnxruntime is imported: it would keep an id of this machine and send events to its maker.
os.environ["ORT_DISABLE_TELEMETRY"] = "1"
