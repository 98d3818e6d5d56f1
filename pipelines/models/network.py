"""The network of the city's camera detector, and its export to ONNX."""

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import onnx
import torch
from torch import Tensor, nn
from torch.nn import functional

from fbench.pipelines.models.onnx_files import convert, save
from fbench.pipelines.models.samples import CLASSES, INPUT_WH
from fbench.replay.geometry.kernels import kernel

STRIDES = (8, 16, 32)  # Pixels of the input between neighboring cells, level by level
_STEM, _WIDTHS, _NECK = 24, (56, 96, 160), 64
_PRIOR = 0.01
"""Score that every cell starts with, so that the many empty ones don't drown the others (Lin et al., ICCV 2017)."""
_LARGEST = 4.0  # Of the logarithm of a side's distance in strides: 55 of 32 px are more than any input has
Levels: TypeAlias = Sequence[Tensor]


class ChannelwiseConv(nn.Conv2d):
    """A convolution of each channel by itself, with padding and without bias. On a CPU, PyTorch takes several times as
    long as `correlate` for the gradient of its weights.
    """

    def __init__(self, width: int, side: int, stride: int) -> None:
        super().__init__(width, width, side, stride, side // 2, groups=width, bias=False)

    def forward(self, x: Tensor) -> Tensor:
        """Return the convolved channels."""
        if self.training and x.device.type == "cpu" and self.stride == (1, 1):
            y: Tensor = _ChannelwiseFunction.apply(x, self.weight)
            return y
        return super().forward(x)


class _ChannelwiseFunction(torch.autograd.Function):
    """`ChannelwiseConv` with stride 1. What its input changes is the same with turned weights."""

    @staticmethod
    def forward(ctx: Any, x: Tensor, weight: Tensor) -> Tensor:
        ctx.save_for_backward(x, weight)
        return functional.conv2d(x, weight, padding=weight.shape[-1] // 2, groups=len(weight))

    @staticmethod
    def backward(ctx: Any, *changes: Tensor) -> tuple[Tensor, Tensor]:
        x, weight = ctx.saved_tensors
        side = weight.shape[-1]
        of_x = functional.conv2d(changes[0], weight.flip(2, 3), padding=side // 2, groups=len(weight))
        return of_x, correlate(x, changes[0], side)


def correlate(x: Tensor, change: Tensor, side: int) -> Tensor:
    """Return the gradient (C, 1, `side`, `side`) of the weights of a channelwise convolution with stride 1, of its
    input and its output's gradient (B, C, H, W). Images are added in their order, whatever the number of threads.
    """
    inputs, changes = (part.detach().permute(0, 2, 3, 1).contiguous().numpy() for part in (x, change))
    sums = np.zeros((len(inputs), side, side, inputs.shape[3]), np.float32)
    with ThreadPoolExecutor(torch.get_num_threads()) as pool:
        list(pool.map(_correlate, inputs, changes, sums))
    return torch.from_numpy(sums).sum(0).permute(2, 0, 1)[:, None].contiguous()


@kernel
def _correlate(x: np.ndarray, change: np.ndarray, sums: np.ndarray) -> None:
    """Add to (s, s, C) what inputs (H, W, C) and the gradient of outputs (H, W, C) give at each offset."""
    height, width, channels = x.shape
    side = len(sums)
    for row in range(height):
        for i in range(max(0, side // 2 - row), min(side, height + side // 2 - row)):
            for column in range(width):
                for j in range(max(0, side // 2 - column), min(side, width + side // 2 - column)):
                    for c in range(channels):
                        sums[i, j, c] += x[row + i - side // 2, column + j - side // 2, c] * change[row, column, c]


class Unit(nn.Sequential):
    """A convolution with batch normalization and activation."""

    def __init__(self, num_in: int, num_out: int, side: int, stride: int = 1) -> None:
        conv = nn.Conv2d(num_in, num_out, side, stride, side // 2, bias=False)
        super().__init__(conv, *_normalize_and_activate(num_out))


class Separable(nn.Sequential):
    """A convolution of each channel, then one over channels (Howard et al. 2017)."""

    def __init__(self, width: int, side: int = 3, stride: int = 1) -> None:
        conv = ChannelwiseConv(width, side, stride)
        super().__init__(nn.Sequential(conv, *_normalize_and_activate(width)), Unit(width, width, 1))


def _normalize_and_activate(width: int) -> tuple[nn.BatchNorm2d, nn.SiLU]:
    return nn.BatchNorm2d(width, eps=1e-3, momentum=0.03), nn.SiLU()  # In place, SiLU would copy its input


class Residual(nn.Module):
    """A narrow 1x1 and a wide 3x3 convolution beside a bypass (He et al. 2016)."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.body = nn.Sequential(Unit(width, width // 2, 1), Unit(width // 2, width, 3))

    def forward(self, x: Tensor) -> Tensor:
        """Return what it adds to the input."""
        return x + self.body(x)


class Pyramid(nn.Module):
    """What is around a cell, at four scales (He et al. 2014), by maxima over growing squares."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.narrow, self.wide = Unit(width, width // 2, 1), Unit(width * 2, width, 1)

    def forward(self, x: Tensor) -> Tensor:
        """Return as many channels as came in."""
        parts = [self.narrow(x)]
        for _ in range(3):
            parts.append(functional.max_pool2d(parts[-1], 5, 1, 2))
        return self.wide(torch.cat(parts, 1))


class Backbone(nn.Module):
    """Features at the three strides."""

    def __init__(self, num_channels: int) -> None:
        super().__init__()
        self.stem = nn.Sequential(Unit(num_channels, _STEM // 2 + 4, 3, 2), Unit(_STEM // 2 + 4, _STEM, 3, 2))
        near, middle, far = _WIDTHS
        self.eighth = nn.Sequential(Unit(_STEM, near, 3, 2), Residual(near))
        self.sixteenth = nn.Sequential(Unit(near, middle, 3, 2), Residual(middle), Residual(middle))
        self.last = nn.Sequential(Unit(middle, far, 3, 2), Residual(far), Pyramid(far))

    def forward(self, image: Tensor) -> Levels:
        """Return features (B, C, H / s, W / s) of the strides s."""
        eighth = self.eighth(self.stem(image))
        sixteenth = self.sixteenth(eighth)
        return eighth, sixteenth, self.last(sixteenth)


class Neck(nn.Module):
    """Carries what coarse levels know to fine ones, and back (Liu et al. 2018)."""

    def __init__(self) -> None:
        super().__init__()
        self.inputs = nn.ModuleList([Unit(width, _NECK, 1) for width in _WIDTHS])
        self.down = nn.ModuleList([Separable(_NECK, 5) for _ in range(2)])
        self.shrink = nn.ModuleList([Separable(_NECK, 3, 2) for _ in range(2)])
        self.up = nn.ModuleList([Separable(_NECK, 5) for _ in range(2)])

    def forward(self, levels: Levels) -> Levels:
        """Return the levels, each with what the others know."""
        fine, middle, coarse = (unit(x) for unit, x in zip(self.inputs, levels, strict=True))
        middle = self.down[0](middle + functional.interpolate(coarse, scale_factor=2.0, mode="nearest"))
        fine = self.down[1](fine + functional.interpolate(middle, scale_factor=2.0, mode="nearest"))
        middle = self.up[0](middle + self.shrink[0](fine))
        return fine, middle, self.up[1](coarse + self.shrink[1](middle))


class Head(nn.Module):
    """Of every cell of a level the scores of all classes, and how far the box's four sides are. Each level has its own:
    the statistics that normalization keeps differ between them.
    """

    def __init__(self, num_classes: int) -> None:
        super().__init__()
        self.what = nn.Sequential(Separable(_NECK, 5), nn.Conv2d(_NECK, num_classes, 1))
        self.where = nn.Sequential(Separable(_NECK, 5), nn.Conv2d(_NECK, 4, 1))
        nn.init.constant_(self.what[1].bias, float(torch.logit(torch.tensor(_PRIOR))))

    def forward(self, level: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits (B, C, n) and distances of left, top, right, bottom (B, 4, n) in strides."""
        return self.what(level).flatten(2), self.where(level).clamp(max=_LARGEST).exp().flatten(2)


class CityDetector(nn.Module):
    """Logits and boxes of every cell of an image.

    Input (B, 3, H, W) RGB 0 to 1, H and W multiples of 32; with points also what `draw_channels` draws. Output: logits
    (B, C, N), boxes (B, 4, N) as left, top, right, bottom [px] from the input's upper left corner; cells level by
    level, row by row.
    """

    def __init__(self, num_classes: int, num_channels: int = 3) -> None:
        super().__init__()
        self.num_channels = num_channels
        self.backbone, self.neck = Backbone(num_channels), Neck()
        self.heads = nn.ModuleList([Head(num_classes) for _ in STRIDES])

    def forward(self, image: Tensor) -> tuple[Tensor, Tensor]:
        """See the class."""
        found = [head(level) for head, level in zip(self.heads, self.neck(self.backbone(image)), strict=True)]
        logits = torch.cat([what for what, _ in found], 2)
        sides = torch.cat([where * stride for (_, where), stride in zip(found, STRIDES, strict=True)], 2)
        points = cells(image.shape[-1], image.shape[-2]).to(image.device)
        return logits, torch.cat([points - sides[:, :2], points + sides[:, 2:]], 1)


def cell_strides(width: int, height: int) -> Tensor:
    """Strides (N,) of all cells of an input [px]."""
    nums = torch.tensor([(width // stride) * (height // stride) for stride in STRIDES])
    return torch.tensor(STRIDES, dtype=torch.float32).repeat_interleave(nums)


def cells(width: int, height: int) -> Tensor:
    """Centers (2, N) of all cells of an input [px]."""
    parts = []
    for stride in STRIDES:
        x = (torch.arange(width // stride, dtype=torch.float32) + 0.5) * stride
        y = (torch.arange(height // stride, dtype=torch.float32) + 0.5) * stride
        v, u = torch.meshgrid(y, x, indexing="ij")
        parts.append(torch.stack([u.flatten(), v.flatten()]))
    return torch.cat(parts, 1)


MIN_SCORE = {3: 0.6, 5: 0.7}
"""What the file recommends by its number of channels: with images alone the best F1 on development seeds 106 to 108,
with points that of `early2d` on seeds 107 and 109, in clear weather, by night and in dense fog.
"""
OVERLAPS = {"nms_iou": 0.6, "nms_containment": 1.0}
"""The same: far vehicles are often wholly inside the rectangle of a near one, so containment doesn't make them
duplicates.
"""


class _Exported(nn.Module):
    """Boxes and scores as YOLOv8 gives them: (B, 4 + C, N) with center, size and scores."""

    def __init__(self, network: CityDetector) -> None:
        super().__init__()
        self.network = network

    def forward(self, images: Tensor) -> Tensor:
        logits, boxes = self.network(images)
        low, high = boxes[:, :2], boxes[:, 2:]
        return torch.cat([(low + high) / 2, high - low, logits.sigmoid()], 1)


def export(network: CityDetector, path: Path, card: Mapping[str, str]) -> None:
    """Write an ONNX file: input `images` (B, 3 or 5, 480, 640) 0 to 1, output `boxes` (B, 4 + C, N); the card becomes
    its metadata.
    """
    blank = torch.zeros(1, network.num_channels, INPUT_WH[1], INPUT_WH[0])
    model = convert(_Exported(network.cpu()), blank, ("images", "boxes"))
    limits = {"min_score": MIN_SCORE[network.num_channels], **OVERLAPS}
    said = {"names": repr(dict(enumerate(CLASSES))), **{name: str(value) for name, value in limits.items()}}
    # The exporter forgot the shape, by which readers tell families of models apart.
    port, shape = model.graph.output[0], ["batch", 4 + len(CLASSES), cells(*INPUT_WH).shape[1]]
    port.CopyFrom(onnx.helper.make_tensor_value_info(port.name, onnx.TensorProto.FLOAT, shape))
    save(model, path, {"description": "fbench's detector for its simulated city", **card, **said})
