import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fbench.pipelines.sensors.camera.layouts import PAD_VALUE, Candidates, letterbox, place, planes, squash


def box(*xyxy: float) -> Candidates:
    return Candidates(np.array([xyxy]), np.ones(1), np.array(["car"]))


def test_letterbox_upper_left_and_centered() -> None:
    corner = letterbox((200, 100), (100, 100), centered=False)
    assert (corner.scale, corner.offset) == ((0.5, 0.5), (0.0, 0.0))
    centered = letterbox((200, 100), (100, 100), centered=True)
    assert (centered.scale, centered.offset) == ((0.5, 0.5), (0.0, 25.0))
    assert centered.back(box(10, 30, 20, 40)).xyxy.tolist() == [[20, 10, 40, 30]]


def test_squash_scales_each_axis_by_itself() -> None:
    placement = squash((200, 50), (100, 100))
    assert placement.scale == (0.5, 2.0)
    assert placement.back(box(10, 20, 20, 40)).xyxy.tolist() == [[20, 10, 40, 20]]


@pytest.mark.parametrize("centered", [True, False])
def test_a_bright_rectangle_comes_back_to_where_it_was(centered: bool) -> None:
    pixels = np.zeros((60, 200, 3), np.uint8)
    pixels[20:40, 80:120] = 255
    placement = letterbox((200, 60), (100, 100), centered=centered)
    placed = place(pixels, placement, (100, 100))
    rows, columns = np.nonzero(placed[..., 0] == 255)
    found = box(columns.min(), rows.min(), columns.max() + 1, rows.max() + 1)
    np.testing.assert_allclose(placement.back(found).xyxy, [[80, 20, 120, 40]])
    assert (placed == PAD_VALUE).all(axis=(1, 2)).sum() == 70


@given(st.integers(1, 3000), st.integers(1, 3000), st.booleans())
def test_any_image_fits(width: int, height: int, centered: bool) -> None:
    placement = letterbox((width, height), (96, 64), centered=centered)
    right = placement.scale[0] * width + placement.offset[0]
    bottom = placement.scale[1] * height + placement.offset[1]
    assert right <= 96 + 1e-9
    assert bottom <= 64 + 1e-9
    assert placement.offset[0] >= 0
    assert placement.offset[1] >= 0


def test_planes_swap_channels_and_scale() -> None:
    pixels = np.zeros((2, 3, 3), np.uint8)
    pixels[..., 0], pixels[..., 2] = 255, 51
    as_is = planes([pixels], rgb=False, unit=False)
    assert as_is.shape == (1, 3, 2, 3)
    assert as_is[0, :, 0, 0].tolist() == [255, 0, 51]
    np.testing.assert_allclose(planes([pixels], rgb=True, unit=True)[0, :, 0, 0], [0.2, 0, 1], rtol=1e-6)
