"""Where fbench keeps what it can make or fetch again."""

import os
import sys
from pathlib import Path


def fbench_cache() -> Path:
    """Return the folder of fbench's caches: `$FBENCH_CACHE` where that is set, else in the user's cache.

    Raises:
        RuntimeError: where the user has no home folder.
    """
    given = os.environ.get("FBENCH_CACHE", "")
    return Path(given).expanduser().absolute() if given else user_cache() / "fbench"


def user_cache() -> Path:
    """Return the folder in which this user's programs keep caches.

    Raises:
        RuntimeError: where the user has no home folder.
    """
    if sys.platform == "win32" and os.environ.get("LOCALAPPDATA"):
        return Path(os.environ["LOCALAPPDATA"])
    given = os.environ.get("XDG_CACHE_HOME", "")
    if Path(given).is_absolute():
        return Path(given)
    return Path.home() / ("Library/Caches" if sys.platform == "darwin" else ".cache")
