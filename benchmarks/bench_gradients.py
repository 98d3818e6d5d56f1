"""Gradients of a channelwise convolution's weights: `network.correlate` against PyTorch's, in one process, on equal
inputs of the sizes that the trainings have.

    python benchmarks/bench_gradients.py [--threads 2]

Prints the best of several turns, and the ratio.
"""

import argparse
from functools import partial

import torch
from common import best_by_turns_s
from torch import Tensor

from fbench.pipelines.models.network import correlate

SIZES = (("learned3d", 12, 104, 104), ("learned3d", 12, 52, 52), ("camera, rgbd", 12, 32, 40))
WIDTH, SIDE = 64, 5


def pytorch_gradient(x: Tensor, change: Tensor) -> Tensor:
    """Return what `correlate` does, by PyTorch's own backward pass."""
    weight, pad = torch.zeros(WIDTH, 1, SIDE, SIDE), [SIDE // 2, SIDE // 2]
    only_weight = [False, True, False]
    found = torch.ops.aten.convolution_backward(
        change, x, weight, None, [1, 1], pad, [1, 1], False, [0, 0], WIDTH, only_weight
    )
    gradient: Tensor = found[1]
    return gradient


def main() -> None:
    """Compare them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--threads", type=int, default=2)
    torch.set_num_threads(parser.parse_args().threads)
    draw = torch.Generator().manual_seed(1)
    for model, batch, height, width in SIZES:
        x, change = (
            torch.randn(batch, WIDTH, height, width, generator=draw).contiguous(memory_format=torch.channels_last)
            for _ in range(2)
        )
        torch.testing.assert_close(correlate(x, change, SIDE), pytorch_gradient(x, change), rtol=1e-3, atol=1e-2)
        both = {"ours": partial(correlate, x, change, SIDE), "theirs": partial(pytorch_gradient, x, change)}
        ours, theirs = best_by_turns_s(both, 9).values()
        text = f"{model}, {batch} x {WIDTH} x {height} x {width}: {1e3 * ours:.1f} ms, PyTorch {1e3 * theirs:.1f} ms"
        print(f"{text}, {theirs / ours:.1f} times as fast")


if __name__ == "__main__":
    main()
