import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from tests.replay.logs.codecs.ros.builders import DISTROS, ORIGIN, STAMP, STAMP_NS, Ros, cloud, structured

from fbench.replay.contracts.errors import DecodeError, PointsError
from fbench.replay.data.messages import PointCloud, RadarScan

NAME = "sensor_msgs/msg/PointCloud2"
JAZZY = Ros(DISTROS[1])
X, Y, Z = (np.array(v, np.float32) for v in ([1, 2, 3], [-1, 0.5, 4], [0, 0.25, 8]))
XYZ = np.stack([X, Y, Z], axis=1)


def read(rows, ros=JAZZY, kind="lidar", **changes):
    return ros.codec(NAME, text=False).message(kind, ros.write(cloud(ros, rows, **changes)), ORIGIN)


@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("text", [False, True])
def test_sweeps_of_all_distributions(distro, big, text):
    ros = Ros(distro, big=big)
    codec = ros.codec(NAME, text=text)
    rows = structured(x=X, y=Y, z=Z, intensity=np.float32([5, 6, 7]), ring=np.uint16([0, 1, 65535]))
    data = ros.write(cloud(ros, rows))
    assert codec.kinds == ("lidar", "radar")
    assert codec.probe(data)[:2] == ("lidar", "lidar")
    sweep = codec.message("lidar", data, ORIGIN)
    assert isinstance(sweep, PointCloud)
    assert (sweep.sensor, sweep.stamp_ns, sweep.log_ns, sweep.frame_number) == ("s", STAMP_NS, STAMP_NS + 5, 7)
    np.testing.assert_array_equal(sweep.xyz, XYZ)
    np.testing.assert_array_equal(sweep.intensity, [5, 6, 7])
    np.testing.assert_array_equal(sweep.ring, [0, 1, 65535])
    assert sweep.offset_ns is None


FIELD = st.sampled_from(["<f4", "<f8", ">f4", ">f8", "<i2", ">i2", "<i4", ">i4", "|i1"])


@pytest.mark.slow
@given(st.data(), st.integers(0, 3), st.integers(0, 5), st.sampled_from("<>|"))
def test_any_layout(data, height, width, order):
    """Fields in any order and type, with gaps, points and rows with padding."""
    names = data.draw(st.permutations(["x", "y", "z", "other"]))
    dtypes = {n: data.draw(FIELD.filter(lambda s: order in ("|", s[0]) or s[0] == "|")) for n in names}
    if order == "|":
        dtypes = {n: "<" + t[1:] if t[0] != "|" else t for n, t in dtypes.items()}
    offsets, at = [], 0
    for name in names:
        at += data.draw(st.integers(0, 5))
        offsets.append(at)
        at += np.dtype(dtypes[name]).itemsize
    dtype = np.dtype(
        {"names": names, "formats": [dtypes[n] for n in names], "offsets": offsets, "itemsize": at + len(names)}
    )
    raw = data.draw(hnp.arrays(np.uint8, (height, width, dtype.itemsize)))
    rows = raw.view(dtype)[..., 0] if raw.size else np.zeros((height, width), dtype)
    message = cloud(JAZZY, rows, row_padding=data.draw(st.integers(0, 9)) * (width > 0), is_bigendian=order == ">")
    sweep = JAZZY.codec(NAME, text=False).message("lidar", JAZZY.write(message), ORIGIN)
    with np.errstate(all="ignore"):
        expected = [rows[axis].ravel().astype("f4") for axis in "xyz"]
    np.testing.assert_array_equal(sweep.xyz, np.stack(expected, axis=1))


def test_organized_clouds_come_row_by_row():
    rows = structured(x=np.arange(6, dtype="f4"), y=np.zeros(6, "f4"), z=np.zeros(6, "f4")).reshape(2, 3)
    np.testing.assert_array_equal(read(rows, row_padding=5).xyz[:, 0], [0, 1, 2, 3, 4, 5])


def test_empty_cloud():
    sweep = read(structured(x=X[:0], y=Y[:0], z=Z[:0], intensity=X[:0], ring=np.zeros(0, "u1"), t=np.zeros(0, "u4")))
    assert sweep.xyz.shape == (0, 3)
    assert len(sweep.intensity) == len(sweep.ring) == len(sweep.offset_ns) == 0


@pytest.mark.parametrize("name", ["intensity", "reflectivity", "i", "Intensity"])
@pytest.mark.parametrize("dtype", ["f4", "u1", "u2"])
def test_names_of_the_intensity(name, dtype):
    np.testing.assert_array_equal(
        read(structured(x=X, y=Y, z=Z, **{name: np.array([1, 2, 3], dtype)})).intensity, [1, 2, 3]
    )


