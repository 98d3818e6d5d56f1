"""Images and points in a run folder."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest

from fbench.replay.runs.media import MediaFrame, Picture, Points, pack_points, read_media, thin, write_media
from fbench.replay.runs.tables import write_table

POINTS = Points(np.array([[1.004, -2.5, 0], [400, -400, 327.67]], np.float32), np.array([np.nan, -5.255], np.float32))


def test_points_are_kept_in_centimeters(tmp_path: Path) -> None:
    write_media(tmp_path / "media.parquet", [MediaFrame(3, {"cam": Picture(b"jpeg", (4, 3))}, {"radar": POINTS})])
    (frame,) = read_media(tmp_path / "media.parquet")
    assert (frame.index, frame.pictures["cam"].jpeg, frame.pictures["cam"].size_wh) == (3, b"jpeg", (4, 3))
    kept = frame.points["radar"]
    np.testing.assert_allclose(kept.xyz, [[1.0, -2.5, 0], [327.67, -327.67, 327.67]], atol=1e-4)
    assert np.isnan(kept.speed_mps[0])
    assert kept.speed_mps[1] == pytest.approx(-5.25, abs=0.011)
    assert pack_points(kept) == pack_points(POINTS)


def test_points_of_older_versions_are_read(tmp_path: Path) -> None:
    table = np.concatenate([POINTS.xyz, POINTS.speed_mps[:, None]], axis=1).astype("<f4")
    row = {
        "frame": [0],
        "kind": ["points"],
        "sensor": ["radar"],
        "width": [2],
        "height": [4],
        "data": [table.tobytes()],
    }
    write_table(tmp_path / "media.parquet", {name: pa.array(values) for name, values in row.items()})
    (frame,) = read_media(tmp_path / "media.parquet")
    np.testing.assert_array_equal(frame.points["radar"].xyz, POINTS.xyz)


@pytest.mark.parametrize(("num", "most", "rows"), [(10, 3, [0, 3, 6]), (3, 3, [0, 1, 2]), (2, 3, [0, 1]), (0, 3, [])])
def test_thinning_is_even(num: int, most: int, rows: list[int]) -> None:
    xyz = np.arange(3 * num, dtype=np.float32).reshape(num, 3)
    thinned = thin(Points(xyz, np.zeros(num, np.float32)), most)
    np.testing.assert_array_equal(thinned.xyz, xyz[rows])
    assert len(thinned.speed_mps) == len(rows)
