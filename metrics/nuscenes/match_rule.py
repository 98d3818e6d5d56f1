"""The one rule by which the nuScenes benchmarks match, with a distance of the user's."""

from fbench.metrics.profile import Match
from fbench.replay.errors import ConfigError


def center_distance(profile: str, match: Match) -> float:
    """Return the distance [m] of a match by centre distance in the ground plane.

    Raises:
        ConfigError: for any other match.
    """
    if match.likeness != "bev":
        raise ConfigError(f"{profile} matches by centre distance only, such as bev:2, not {match}")
    return match.threshold
