"""`fbench plugins`."""

from typing import Annotated

from typer import Argument


def plugins(
    group: Annotated[
        str | None, Argument(help="datasets, pipelines, metrics, profiles or reports.", show_default=False)
    ] = None,
    name: Annotated[
        str | None,
        Argument(help="One of them: its parameters, a metric's definition, a profile's rules.",
                       show_default=False),
    ] = None,
) -> None:  # fmt: skip
    """List plug-ins and metrics, or say what one of them is."""
    if group in ("metrics", "profiles"):
        from fbench.cli.listing import show_metric, show_metrics, show_profile, show_profiles

        if name is None:
            (show_metrics if group == "metrics" else show_profiles)()
        else:
            (show_metric if group == "metrics" else show_profile)(name)
        return
    from fbench.cli.listing import show_group, show_parameters

    if name is not None:
        show_parameters(group or "", name)
    else:
        show_group(group)
