"""URDF, trusted and not."""

import time
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fbench.replay.contracts.errors import ConfigError
from fbench.replay.formats.rig_files import open_rig_file
from fbench.replay.geometry.transforms import pose_matrix
from fbench.replay.logs.coordinate_frames import TransformTree

LINKS = "".join(f'<link name="{n}"/>' for n in ("base_footprint", "base_link", "mast", "lidar", "head"))
ROBOT = f"""<?xml version="1.0"?>
<robot name="car" xmlns:xacro="http://ros.org/wiki/xacro">
  {LINKS}
  <joint name="a" type="fixed"><parent link="base_footprint"/><child link="base_link"/><origin xyz="0 0 0.3"/></joint>
  <joint name="b" type="fixed">
    <origin rpy="0 0 1.5707963267948966" xyz="1 0 1"/><parent link="base_link"/><child link="mast"/>
  </joint>
  <joint name="c" type="fixed"><origin xyz="0.5 0 0.2" rpy="0.1 0.2 0.3"/>
    <parent link="mast"/><child link="lidar"/></joint>
  <joint name="pan" type="revolute"><parent link="mast"/><child link="head"/><axis xyz="0 0 1"/></joint>
  <transmission name="t"><joint name="pan"><hardwareInterface/></joint></transmission>
</robot>"""


def read(folder, text, name="rig.urdf"):
    path = folder / name
    path.write_text(text) if isinstance(text, str) else path.write_bytes(text)
    return open_rig_file(path)


def joint(parent, child, inner="", kind="fixed", name="j"):
    return f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inner}</joint>'


def robot(*parts, links="abc"):
    return f"<robot>{''.join(f'<link name={n!r}/>' for n in links)}{''.join(parts)}</robot>"


def test_a_chain_of_fixed_joints(tmp_path):
    patch = read(tmp_path, ROBOT)
    assert {child: edge.parent for child, edge in patch.edges.items()} == {
        "base_link": "base_footprint", "mast": "base_link", "lidar": "mast",
    }  # fmt: skip
    translation, rotation = TransformTree(dict(patch.edges)).pose("lidar", "base_link")
    # The mast is turned to the left by 90 degrees, so that its x is the body's y.
    np.testing.assert_allclose(translation, [1, 0.5, 1.2], atol=1e-12)
    expected = Rotation.from_euler("z", np.pi / 2) * Rotation.from_euler("xyz", [0.1, 0.2, 0.3])  # fixed axes
    np.testing.assert_allclose(pose_matrix(translation, rotation)[:3, :3], expected.as_matrix(), atol=1e-12)


def test_a_joint_that_moves_gives_no_pose_but_a_reason(tmp_path):
    patch = read(tmp_path, ROBOT)
    assert patch.moving == {"head": "joint 'pan' (revolute)"}
    assert "head" not in patch.edges
    assert patch.places["head"].endswith("rig.urdf")


def test_without_origin_links_coincide(tmp_path):
    edge = read(tmp_path, robot(joint("a", "b"))).edges["b"]
    assert (edge.translation_m.tolist(), edge.rotation_xyzw.tolist()) == ([0, 0, 0], [0, 0, 0, 1])


def laughs():
    entities = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 30))
    return f'<?xml version="1.0"?><!DOCTYPE robot [<!ENTITY a0 "ha">{entities}]><robot>&a29;</robot>'


BAD = {
    "billion laughs": (laughs(), "XML with a DOCTYPE is refused"),
    "file from elsewhere": (
        '<!DOCTYPE robot [<!ENTITY x SYSTEM "file:///etc/passwd">]><robot name="&x;"/>', "DOCTYPE is refused",
    ),
    "unknown entity": ("<robot>&x;</robot>", "isn't XML .undefined entity in line 1"),
    "deep": ("<robot>" + "<a>" * 100000, "nested more than 64 deep"),
    "not whole": ("<robot><link", "isn't XML"),
    "not URDF": ("<sdf/>", "isn't URDF .<sdf> instead of <robot>"),
    "xacro element": ("<robot><xacro:macro name='a'/></robot>", "holds xacro macros; run `xacro FILE"),
    "xacro value": (robot(joint("a", "b", "<origin xyz='0 0 ${h}'/>")), "holds xacro macros"),
    "loop": (robot(joint("a", "b"), joint("b", "c"), joint("c", "a")), "loop: b → a → c → b"),
    "loop of one that moves": (robot(joint("a", "b"), joint("b", "a", kind="planar")), "loop"),
    "second parent": (robot(joint("a", "c"), joint("b", "c", name="k")), "joint 'k': link 'c' has a second parent"),
    "no child": (robot("<joint name='j' type='fixed'><parent link='a'/></joint>"), "joint 'j': no <child link"),
    "not a link": (robot(joint("a", "d")), "joint 'j': its child 'd' isn't a link of the file"),
    "unknown type": (robot(joint("a", "b", kind="fixd")), "joint 'j': type 'fixd' isn't known; there are: fixed, rev"),
    "two numbers": (robot(joint("a", "b", "<origin xyz='0 0'/>")), "'j': origin xyz: expected 3 numbers, got 2"),
    "NaN": (robot(joint("a", "b", "<origin rpy='0 0 nan'/>")), r"'j': origin rpy\[2\]: expected a finite number"),
    "infinite": (robot(joint("a", "b", "<origin xyz='0 0 1e999'/>")), r"origin xyz\[2\]: expected a finite number"),
    "two origins": (robot(joint("a", "b", "<origin/><origin/>")), "joint 'j' has two elements <origin>"),
    "link twice": (robot(links="aa"), "link 'a' is there twice"),
    "not UTF-8": (b"<robot name='\xff'/>", "isn't XML"),
    "an encoding of its own": (b"<?xml version='1.0' encoding='UTF-7'?><robot name='\xff'/>", "isn't XML"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "match"), BAD.values(), ids=BAD)
def test_bad_files_are_refused_in_one_line(tmp_path, text, match):
    start = time.process_time()
    with pytest.raises(ConfigError, match=match) as caught:
        read(tmp_path, text)
    assert str(caught.value).startswith(f"{tmp_path}/rig.urdf: ")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    assert caught.value.code in ("CFG003", "CAL001")
    assert time.process_time() - start < 20


def test_a_xacro_file_is_told_by_its_name_too(tmp_path):
    with pytest.raises(ConfigError, match="xacro"):
        read(tmp_path, "<robot><xacro:include filename='a'/></robot>", "rig.urdf.xacro")


@pytest.mark.slow
def test_a_long_chain_is_read_in_time(tmp_path):
    links = [f"l{i}" for i in range(5001)]
    joints = [joint(a, b) for a, b in pairwise(links)]
    start = time.process_time()
    assert len(read(tmp_path, robot(*reversed(joints), links=links)).edges) == 5000
    assert time.process_time() - start < 30
    with pytest.raises(ConfigError, match="has more than 5000 joints"):
        read(tmp_path, robot(*joints, joints[0], links=links))
    with pytest.raises(ConfigError, match=r"loop: l2 → l1 → .*\.\.\.$"):
        read(tmp_path, robot(*joints[1:], joint(links[-1], "l1"), links=links))
