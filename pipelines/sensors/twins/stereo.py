"""Twin of `stereo.depth`: disparity by semi-global matching, and its points."""

import math
from collections.abc import Callable

import torch
from torch import Tensor
from torch.nn import functional

from fbench.pipelines.sensors.stereo.depth import HEIGHT_M, DepthParams, DisparityParams, Rectifier
from fbench.pipelines.sensors.twins.clustering import components, lexicographic
from fbench.replay.contracts.errors import ConfigError

_CAP = 31  # Steps of brightness count up to so many grey levels
_LANES = 8  # OpenCV compares so many disparities at once, which decides between equally good ones
_STRIPES = 4  # It matches so many parts of an image one by one
_INVALID = -16  # Its mark for unknown disparities, in units of 1/16 px
_SPECKLE_STEP = 32  # Neighbors of one speckle differ by at most so much, in the same units
_FAR = 1 << 29  # More than any sum of costs
_FINE = float(1 << 30)  # Coordinates are summed as integers, in units of 1 m / 2^30


class BatchMatcher:
    """Matches B pairs of rectified images at once, as `depth.Matcher` does; disparities below `num_px` are searched.

    Costs are those of Birchfield and Tomasi, PAMI 1998; paths come from the left, the right and above (Hirschmueller,
    PAMI 2008). All of it is integers, and decided as OpenCV does, so that disparities are equal on every device. On
    CUDA, the steps along the paths are recorded once for each shape, and replayed. Raises ConfigError for parameters
    with which OpenCV's 16 bits overflow.
    """

    def __init__(self, num_px: int, params: DisparityParams) -> None:
        self._num, self._params, self._half = num_px, params, params.block_px // 2
        self._one, self._more = (level * params.block_px**2 for level in params.smoothness)
        if 3 * (125 * params.block_px**2 + self._more) > 32767:
            raise ConfigError(
                f"stereo.disparity: a GPU needs block_px^2 (125 + smoothness) of at most 10922, got "
                f"{125 * params.block_px**2 + self._more}"
            )
        self._recorded: dict[tuple[int, ...], Callable[[Tensor], Tensor]] = {}  # on CUDA, by shape of the costs

    def texture(self, images: Tensor) -> Tensor:
        """Mean absolute step to the right (B, H, W) [grey levels] around each pixel of grey images."""
        step = functional.pad((images[..., 1:].int() - images[..., :-1].int()).abs(), (0, 1))
        block = self._params.block_px
        total = _sum_around(_sum_around(step, 1, self._half), 2, block)
        return total.float() * torch.full((), 1 / (block * (2 * block + 1)), device=images.device)

    def disparity(self, left: Tensor, right: Tensor, texture: Tensor) -> Tensor:
        """Match grey images (B, H, W), uint8, with the texture of the left ones; NaN where nothing fits.

        Returns d = u_left - u_right (B, H, W) [px]. Raises ConfigError for images of few rows.
        """
        stripe = math.ceil(left.shape[1] / _STRIPES)
        above = self._half + 1 + math.ceil(0.1 * stripe)
        if stripe < above:
            raise ConfigError(f"stereo.disparity: a GPU needs images of more rows than {left.shape[1]}")
        sums = _sum_around(self._costs(left, right), 2, self._half)
        found = self._choose(self._along_rows(sums) + self._downwards(sums, stripe, above))
        found = _drop_speckles(_take_medians(found), self._params.speckle_px)
        disparity = found / 16
        column = torch.arange(left.shape[2], device=left.device)
        unknown = (found <= 0) | (disparity > column) | (texture < self._params.texture)
        return torch.where(unknown, torch.nan, disparity)

    def _costs(self, left: Tensor, right: Tensor) -> Tensor:
        """Differences (B, H, W, D) of pixels, int16: of their steps of brightness, and of brightness itself."""
        margin = torch.arange(-self._num, left.shape[2], device=left.device).clamp(min=0)
        total = torch.zeros((), dtype=torch.int16, device=left.device)
        for scale, channel in ((0, _find_steps), (2, _mask_ends)):
            one, other = (channel(image[..., margin].short()) for image in (left, right))
            u, u_least, u_most = (part[..., self._num :, None] for part in (one, *_find_limits(one)))
            v, v_least, v_most = (part.unfold(2, self._num, 1)[:, :, 1:] for part in (other, *_find_limits(other)))
            there = torch.maximum(u - v_most, v_least - u)
            back = torch.maximum(v - u_most, u_least - v)
            total = total + (torch.minimum(there, back).clamp(min=0) >> scale)
        return total.flip(3)

    def _along_rows(self, sums: Tensor) -> Tensor:
        """Costs (B, H, W, D) of the paths from the left and from the right together."""
        num, height, width, _ = sums.shape
        cost = _sum_around(sums, 1, self._half).permute(2, 0, 1, 3).reshape(width, num * height, self._num)
        from_left, from_right = self._accumulate(torch.cat([cost, cost.flip(0)], 1)).split(num * height, 1)
        return (from_left + from_right.flip(0)).view(width, num, height, self._num).permute(1, 2, 0, 3)

    def _downwards(self, sums: Tensor, stripe: int, above: int) -> Tensor:
        """Costs (B, H, W, D) of the paths from above, which begin some rows above each stripe."""
        num, height, width, _ = sums.shape
        first = torch.arange(_STRIPES, device=sums.device)[:, None] * stripe - above
        row = first + torch.arange(stripe + above, device=sums.device)
        around = row[..., None] + torch.arange(-self._half, self._half + 1, device=sums.device)
        around = torch.maximum(around, first.clamp(min=0)[..., None]).clamp(max=height - 1)
        cost = _sum_at(sums, 1, around.flatten(0, 1)).view(num, *row.shape, width, self._num)
        cost = torch.where((row >= 0)[..., None, None], cost, 0)  # where costs are 0, a path hasn't begun
        cost = cost.permute(2, 0, 1, 3, 4).reshape(stripe + above, -1, self._num)
        found = self._accumulate(cost)[above:].view(stripe, num, _STRIPES, width, self._num).permute(1, 2, 0, 3, 4)
        return found.reshape(num, _STRIPES * stripe, width, self._num)[:, :height]

    def _accumulate(self, cost: Tensor) -> Tensor:
        if not cost.is_cuda:
            return _accumulate(cost, self._one, self._more)
        if (known := self._recorded.get(tuple(cost.shape))) is None:
            known = _record(lambda costs: _accumulate(costs, self._one, self._more), cost)
            self._recorded[tuple(cost.shape)] = known
        return known(cost)

    def _choose(self, total: Tensor) -> Tensor:
        """Disparities (B, H, W) [1/16 px] with the least cost (B, H, W, D), `_INVALID` where they aren't sure."""
        least = total.amin(3)
        # Of equal costs, the last of each lane counts, and of these the first.
        at = torch.arange(self._num, dtype=torch.int32, device=total.device)
        last = torch.where(total == least[..., None], at, -1).unflatten(3, (-1, _LANES)).amax(3)
        best = torch.where(last >= 0, last, self._num).amin(3).long()
        sure = torch.ones_like(best, dtype=torch.bool)
        if self._params.uniqueness:
            limit = torch.div(100 * least, 100 - self._params.uniqueness, rounding_mode="floor")
            limit = (limit + 1).to(torch.int16)  # OpenCV compares 16 bits
            sure = ~((total < limit[..., None]) & ((at - best[..., None]).abs() > 1)).any(3)
        # A pixel of the right image belongs to the left one with the least cost, the right of equal ones. Places begin
        # so many pixels left of the image as disparities are searched.
        column = torch.arange(total.shape[2], device=total.device)
        wide, most = total.shape[2] + self._num, torch.iinfo(torch.int64).max
        code = torch.where(sure, least.long() * wide + (wide - 1 - column), most)
        chosen = torch.full((*best.shape[:2], wide), most, device=total.device)
        chosen.scatter_reduce_(2, column - best + self._num, code, "amin")
        place = torch.arange(wide, device=total.device) - self._num
        back = torch.where(chosen < most, wide - 1 - chosen % wide - place, _INVALID)
        found = torch.where(sure, _refine(total, best), _INVALID)
        differs = torch.ones_like(sure)
        for whole in (found >> 4, (found + 15) >> 4):
            at_right = column - whole + self._num
            there = back.gather(2, at_right.clamp(0, wide - 1))
            far = (there - whole).abs() > max(self._params.left_right_px, 1)
            differs &= (at_right >= 0) & (at_right < wide) & (there >= 0) & far
        return torch.where(differs, _INVALID, found)


