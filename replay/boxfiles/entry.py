"""What a file of boxes is, without reading its boxes."""

from fbench.replay.boxfiles.digest import digest_of
from fbench.replay.boxfiles.open import form_of
from fbench.replay.logs.setup import BoxSource
from fbench.replay.manifest import TruthEntry


def truth_entry(source: BoxSource) -> TruthEntry:
    """Say where truth comes from, for the manifest.

    Raises:
        ConfigError: where there is no such file or format.
        LogError: where it can't be read, or its form isn't known.
    """
    return TruthEntry(name=source.path.name, format=form_of(source), digest=digest_of(source.path))
