"""Edges of depth of the LiDARs over the edges of brightness of an image."""

import numpy as np

from fbench.replay.geometry.camera import in_image, project
from fbench.replay.images import Pixels
from fbench.reports.preview import draw
from fbench.reports.preview.alignment import edges_of
from fbench.reports.preview.colors import INK, of_depth
from fbench.reports.preview.depth_edges import edge_strength
from fbench.reports.preview.sample import Sample
from fbench.reports.preview.window import whole


def edges_view(sample: Sample, camera: str) -> Pixels:
    """Draw the upright edges of the image in grey and the near sides of jumps in depth upon them, by depth."""
    pixels, model = sample.image(camera), sample.rig.cameras[camera]
    window = whole(model.size_wh)
    width, height = window.size_wh
    strength = edge_strength(pixels, width)
    gray = np.round(255 * np.clip(strength / max(float(strength.max()), 1e-6), 0, 1)).astype(np.uint8)
    picture = draw.canvas(width, height)
    rows = min(height, gray.shape[0])
    picture[:rows] = np.repeat(gray[:rows, :, None], 3, axis=2)
    uv, depth = project(model, edges_of(sample, camera))
    seen = in_image(model, uv)
    radii = np.full(int(seen.sum()), 3 if seen.sum() < 1500 else 2)
    draw.disks(picture, window.to_picture(uv[seen]), radii, of_depth(depth[seen]))
    draw.lines(
        picture, [f"frame {sample.frame.index}: jumps of LiDAR depth on upright edges of {draw.plain(camera)}"], [INK]
    )
    return picture
