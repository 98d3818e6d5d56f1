"""`fbench plugins`."""

from typing import Annotated

from typer import Argument


def plugins(
    group: Annotated[
        str | None,
        Argument(help="conditions, datasets, decoders, pipelines, metrics, profiles or reports.", show_default=False),
    ] = None,
    name: Annotated[
        str | None,
        Argument(help="Show one: its parameters, a metric's definition, a profile's rules, a condition's levels.",
                       show_default=False),
    ] = None,
) -> None:  # fmt: skip
    """List plug-ins and metrics, or describe one of them."""
    from fbench.cli import listing

    match group, name:
        case "metrics", None:
            listing.show_metrics()
        case "metrics", str():
            listing.show_metric(name)
        case "profiles", None:
            listing.show_profiles()
        case "profiles", str():
            listing.show_profile(name)
        case "conditions", None:
            listing.show_conditions()
        case "conditions", str():
            listing.show_condition(name)
        case "decoders", None:
            listing.show_decoders()
        case "decoders", str():
            listing.show_decoder(name)
        case _, None:
            listing.show_group(group)
        case _:
            listing.show_parameters(group or "", name)
