"""Networks as ONNX files: written with a card, and read again to be trained further."""

import io
import warnings
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import onnx
import torch
from google.protobuf.message import DecodeError
from torch import Tensor, nn

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


def take_weights(network: nn.Module, path: Path) -> None:
    """Give a network the weights of a file that was made of such a network. The file's convolutions hold what
    normalization did to their outputs; that of the network does nothing from then on. Raises ModelError where the file
    can't be read, or was made of another network.
    """
    try:
        model = onnx.load(str(path))
    except OSError as error:
        raise ModelError(f"{path}: can't be read ({error.strerror})") from error
    except DecodeError as error:
        raise ModelError(f"{path}: no ONNX file, or a damaged one") from error
    values = {one.name: onnx.numpy_helper.to_array(one) for one in model.graph.initializer}
    for node in model.graph.node:
        if node.op_type == "Identity" and node.input[0] in values:  # what several share is in the file once
            values[node.output[0]] = values[node.input[0]]
    found = [[values.get(name) for name in node.input[1:]] for node in model.graph.node if node.op_type == "Conv"]
    own = _in_order(network)
    shapes = [[None if value is None else value.shape for value in pair] for pair in found]
    if shapes != [[tuple(conv.weight.shape), (conv.out_channels,)] for conv in own]:
        raise ModelError(f"{path}: made of another network than the one to be trained")
    norms = {
        part[0]: part[1]
        for part in network.modules()
        if isinstance(part, nn.Sequential) and len(part) > 1 and isinstance(part[1], nn.BatchNorm2d)
    }
    with torch.no_grad():
        for conv, (weight, bias) in zip(own, found, strict=True):
            conv.weight.copy_(torch.from_numpy(np.array(weight)))
            norm = norms.get(conv)
            if norm is not None:
                norm.reset_parameters()
                norm.running_var.fill_(1 - norm.eps)
            shift = conv.bias if norm is None else norm.bias
            shift.copy_(torch.from_numpy(np.array(bias)))


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
