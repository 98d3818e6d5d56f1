"""Built-in importers keep the promises of their protocol on real recordings; on made ones see the tests of each."""

from collections.abc import Callable
from pathlib import Path

import pytest

from fbench.datasets.astyx import Astyx
from fbench.datasets.kitti import Kitti
from fbench.datasets.radiate import Radiate
from fbench.replay.contracts.protocols import Importer
from fbench.replay.contracts.testing import check_importer


@pytest.mark.slow
@pytest.mark.parametrize(
    ("make", "folder"),
    [(Astyx, "astyx"), (Kitti, "kitti_object"), (Kitti, "kitti_tracking"), (Radiate, "radiate_tiny_foggy")],
)
def test_importer_keeps_what_its_protocol_promises(shared: Path, make: Callable[[], Importer], folder: str) -> None:
    source = shared / "data" / folder
    if not source.is_dir():
        pytest.skip(f"real recordings are not at {source}")
    check_importer(make, source)
