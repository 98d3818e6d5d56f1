"""Compiled loops of fusion: points in camera boxes, grouping by log-likelihood ratios."""

import numpy as np

from fbench.replay.data.arrays import Float64, Int64
from fbench.replay.geometry.kernels import kernel


@kernel
def inside_boxes(uv_px: Float64, distance_m: Float64, first: Int64, xyxy_px: Float64) -> Float64:
    """For each camera box (S, 4) and cluster, whose points (N,) lie from `first[k]` to `first[k + 1]`: (S, K, 3) number
    of points inside, the tenth part's distance [m] and their mean u [px]; 0 where none is inside.
    """
    num_boxes, num_clusters = len(xyxy_px), len(first) - 1
    result = np.zeros((num_boxes, num_clusters, 3))
    buffer = np.zeros(len(uv_px))
    for s in range(num_boxes):
        left, top, right, bottom = xyxy_px[s, 0], xyxy_px[s, 1], xyxy_px[s, 2], xyxy_px[s, 3]
        for k in range(num_clusters):
            num, across = 0, 0.0
            for i in range(first[k], first[k + 1]):
                u, v = uv_px[i, 0], uv_px[i, 1]
                if left < u < right and top < v < bottom:
                    buffer[num] = distance_m[i]
                    across += u
                    num += 1
            if num > 0:
                result[s, k, 0] = num
                result[s, k, 1] = np.sort(buffer[:num])[num // 10]
                result[s, k, 2] = across / num
    return result


@kernel
def agglomerate(ratio: Float64) -> Int64:
    """Group n things by their log-likelihood ratios (n, n), symmetric; -inf: never in one group. Returns (n,) numbers.

    The two groups with the largest sum of ratios between them are joined, as long as that is positive (greedy additive
    edge contraction: Keuper et al., "Efficient decomposition of image and mesh graphs by lifted multicuts", ICCV 2015).
    On ties the first pair counts.
    """
    num = len(ratio)
    ratio = ratio.copy()
    group = np.arange(num)
    alive = np.ones(num, np.bool_)
    while True:
        best, a, b = 0.0, -1, -1
        for i in range(num):
            if alive[i]:
                for j in range(i + 1, num):
                    if alive[j] and ratio[i, j] > best:
                        best, a, b = ratio[i, j], i, j
        if a < 0:
            return group
        alive[b] = False
        for k in range(num):
            ratio[a, k] += ratio[b, k]
            ratio[k, a] += ratio[k, b]
            if group[k] == b:
                group[k] = a


@kernel
def nearest_by_bearing(xy: Float64, num_bins: int) -> Float64:
    """Distance (num_bins,) [m] of the nearest of points (N, 2) in each direction, from -pi on; inf: there is none."""
    result = np.full(num_bins, np.inf)
    for i in range(len(xy)):
        at = int((np.arctan2(xy[i, 1], xy[i, 0]) + np.pi) / (2 * np.pi) * num_bins) % num_bins
        result[at] = min(result[at], np.hypot(xy[i, 0], xy[i, 1]))
    return result


@kernel
def occlusion_shares(nearest_m: Float64, bearing_rad: Float64, half_rad: Float64, near_m: Float64) -> Float64:
    """Share (N,) of the directions within `half_rad` of `bearing_rad` in which something is nearer than `near_m`."""
    num_bins = len(nearest_m)
    result = np.zeros(len(bearing_rad))
    for n in range(len(bearing_rad)):
        begin = int(np.floor((bearing_rad[n] - half_rad[n] + np.pi) / (2 * np.pi) * num_bins))
        end = int(np.floor((bearing_rad[n] + half_rad[n] + np.pi) / (2 * np.pi) * num_bins))
        num = 0
        for k in range(begin, end + 1):
            if nearest_m[k % num_bins] < near_m[n]:
                num += 1
        result[n] = num / (end - begin + 1)
    return result


@kernel
def count_near(xy: Float64, center_m: Float64, radius_m: Float64) -> Int64:
    """Number (M,) of points (N, 2) nearer to each center (M, 2) than its radius (M,) [m]."""
    result = np.zeros(len(center_m), np.int64)
    for m in range(len(center_m)):
        for i in range(len(xy)):
            x, y = xy[i, 0] - center_m[m, 0], xy[i, 1] - center_m[m, 1]
            if x * x + y * y < radius_m[m] * radius_m[m]:
                result[m] += 1
    return result
