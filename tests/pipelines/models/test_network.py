import pytest

torch = pytest.importorskip("torch", reason="torch is an extra")

from torch import nn  # noqa: E402

from fbench.pipelines.models.network import ChannelwiseConv, correlate  # noqa: E402

pytestmark = pytest.mark.torch


def numbers(*shape, seed):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def test_correlate_by_hand():
    x = torch.tensor([[[[1.0, 2.0], [3.0, 4.0]]]])
    change = torch.tensor([[[[10.0, 0.0], [0.0, 1.0]]]])
    # At offset (0, 0): 10 * 1 + 1 * 4. One to the right: 10 * 2; the pixel right of the last is padding.
    assert correlate(x, change, 3)[0, 0].tolist() == [[1.0, 2.0, 0.0], [3.0, 14.0, 20.0], [0.0, 30.0, 40.0]]


@pytest.mark.parametrize("side", [1, 3, 5])
@pytest.mark.parametrize("layout", [torch.contiguous_format, torch.channels_last])
@pytest.mark.parametrize(("height", "width"), [(9, 14), (2, 3), (1, 1)])
def test_gradients_are_those_of_pytorch(side, layout, height, width):
    x = numbers(3, 6, height, width, seed=1).to(memory_format=layout)
    own, pytorch = ChannelwiseConv(6, side, 1), nn.Conv2d(6, 6, side, 1, side // 2, groups=6, bias=False)
    pytorch.load_state_dict(own.state_dict())
    found = []
    for convolution in (own, pytorch):
        given = x.clone().requires_grad_()
        y = convolution(given)
        y.backward(numbers(*y.shape, seed=2))
        found.append((y.detach(), given.grad, convolution.weight.grad))
    for mine, other in zip(*found, strict=True):
        torch.testing.assert_close(mine, other, rtol=1e-4, atol=1e-5)


def test_number_of_threads_does_not_matter():
    x, change = numbers(5, 8, 12, 12, seed=3), numbers(5, 8, 12, 12, seed=4)
    before, found = torch.get_num_threads(), []
    try:
        for threads in (1, 3):
            torch.set_num_threads(threads)
            found.append(correlate(x, change, 5))
    finally:
        torch.set_num_threads(before)
    assert torch.equal(*found)
