"""From a trained network to an ONNX file that says what it is."""

import warnings
from pathlib import Path

import onnx
import torch
from torch import Tensor, nn

from fbench.pipelines.training.network import CityDetector, cells
from fbench.pipelines.training.settings import CLASSES, INPUT_WH

THRESHOLDS = {"min_score": 0.6, "nms_iou": 0.6, "nms_containment": 1.0}
"""What the file recommends: `min_score` gives the best F1 on development seeds 106 to 108; far vehicles
are often wholly inside the rectangle of a near one, so containment doesn't make them duplicates.
"""


class _Exported(nn.Module):
    """Boxes and scores as YOLOv8 gives them: (B, 4 + C, N) with centre, size and scores."""

    def __init__(self, network: CityDetector) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> Tensor:
        logits, boxes = self.network(images)
        low, high = boxes[:, :2], boxes[:, 2:]
        return torch.cat([(low + high) / 2, high - low, logits.sigmoid()], 1)


def export(network: CityDetector, path: Path) -> None:
    """Write an ONNX file: input `images` (B, 3, 480, 640) RGB 0 to 1, output `boxes` (B, 4 + C, N)."""
    part = path.with_suffix(".part")
    blank = torch.zeros(1, 3, INPUT_WH[1], INPUT_WH[0])
    with warnings.catch_warnings():
        # The newer exporter needs another package, and gives the same graph.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            _Exported(network.cpu().eval()).eval(), (blank,), str(part), dynamo=False, opset_version=17,
            input_names=["images"], output_names=["boxes"],
            dynamic_axes={"images": {0: "batch"}, "boxes": {0: "batch"}},
        )  # fmt: skip
    model = onnx.load(str(part))
    said = {"names": repr(dict(enumerate(CLASSES))), **{name: str(value) for name, value in THRESHOLDS.items()}}
    _tell_shape(model.graph.output[0], ("batch", 4 + len(CLASSES), cells(*INPUT_WH).shape[1]))
    onnx.helper.set_model_props(model, {"description": "fbench's detector for its simulated city", **said})
    onnx.save(model, str(part))
    part.replace(path)


def _tell_shape(port: onnx.ValueInfoProto, shape: tuple[str | int, ...]) -> None:
    """Say what the exporter forgot: readers tell families of models apart by it."""
    told = onnx.helper.make_tensor_value_info(port.name, onnx.TensorProto.FLOAT, list(shape))
    port.CopyFrom(told)
