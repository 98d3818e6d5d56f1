"""Pixels with depth, gathered in cells: the one loop over all pixels."""

import numpy as np

from fbench.replay.arrays import Float32, Float64, Int64
from fbench.replay.kernels import kernel


@kernel
def gather(
    disparity: Float32, focal_baseline: float, per_px: Float64, body_T_camera: Float64, depth_m: Float64,
    bins: Float64, z_m: Float64,
) -> tuple[Float64, Int64]:  # fmt: skip
    """Mean points (M, 3) [m] in body coordinates of cells, and their numbers of pixels (M,).

    Takes disparities (W, H) [px], column by column, NaN where unknown; f B [px m]; 1/f and -c/f of x and y (2, 2);
    the least and largest depth [m]; edges of cells: columns [px], disparity [px], height [m]; the least and largest
    height [m]. Cells come in the order of their columns, then of their first pixel. Z = f B / d, X = (u - c) Z / f.
    """
    width, height = disparity.shape
    num_u = int(bins[0])
    num_d = int(focal_baseline / depth_m[0] / bins[1]) + 2
    num_z = int((z_m[1] - z_m[0]) / bins[2]) + 1
    known = np.full(num_d * num_z, -1, np.int64)
    sums, counts = np.zeros((4096, 3)), np.zeros(4096, np.int64)
    touched = np.zeros(min(num_u * height, len(known)), np.int64)
    num = 0
    R, t = body_T_camera[:3, :3], body_T_camera[:3, 3]
    for first in range(0, width, num_u):
        num_touched = 0
        for u in range(first, min(first + num_u, width)):
            a = u * per_px[0, 0] + per_px[0, 1]
            for v in range(height):
                d = disparity[u, v]
                if not d * depth_m[1] >= focal_baseline or d * depth_m[0] > focal_baseline:
                    continue
                depth = focal_baseline / d
                b = v * per_px[1, 0] + per_px[1, 1]
                z = (R[2, 0] * a + R[2, 1] * b + R[2, 2]) * depth + t[2]
                if not z_m[0] <= z < z_m[1]:
                    continue
                at = int(d / bins[1]) * num_z + int((z - z_m[0]) / bins[2])
                cell = known[at]
                if cell < 0:
                    if num == len(counts):
                        sums = np.concatenate((sums, np.zeros_like(sums)))
                        counts = np.concatenate((counts, np.zeros_like(counts)))
                    cell = known[at] = num
                    touched[num_touched] = at
                    num_touched += 1
                    num += 1
                counts[cell] += 1
                sums[cell, 0] += (R[0, 0] * a + R[0, 1] * b + R[0, 2]) * depth + t[0]
                sums[cell, 1] += (R[1, 0] * a + R[1, 1] * b + R[1, 2]) * depth + t[1]
                sums[cell, 2] += z
        known[touched[:num_touched]] = -1
    return sums[:num] / counts[:num].reshape(-1, 1), counts[:num]
