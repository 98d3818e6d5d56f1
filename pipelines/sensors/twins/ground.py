"""Twin of `points.ground`."""

import math

import torch
from torch import Tensor
from torch.nn import functional

from fbench.pipelines.sensors.points import ground
from fbench.pipelines.sensors.points.ground import GroundParams, Plane


def find_ground(xyz: Tensor, params: GroundParams) -> tuple[Plane | None, Tensor, Tensor]:
    """Find the ground under points (N, 3), float64: what `points.ground.find_ground` gives, heights within 1e-6 m,
    since sums are added in another order.
    """
    near = torch.hypot(xyz[:, 0], xyz[:, 1]) < params.range_m
    cell = torch.floor(xyz[near, :2] / params.cell_m).long()
    lowest = xyz[near][_lowest_rows(cell, xyz[near, 2], params.outliers)] if len(cell) else xyz[:0]
    plane = _fit_plane(lowest, params)
    if plane is None:
        return None, torch.zeros_like(near), torch.zeros_like(xyz[:, 0])
    deviation = lowest[:, 2] - _z_m(plane, lowest)
    on_ground = deviation.abs() < 0.3 + params.max_slope * torch.hypot(lowest[:, 0], lowest[:, 1])
    half = math.ceil(params.range_m / params.cell_m)
    surface = xyz.new_full((2 * half + 1, 2 * half + 1), math.inf)
    at = torch.floor(lowest[on_ground, :2] / params.cell_m).long() + half
    surface[at[:, 0], at[:, 1]] = deviation[on_ground]
    offset = torch.arange(-3, 4, device=xyz.device, dtype=torch.float64) * params.cell_m
    cone = params.max_slope * torch.hypot(offset[:, None], offset[None, :])
    padded = functional.pad(surface[None, None], (3, 3, 3, 3), value=math.inf)[0, 0]
    around = padded.unfold(0, 7, 1).unfold(1, 7, 1) + cone
    eroded = around.amin((2, 3))
    eroded = torch.where(torch.isfinite(eroded), eroded, 0.0)
    height = xyz[:, 2] - _z_m(plane, xyz)
    height[near] -= eroded[cell[:, 0] + half, cell[:, 1] + half]
    return plane, near, height


def _z_m(plane: Plane, xyz: Tensor) -> Tensor:
    return plane.slope_x * xyz[:, 0] + plane.slope_y * xyz[:, 1] + plane.height_m


def _lowest_rows(cell: Tensor, z: Tensor, outliers: float) -> Tensor:
    low = cell.amin(0)
    number = (cell[:, 0] - low[0]) * (cell[:, 1].max() - low[1] + 1) + cell[:, 1] - low[1]
    by_height = torch.sort(z, stable=True).indices
    order = by_height[torch.sort(number[by_height], stable=True).indices]
    count = torch.unique_consecutive(number[order], return_counts=True)[1]
    first = count.cumsum(0) - count
    return order[first + (outliers * count.double()).long()]


def _fit_plane(lowest: Tensor, params: GroundParams) -> Plane | None:
    if len(lowest) < 3:
        return None
    band_m = 0.8
    slopes = torch.tensor(ground.tilts(params), device=lowest.device)
    z = lowest[:, 2] - slopes[:, :1] * lowest[:, 0] - slopes[:, 1:] * lowest[:, 1]
    fall = ground.DIP_M + (lowest[:, 0] ** 2 + lowest[:, 1] ** 2) / (2 * ground.CREST_M)
    lower = torch.sort(z + fall, 1).values
    z = torch.sort(z, 1).values
    held = torch.searchsorted(z, z + band_m, right=True) - torch.arange(z.shape[1], device=z.device)
    value = held - ground.BELOW * torch.searchsorted(lower, z)
    most = value.amax(1)
    best = int((most == most.max()).nonzero()[0])
    begin = int((value[best] == most[best]).nonzero()[0])
    plane = Plane(float(slopes[best, 0]), float(slopes[best, 1]), float(z[best, begin] + band_m / 2))
    for band_m in (0.6, 0.4, 0.3, 0.2, 0.2):
        plane = _refine(plane, lowest, band_m)
    return plane


def _refine(plane: Plane, lowest: Tensor, band_m: float) -> Plane:
    residual = lowest[:, 2] - _z_m(plane, lowest)
    inside = residual.abs() < band_m
    near = lowest[inside]
    if len(near) < 3:
        return plane
    middle = near.mean(0)
    x, y, z = (near - middle).T
    sums = torch.stack([x @ x, x @ y, y @ y, x @ z, y @ z, *middle]).tolist()
    xx, xy, yy, xz, yz, *at = sums
    determinant = xx * yy - xy * xy
    if determinant < 1e-3 * (xx + yy) ** 2:  # on a line: keep the tilt
        middle_m = float(torch.quantile(residual[inside], 0.5))
        return Plane(plane.slope_x, plane.slope_y, plane.height_m + middle_m)
    a, b = (xz * yy - yz * xy) / determinant, (yz * xx - xz * xy) / determinant
    return Plane(a, b, at[2] - a * at[0] - b * at[1])
