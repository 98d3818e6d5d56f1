"""A card for every metric that a row can have."""

from collections.abc import Mapping

from fbench.metrics.cards import benchmarks, detection, tracking
from fbench.metrics.cards.card import MetricCard
from fbench.replay.errors import ConfigError
from fbench.replay.names import did_you_mean

CARDS: Mapping[str, MetricCard] = {card.name: card for card in (*detection.CARDS, *tracking.CARDS, *benchmarks.CARDS)}
COUNTS = frozenset(card.name for card in CARDS.values() if card.is_count)


def card_of(name: str) -> MetricCard:
    """Return the card of a metric.

    Raises:
        ConfigError: for an unknown name, with the nearest one.
    """
    if name not in CARDS:
        raise ConfigError(f"unknown metric '{name}'{did_you_mean(name, CARDS)}")
    return CARDS[name]
