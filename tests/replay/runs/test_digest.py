import struct
from dataclasses import replace

import numpy as np
import pytest

from fbench.replay.data.boxes import Boxes3D
from fbench.replay.data.messages import PointCloud
from fbench.replay.runs.digest import START, digest, link


def cloud(xyz):
    return PointCloud("lidar", 1, 2, np.asarray(xyz, np.float32))


def test_golden():
    """A change here changes every digest that was ever written: it needs a new version in the encoding."""
    assert digest([1, "a", 0.5, None, b"x", np.arange(3, dtype=np.int32)]) == "47fd861896ce1fc5f59b587aaecf8d1b"


def test_one_bit_changes_the_digest():
    before = digest(cloud([[1, 2, 3]]))
    (bits,) = struct.unpack("<I", struct.pack("<f", 3.0))
    (flipped,) = struct.unpack("<f", struct.pack("<I", bits ^ 1))
    assert digest(cloud([[1, 2, flipped]])) != before
    assert digest(replace(cloud([[1, 2, 3]]), stamp_ns=3)) != before


def test_zero_and_nan_are_canonical():
    odd_nan = struct.unpack("<f", struct.pack("<I", 0x7FC00001))[0]
    assert digest(np.array([0.0, np.nan], np.float32)) == digest(np.array([-0.0, odd_nan], np.float32))


def test_layout_in_memory_does_not_matter():
    array = np.arange(12.0).reshape(3, 4)
    assert digest(array) == digest(np.asfortranarray(array)) == digest(array.astype(">f8"))


def test_types_shapes_and_nesting_matter():
    values = [1, 1.0, "1", True, None, b"1", [1], [[1]], {"a": 1}, np.ones(1), np.ones((1, 1)), np.ones(1, np.float32)]
    assert len({digest(v) for v in values}) == len(values)
    assert digest(["ab", "c"]) != digest(["a", "bc"])


def test_mappings_are_sorted():
    assert digest({"a": 1, "b": 2}) == digest({"b": 2, "a": 1})


def test_width_of_text_does_not_matter():
    boxes = Boxes3D(np.zeros((1, 3)), np.ones((1, 3)), np.zeros(1), label=np.array(["car"], "U3"))
    wider = replace(boxes, label=np.array(["car"], "U30"))
    assert digest(boxes) == digest(wider)


def test_unknown_types_are_refused():
    with pytest.raises(TypeError, match="set has no canonical encoding"):
        digest({1, 2})


def test_chain_depends_on_order():
    a, b = digest(1), digest(2)
    assert link(link(START, a), b) != link(link(START, b), a)


def test_large_arrays_and_images_count_to_the_last_bit():
    data = np.arange(100_000, dtype=np.int32)
    changed = data.copy()
    changed[-1] ^= 1
    assert digest(data) == digest(data.copy())
    assert len({digest(data), digest(changed), digest(data.tobytes()), digest(changed.tobytes())}) == 4
