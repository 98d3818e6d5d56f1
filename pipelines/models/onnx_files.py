"""Networks as ONNX files: written with a card, and read again to be trained further."""

import io
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path

import numpy as np
import onnx
import torch
from google.protobuf.message import DecodeError
from onnx import numpy_helper
from torch import Tensor, nn

from fbench.pipelines.sensors.camera.model import read_model
from fbench.replay.contracts.errors import ModelError


def convert(network: nn.Module, blank: Tensor, ports: tuple[str, str]) -> onnx.ModelProto:
    """Return a network as an ONNX model, whose input and output are called `ports` and may hold any number of inputs
    such as `blank`.
    """
    content = io.BytesIO()
    with warnings.catch_warnings():
        # The newer exporter needs another package, and gives the same graph.
        warnings.simplefilter("ignore", DeprecationWarning)
        torch.onnx.export(
            network.eval(), (blank,), content, dynamo=False, opset_version=17, input_names=[ports[0]],
            output_names=[ports[1]], dynamic_axes={name: {0: "batch"} for name in ports},
        )  # fmt: skip
    return onnx.load_model_from_string(content.getvalue())


def save(model: onnx.ModelProto, path: Path, card: Mapping[str, str]) -> None:
    """Write a model whole or not at all; the card becomes its metadata."""
    onnx.helper.set_model_props(model, dict(card))
    part = path.with_suffix(".part")
    onnx.save(model, str(part))
    part.replace(path)


@dataclass(frozen=True)
class FirstWeights:
    """The file from which a training starts, as it was before the training."""

    path: Path
    content: bytes

    @property
    def sha256(self) -> str:
        """Of the content."""
        return sha256(self.content).hexdigest()


def read_weights(path: Path) -> FirstWeights:
    """Read an ONNX file. Raises ConfigError where it can't be read, ModelError where it isn't one, or refers to other
    files.
    """
    try:
        return FirstWeights(path, read_model(path))
    except ModelError as error:
        raise ModelError(f"{path}: {error}") from error


def load_weights(network: nn.Module, weights: FirstWeights) -> None:
    """Give a network the weights of a file that was exported from such a network. In the file, convolutions include
    batch normalization, so that of the network becomes the identity plus a shift. Raises ModelError where the file is
    damaged, or was exported from another network.
    """
    try:
        graph = onnx.load_model_from_string(weights.content).graph
        tensors = _index_tensors(graph)
        nodes = [node for node in graph.node if node.op_type == "Conv"]
        found = [[tensors.get(name) for name in node.input[1:]] for node in nodes]
        shapes = [
            [_read_strides(node), *(tuple(one.dims) if one else () for one in pair)]
            for node, pair in zip(nodes, found, strict=True)
        ]
        convs = _in_order(network)
        if graph.node and shapes != [[conv.stride, tuple(conv.weight.shape), (conv.out_channels,)] for conv in convs]:
            raise ModelError(f"{weights.path}: weights of another network than the one to be trained (--model)")
        values = [[_read_floats(one) for one in pair if one is not None] for pair in found]
    except (DecodeError, ValueError, IndexError) as error:
        raise ModelError(f"{weights.path}: damaged, or not an ONNX file") from error
    if not values:
        raise ModelError(f"{weights.path}: damaged, or not an ONNX file")
    norms = {
        part[0]: part[1]
        for part in network.modules()
        if isinstance(part, nn.Sequential) and len(part) > 1 and isinstance(part[1], nn.BatchNorm2d)
    }
    with torch.no_grad():
        for conv, (weight, bias) in zip(convs, values, strict=True):
            conv.weight.copy_(weight)
            norm = norms.get(conv)
            if norm is not None:
                norm.reset_parameters()
                norm.running_var.fill_(1 - norm.eps)
            (conv.bias if norm is None else norm.bias).copy_(bias)


def _index_tensors(graph: onnx.GraphProto) -> dict[str, onnx.TensorProto]:
    """Return the values in a file by name; those that several nodes share are in it once."""
    tensors = {one.name: one for one in graph.initializer}
    for node in graph.node:
        if node.op_type == "Identity" and node.input[:1] and node.input[0] in tensors:
            tensors[node.output[0]] = tensors[node.input[0]]
    return tensors


def _read_strides(node: onnx.NodeProto) -> tuple[int, ...]:
    """Of a convolution, in cells: 1 each way where it doesn't say."""
    return next((tuple(one.ints) for one in node.attribute if one.name == "strides"), (1, 1))


def _read_floats(tensor: onnx.TensorProto) -> Tensor:
    """Raises ValueError where a tensor doesn't hold as many finite numbers of single precision as it says."""
    if tensor.data_type != onnx.TensorProto.FLOAT:
        raise ValueError("not of single precision")
    values = np.array(numpy_helper.to_array(tensor))
    if not np.isfinite(values).all():
        raise ValueError("not finite")
    return torch.from_numpy(values)


def _in_order(network: nn.Module) -> list[nn.Conv2d]:
    """The convolutions of a network in the order in which they run, as a file has them."""
    found = list[nn.Conv2d]()
    convs = [part for part in network.modules() if isinstance(part, nn.Conv2d)]
    hooks = [conv.register_forward_hook(lambda one, _given, _result: found.append(one)) for conv in convs]
    with torch.no_grad():
        network.eval()(torch.zeros(1, convs[0].in_channels, 64, 64))
    for hook in hooks:
        hook.remove()
    return found
