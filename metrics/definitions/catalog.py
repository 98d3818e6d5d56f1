"""Definitions of every metric that a row can have."""

from collections.abc import Mapping

from fbench.metrics.definitions import detection, tracking
from fbench.metrics.definitions.definition import MetricDefinition
from fbench.replay.contracts.errors import ConfigError, did_you_mean

DEFINITIONS: Mapping[str, MetricDefinition] = {
    card.name: card
    for card in (*detection.DETECTION_DEFINITIONS, *tracking.TRACKING_DEFINITIONS, *tracking.BENCHMARK_DEFINITIONS)
}
COUNTS = frozenset(card.name for card in DEFINITIONS.values() if card.is_count)


def card_of(name: str) -> MetricDefinition:
    """Return the card of a metric.

    Raises:
        ConfigError: for an unknown name, with the nearest one.
    """
    if name not in DEFINITIONS:
        raise ConfigError(f"unknown metric '{name}'{did_you_mean(name, DEFINITIONS)}")
    return DEFINITIONS[name]