def _find_steps(image: Tensor) -> Tensor:
    """Sobel's derivative along rows, capped, and from 0 on."""
    rows = torch.cat([image[:, :1], image, image[:, -1:]], 1)
    step = rows[..., 2:] - rows[..., :-2]
    sobel = 2 * step[:, 1:-1] + step[:, :-2] + step[:, 2:]
    return functional.pad(sobel.clamp(-_CAP, _CAP) + _CAP, (1, 1), value=_CAP)


def _mask_ends(image: Tensor) -> Tensor:
    return functional.pad(image[..., 1:-1], (1, 1), value=_CAP)


def _find_limits(channel: Tensor) -> tuple[Tensor, Tensor]:
    """Least and largest of a pixel and what lies half-way to its neighbors."""
    half = (channel[..., 1:] + channel[..., :-1]) >> 1
    around = torch.stack([torch.cat([channel[..., :1], half], -1), channel, torch.cat([half, channel[..., -1:]], -1)])
    return around.amin(0), around.amax(0)


def _sum_around(array: Tensor, dim: int, half: int) -> Tensor:
    """Sums of so many values before and after each along an axis; values at its ends go on beyond them."""
    place = torch.arange(array.shape[dim], device=array.device)[:, None]
    around = place + torch.arange(-half, half + 1, device=array.device)
    return _sum_at(array, dim, around.clamp(0, array.shape[dim] - 1))