@pytest.mark.parametrize("name", ["ring", "channel", "line"])
@pytest.mark.parametrize("dtype", ["u1", "u2", "i4", "f4"])
def test_names_of_the_ring(name, dtype):
    sweep = read(structured(x=X, y=Y, z=Z, **{name: np.array([0, 5, 127], dtype)}))
    assert sweep.ring.dtype == np.uint16
    np.testing.assert_array_equal(sweep.ring, [0, 5, 127])


@pytest.mark.parametrize("bad", [np.int32([0, 1, -1]), np.int32([0, 1, 65536]), np.float32([0, 0.5, np.nan])])
def test_what_is_no_ring_is_left_out(bad):
    assert read(structured(x=X, y=Y, z=Z, ring=bad)).ring is None


RELATIVE = np.array([0, 0.05, -0.1])
ABSOLUTE_NS = [STAMP_NS, STAMP_NS + 1_000, STAMP_NS + 2**31 - 1]
ABSOLUTE = STAMP[0] + np.array([0.123456789, 0.25, 1.0])


@pytest.mark.parametrize(
    ("name", "times", "expected"),
    [
        ("t", np.uint32([0, 1, 99_999_999]), [0, 1, 99_999_999]),
        ("offset_time", np.uint32([7, 8, 2**31 - 1]), [7, 8, 2**31 - 1]),
        ("t", np.uint32([7, 8, 2**31]), None),
        ("time", RELATIVE.astype("f4"), np.rint(RELATIVE.astype("f4").astype("f8") * 1e9)),
        ("time", RELATIVE, [0, 50_000_000, -100_000_000]),
        ("timestamp", ABSOLUTE, [0, 126_543_211, 876_543_211]),
        ("time_stamp", ABSOLUTE, [0, 126_543_211, 876_543_211]),
        ("timestamp", ABSOLUTE + 3, None),
        ("timestamp", ABSOLUTE * 1e9, [0, 126_543_211, 876_543_211]),
        ("timestamp", np.int64(ABSOLUTE_NS), [0, 1_000, 2**31 - 1]),
        ("timestamp", np.int64(ABSOLUTE_NS) + 2**31, None),
        ("timestamp", np.int64([0, 5, 7]), [0, 5, 7]),
        ("timestamp", np.int64([0, 5, 2**31]), None),
        ("timestamp", np.int64([-(2**63), 5, 2**63 - 1]), None),
        ("t", np.int64(ABSOLUTE_NS) // 1000, [-789, 211, 2**31 - 437]),
        ("time_us", np.uint32([0, 50_000, 2_147_483]), [0, 50_000_000, 2_147_483_000]),
        ("time_us", np.uint32([0, 50_000, 2_147_484]), None),
        ("offset_ms", np.float32([-1.5, 0, 100]), [-1_500_000, 0, 100_000_000]),
        ("offset_ns", np.int32([-7, 0, 9]), [-7, 0, 9]),
        ("time_offset_ns", np.uint32([0, 1, 2]), [0, 1, 2]),
        ("ts", np.float32([0, 0.5, 1]), [0, 500_000_000, 1_000_000_000]),
        ("s", np.float32([0, 0.5, 1]), None),
        ("time", np.float32([0, 50, 100]), None),
        ("time", np.float32([0, np.nan, 0]), None),
        ("time", np.uint16([0, 1, 2]), None),
    ],
)
def test_times_of_points(name, times, expected):
    offsets = read(structured(x=X, y=Y, z=Z, **{name: times})).offset_ns
    if expected is None:
        assert offsets is None
    else:
        assert offsets.dtype == np.int32
        np.testing.assert_allclose(offsets, expected, atol=250)  # float64 seconds since 1970 are 238 ns apart


def test_times_of_luminar_are_integers_in_eight_bytes():
    dtype = np.dtype([("timestamp", "<u8"), ("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("reflectance", "<f4")])
    rows = np.zeros(3, dtype)
    rows["timestamp"], rows["reflectance"] = ABSOLUTE_NS, [1, 2, 3]
    types = {"timestamp": (2, 8)}
    fields = [
        JAZZY.make("sensor_msgs/msg/PointField", name, dtype.fields[name][1], *types.get(name, (7, 1)))
        for name in dtype.names
    ]
    message = cloud(JAZZY, rows[["x", "y", "z"]].copy())
    for name, value in {"fields": fields, "point_step": 24, "row_step": 72, "width": 3}.items():
        setattr(message, name, value)
    message.data = np.frombuffer(rows.tobytes(), np.uint8)
    sweep = JAZZY.codec(NAME, text=False).message("lidar", JAZZY.write(message), ORIGIN)
    assert sweep.offset_ns.tolist() == [0, 1_000, 2**31 - 1]
    assert sweep.intensity.tolist() == [1, 2, 3]


SECONDS, REST = np.uint32([STAMP[0], STAMP[0], STAMP[0] + 1]), np.uint32([STAMP[1], STAMP[1] + 7, 0])


@pytest.mark.parametrize(
    ("second", "nanosecond"),
    [("timestamp_s", "timestamp_ns"), ("timestamp_sec", "timestamp_nsec"), ("time_secs", "time_nsecs"),
     ("seconds", "nanoseconds"), ("sec", "nanosec"), ("t_s", "t_ns")],
)  # fmt: skip
def test_times_in_seconds_and_nanoseconds(second, nanosecond):
    assert read(structured(x=X, y=Y, z=Z, **{second: SECONDS, nanosecond: REST})).offset_ns.tolist() == [
        0, 7, 1_000_000_000 - STAMP[1],
    ]  # fmt: skip
    relative = {second: np.uint8([0, 1, 2]), nanosecond: np.uint32([5, 6, 7])}
    assert read(structured(x=X, y=Y, z=Z, **relative)).offset_ns.tolist() == [5, 1_000_000_006, 2_000_000_007]


@pytest.mark.parametrize(
    "fields",
    [
        {"timestamp_s": SECONDS, "timestamp_ns": REST + np.uint32(2**31)},
        {"timestamp_s": SECONDS, "time_ns": np.uint16([0, 1, 2])},
        {"timestamp_s": SECONDS - np.uint32(3), "timestamp_ns": REST},
    ],
)
def test_seconds_that_dont_fit_nanoseconds(fields):
    expected = [0, 1, 2] if "time_ns" in fields else None
    offsets = read(structured(x=X, y=Y, z=Z, **fields)).offset_ns
    assert (None if offsets is None else offsets.tolist()) == expected


@pytest.mark.parametrize(
    ("fields", "doubt"),
    [
        ({"time": np.float32([0, 50, 100])}, "its points have 'time'"),
        ({"ts": 9 * X, "utc_time": X}, "its points have 'ts', 'utc_time'"),
        ({"timestamp": np.float64([0, np.nan, 0])}, "its points have 'timestamp'"),
        ({"time": X, "t": np.uint32([0, 1, 2])}, ""),
        ({"range": X, "s": X, "intensity": X, "tag": X}, ""),
    ],
)
def test_times_that_arent_understood_are_reported(fields, doubt):
    data = JAZZY.write(cloud(JAZZY, structured(x=X, y=Y, z=Z, **fields)))
    assert JAZZY.codec(NAME).probe(data) == ("lidar", "lidar", "", doubt)


def test_times_that_could_be_both_stay_unknown():
    assert read(structured(x=X, y=Y, z=Z, time=RELATIVE), stamp=(1, 0)).offset_ns is None


@pytest.mark.parametrize("distro", DISTROS, ids=lambda d: d.value)
@pytest.mark.parametrize(
    "name",
    [
        "velocity", "doppler", "Doppler", "doppler_velocity", "radial_velocity", "v_r", "vr", "radial_speed",
        "speed_radial", "v_radial", "range_rate", "v_doppler_mps", "vRel",
    ],
)  # fmt: skip
def test_radar_by_the_names_of_its_doppler(distro, name):
    ros = Ros(distro)
    rows = structured(x=X, y=Y, z=Z, **{name: np.float32([-1, 0, 2.5])}, RCS=np.int8([-5, 0, 9]), power=X, range=X,
                      azimuth=Y, elevation=Z)  # fmt: skip
    data = ros.write(cloud(ros, rows, frame_id="/radar"))
    assert ros.codec(NAME).probe(data)[:2] == ("radar", "radar")
    scan = ros.codec(NAME).message("radar", data, ORIGIN)
    assert isinstance(scan, RadarScan)
    assert (scan.stamp_ns, scan.log_ns, scan.frame_number) == (STAMP_NS, STAMP_NS + 5, 7)
    np.testing.assert_array_equal(scan.xyz, XYZ)
    np.testing.assert_array_equal(scan.radial_velocity_mps, [-1, 0, 2.5])
    np.testing.assert_array_equal(scan.rcs_dbsm, [-5, 0, 9])
    for array, expected in ((scan.range_m, X), (scan.azimuth_rad, Y), (scan.altitude_rad, Z)):
        np.testing.assert_array_equal(array, expected)


@pytest.mark.parametrize("name", ["power", "snr", "amplitude"])
def test_other_names_of_the_strength(name):
    scan = read(structured(x=X, y=Y, z=Z, vr=X, **{name: np.float64([1, 2, 3])}), kind="radar")
    np.testing.assert_array_equal(scan.rcs_dbsm, [1, 2, 3])
    assert scan.range_m is None


def test_doppler_of_a_vector():
    rows = structured(
        x=np.float32([3, 0, 0]), y=np.float32([4, -2, 0]), z=np.zeros(3, "f4"),
        vx=np.float32([6, 1, 1]), vy=np.float32([8, 5, 1]), vx_comp=X, vy_comp=Y,
    )  # fmt: skip
    assert JAZZY.codec(NAME).probe(JAZZY.write(cloud(JAZZY, rows))).kind == "radar"
    np.testing.assert_array_equal(read(rows, kind="radar").radial_velocity_mps, [10, -5, np.nan])


def test_compensated_vectors_alone_are_no_doppler():
    rows = structured(x=X, y=Y, z=Z, vx_comp=X, vy_comp=Y)
    assert JAZZY.codec(NAME).probe(JAZZY.write(cloud(JAZZY, rows))).kind == "lidar"
    assert read(rows, kind="radar").radial_velocity_mps is None


def test_header_without_a_stamp():
    assert read(structured(x=X, y=Y, z=Z), stamp=(0, 0)).stamp_ns == 0  # the reader takes the time of recording


@pytest.mark.parametrize(("stamp", "ok"), [((-1, 0), False), ((2**31 - 1, 999_999_999), True)])
def test_stamps_of_ros2(stamp, ok):
    if ok:
        assert read(structured(x=X, y=Y, z=Z), stamp=stamp).stamp_ns == stamp[0] * 10**9 + stamp[1]
    else:
        with pytest.raises(DecodeError, match="stamp of -1 s 0 ns is out of range"):
            read(structured(x=X, y=Y, z=Z), stamp=stamp)


def test_seconds_of_ros1_are_unsigned():
    sweep = read(structured(x=X, y=Y, z=Z), ros=Ros(DISTROS[2]), stamp=(-1, 0))
    assert sweep.stamp_ns == (2**32 - 1) * 10**9


def test_a_wrong_row_step_doesnt_matter_without_padding():
    np.testing.assert_array_equal(read(structured(x=X, y=Y, z=Z), row_step=1).xyz, XYZ)


ROWS = structured(x=X, y=Y, z=Z)


@pytest.mark.parametrize(
    ("rows", "changes", "message"),
    [
        (ROWS, {"width": 4}, "cloud of 4x1 points of 12 bytes, rows of 36 bytes, has 36 bytes"),
        (ROWS, {"width": 2, "row_step": 24}, "has 36 bytes"),
        (ROWS, {"point_step": 0}, "points of 0 bytes"),
        (ROWS, {"height": 0}, "has 36 bytes"),
        (ROWS, {"height": 2**32 - 1, "width": 2**32 - 1}, "4294967295x4294967295"),
        (structured(x=X, y=Y), {}, "no field z"),
        (structured(intensity=X), {}, "no field x, y, z"),
        (structured(x=X[:0], y=Y[:0]), {}, "no field z"),
    ],
)
def test_damaged_clouds(rows, changes, message):
    for kind in ("lidar", "radar"):
        with pytest.raises(PointsError, match=message):
            read(rows, kind=kind, **changes)


@pytest.mark.parametrize(
    ("change", "message"), [({"offset": 9}, "'z' lies outside"), ({"datatype": 12}, "'z' has an unknown type 12")]
)
def test_damaged_fields(change, message):
    damaged = cloud(JAZZY, ROWS)
    for name, value in change.items():
        setattr(damaged.fields[2], name, value)
    with pytest.raises(PointsError, match=message):
        JAZZY.codec(NAME).message("lidar", JAZZY.write(damaged), ORIGIN)


def test_too_many_fields():
    rows = structured(**{f"f{i}": X for i in range(257)})
    with pytest.raises(DecodeError, match="cloud has 257 fields, at most 256 are read"):
        read(rows)


@pytest.mark.parametrize("kind", ["lidar", "radar"])
def test_points_that_a_cloud_declares_invalid_are_left_out(kind):
    """Organized clouds keep a place for each ray: those without a return are NaN, and `is_dense` is false."""
    x = np.float32([1, np.nan, 3, np.inf])
    rows = structured(x=x, y=x, z=x, velocity=np.float32([5, 6, 7, 8]), intensity=np.float32([1, 2, 3, 4]))
    changes = {"kind": kind, "height": 2, "width": 2, "row_step": 2 * rows.dtype.itemsize}
    cloud = read(rows, is_dense=False, **changes)
    assert cloud.xyz.tolist() == [[1, 1, 1], [3, 3, 3]]
    values = cloud.radial_velocity_mps if isinstance(cloud, RadarScan) else cloud.intensity
    assert values.tolist() == ([5, 7] if kind == "radar" else [1, 3])
    assert len(read(rows, is_dense=True, **changes).xyz) == 4  # these are faults, which are counted later


def test_cloud_of_invalid_points_alone_is_empty():
    rows = structured(x=X * np.nan, y=Y, z=Z)
    assert read(rows, is_dense=False).xyz.shape == (0, 3)
