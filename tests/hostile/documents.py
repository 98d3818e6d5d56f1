"""Configurations, calibrations and files of boxes, with words, signs and bytes changed."""

from pathlib import Path

import numpy as np
from tests.hostile.damage import Random, damage, edit_number, edit_text
from tests.hostile.target import Case, Found
from tests.replay.formats import test_hostile
from tests.replay.formats.box_files import read
from tests.replay.setup.test_load import GOOD

from fbench.replay.formats.rig_files import open_rig_file
from fbench.replay.setup.configuration import load_config, setup_of

RIGS = {name: text.encode() for name, text in test_hostile.VALID_RIGS.items()}
BOXES = {name: content for name, content in test_hostile.VALID.items() if not name.endswith(".parquet")}
TABLE = test_hostile.VALID["a.parquet"]


def make_config(random: Random) -> Case:
    """Change words of an fbench.toml."""
    return Case({"fbench.toml": edit_text(GOOD.encode(), random)})


def use_config(folder: Path) -> Found:
    """Load a configuration."""
    path = folder / "fbench.toml"
    setup_of(load_config(path), path)
    return Found()


def make_rig(random: Random) -> Case:
    """Change words of a file with calibration."""
    name = sorted(RIGS)[int(random.integers(len(RIGS)))]
    return Case({name: [edit_text, edit_text, damage][int(random.integers(3))](RIGS[name], random)})


def use_rig(folder: Path) -> Found:
    """Open it: what it gives is finite, and turns."""
    patch = open_rig_file(next(folder.iterdir()))
    for edge in patch.edges.values():
        assert np.isfinite([*edge.translation_m, *edge.rotation_xyzw]).all(), "a transform isn't finite"
        assert np.any(edge.rotation_xyzw), "a rotation is none"
    for camera in patch.cameras.values():
        assert np.isfinite([*camera.K.ravel(), *camera.distortion]).all(), "a camera isn't finite"
    return Found()


def make_boxes(random: Random) -> Case:
    """Change words of a file with boxes."""
    name = sorted(BOXES)[int(random.integers(len(BOXES)))]
    return Case({name: [edit_text, edit_text, damage][int(random.integers(3))](BOXES[name], random)})


def make_table(random: Random) -> Case:
    """Change numbers of a Parquet table with boxes."""
    return Case({"a.parquet": [edit_number, damage][int(random.integers(2))](TABLE, random)})


def use_boxes(folder: Path) -> Found:
    """Read all boxes: they are finite."""
    for truth in read(next(folder.iterdir())):
        for boxes in (truth.boxes3d, truth.boxes2d):
            assert boxes is None or 0 <= truth.stamp_ns < 2**63, "a stamp is no int64"
    return Found()