def _sum_at(array: Tensor, dim: int, places: Tensor) -> Tensor:
    """Sums over K of an array's values at places (N, K) of an axis."""
    total = array.index_select(dim, places[:, 0])
    for k in range(1, places.shape[1]):
        total += array.index_select(dim, places[:, k])
    return total


def _accumulate(cost: Tensor, one: int, more: int) -> Tensor:
    """Costs (T, N, D) along N paths of T steps: L(d) = C(d) + min(L'(d), L'(d - 1) + one, L'(d + 1) + one, min L' +
    more) - min L', with L' those of the step before.
    """
    steps, num, disparities = cost.shape
    state = torch.full((steps + 1, num, disparities + 2), _FAR, dtype=torch.int32, device=cost.device)
    state[0, :, 1:-1] = 0
    best = torch.empty((num, disparities), dtype=torch.int32, device=cost.device)
    low = torch.empty((num, 1), dtype=torch.int32, device=cost.device)
    for before, now, own in zip(state[:-1], state[1:], cost, strict=True):  # min L' is subtracted at the end
        torch.minimum(before[:, :-2], before[:, 2:], out=best)
        best += one
        torch.minimum(best, before[:, 1:-1], out=best)
        torch.amin(before, 1, keepdim=True, out=low)
        low += more
        torch.minimum(best, low, out=best)
        torch.add(best, own, out=now[:, 1:-1])
    return state[1:, :, 1:-1] - state[:-1].amin(2, keepdim=True)


def _record(work: Callable[[Tensor], Tensor], example: Tensor) -> Callable[[Tensor], Tensor]:
    """Record the kernels that `work` starts on a GPU; the result of a replay is good until the next one."""
    given = example.clone()
    beside = torch.cuda.Stream()
    beside.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(beside):  # a first run loads the kernels
        work(given)
    torch.cuda.current_stream().wait_stream(beside)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        found = work(given)

    def replay(values: Tensor) -> Tensor:
        given.copy_(values)
        graph.replay()
        return found

    return replay


def _refine(total: Tensor, best: Tensor) -> Tensor:
    """Minimum [1/16 px] of the parabola through the least cost and its neighbors."""
    inside = best.clamp(1, total.shape[3] - 2)[..., None]
    before, here, after = (total.gather(3, inside + step)[..., 0] for step in (-1, 0, 1))
    bend = (before + after - 2 * here).clamp(min=1)
    step = torch.div((before - after) * 16 + bend, 2 * bend, rounding_mode="trunc")
    return best * 16 + torch.where((best > 0) & (best < total.shape[3] - 1), step, 0)


