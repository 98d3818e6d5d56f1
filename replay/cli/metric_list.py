"""What `fbench plugins metrics` and `fbench plugins profiles` print."""

from rich.table import Table

from fbench.replay.cli.plugin_list import show_group
from fbench.replay.cli.show import console


def show_metrics() -> None:
    """List the plug-ins that score runs, then every metric."""
    from fbench.metrics.cards.catalog import CARDS

    show_group("metrics")
    table = _table("metric", "better", "unit", "meaning")
    for card in sorted(CARDS.values(), key=lambda card: card.name):
        table.add_row(card.name, card.better, card.unit, card.meaning)
    out = console()
    out.print()
    out.print(table)


def show_metric(name: str) -> None:
    """Print what one metric is.

    Raises:
        ConfigError: for an unknown name.
    """
    from fbench.metrics.cards.catalog import card_of

    card = card_of(name)
    table = _table("", "")
    rows = {
        "metric": card.name,
        "meaning": card.meaning,
        "formula": card.formula,
        "range": card.range,
        "unit": "count" if card.is_count else card.unit,
        "better": card.better,
        "null when": card.undefined or "never",
        **{f"in {profile}": text for profile, text in card.by_profile.items()},
        "source": str(card.source),
    }
    for what, text in rows.items():
        table.add_row(what, text)
    table.show_header = False
    console().print(table)


def show_profiles() -> None:
    """List every profile."""
    from fbench.metrics.profiles.catalog import PROFILES, profile_of

    table = _table("profile", "what it counts")
    for name in PROFILES:
        table.add_row(name, profile_of(name).summary)
    console().print(table)


def show_profile(name: str) -> None:
    """Print the rules of one profile.

    Raises:
        ConfigError: for an unknown name.
    """
    from fbench.metrics.profiles.catalog import profile_of
    from fbench.metrics.profiles.describe import described, explained

    profile = profile_of(name)
    out = console()
    out.print(f"{profile.name}: {profile.summary}")
    out.print()
    out.print(explained(profile))
    out.print()
    table = _table("rule", "value")
    for path, text in described(profile).items():
        table.add_row(path, text)
    out.print(table)


def _table(*columns: str) -> Table:
    table = Table(box=None, pad_edge=False)
    for column in columns:
        table.add_column(column, no_wrap=column != columns[-1])
    return table