def _take_medians(found: Tensor) -> Tensor:
    """Medians of 3x3 pixels, with nothing known left of the image and its borders going on elsewhere."""
    wide = torch.cat([torch.full_like(found[..., :1], _INVALID), found, found[..., -1:]], 2)
    wide = torch.cat([wide[:, :1], wide, wide[:, -1:]], 1)
    return wide.unfold(1, 3, 1).unfold(2, 3, 1).flatten(3).median(3).values


def _drop_speckles(found: Tensor, most_px: int) -> Tensor:
    """Drop patches of like disparity with at most so many pixels."""
    known = found != _INVALID
    number = torch.arange(found.numel(), device=found.device).view(found.shape)
    ends = []
    for one, other in ((found[:, 1:], found[:, :-1]), (found[..., 1:], found[..., :-1])):
        linked = (one != _INVALID) & (other != _INVALID) & ((one - other).abs() <= _SPECKLE_STEP)
        ends.append(number[:, : linked.shape[1], : linked.shape[2]][linked])
    first = torch.cat(ends)
    second = torch.cat([ends[0] + found.shape[2], ends[1] + 1])
    label = components(found.numel(), torch.cat([first, second]), torch.cat([second, first])).view(found.shape)
    size = torch.bincount(label.flatten(), minlength=found.numel())[label]
    return torch.where(known & (size <= most_px), _INVALID, found)


def points(disparity: Tensor, how: Rectifier, nearest_m: float, params: DepthParams) -> list[Tensor]:
    """Points (N, 3) [m] of each of B rectified left images: those that `depth.points` gives, within a billionth of a
    meter, in lexicographic order. Takes disparities (B, H, W) [px], NaN where unknown.
    """
    device, d = disparity.device, disparity.double()
    K, R, t = how.camera.K, how.body_T_camera[:3, :3], how.body_T_camera[:3, 3]
    focal_baseline, limit = float(K[0, 0] * how.baseline_m), (min(nearest_m, params.max_range_m), params.max_range_m)
    a = torch.arange(d.shape[2], dtype=d.dtype, device=device) * float(1 / K[0, 0]) + float(-K[0, 2] / K[0, 0])
    b = torch.arange(d.shape[1], dtype=d.dtype, device=device)[:, None] * float(1 / K[1, 1]) + float(-K[1, 2] / K[1, 1])
    depth = focal_baseline / d
    xyz = torch.stack([(a * R[i, 0] + b * R[i, 1] + R[i, 2]) * depth + t[i] for i in range(3)], 3)
    least_z = float(t[2]) - HEIGHT_M
    above = xyz[..., 2]
    kept = (d * limit[1] >= focal_baseline) & (d * limit[0] <= focal_baseline)
    kept &= (above >= least_z) & (above < float(t[2]) + HEIGHT_M)
    frame, _, u = kept.nonzero().unbind(1)
    num_u, num_d = -(-d.shape[2] // params.cell_px), int(focal_baseline / limit[0] / params.cell_disparity_px) + 2
    num_z = int(2 * HEIGHT_M / params.cell_height_m) + 2
    cell = (frame * num_u + u // params.cell_px) * num_d + (d[kept] / params.cell_disparity_px).long()
    cell = cell * num_z + ((above[kept] - least_z) / params.cell_height_m).long()
    cells, member, count = torch.unique(cell, return_inverse=True, return_counts=True)
    sums = torch.zeros(len(cells), 3, dtype=torch.int64, device=device)
    sums.index_add_(0, member, (xyz[kept] * _FINE).round().long())  # whole numbers add up alike in any order
    enough = count >= params.min_pixels
    mean = (sums.double() / _FINE / count[:, None])[enough]
    of_frame = (cells // (num_u * num_d * num_z))[enough]
    found = [mean[of_frame == k] for k in range(len(d))]
    return [one[lexicographic(one)] for one in found]
