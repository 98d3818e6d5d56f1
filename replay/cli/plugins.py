"""`fbench plugins`."""

from typing import Annotated

import typer


def plugins(
    group: Annotated[str | None, typer.Argument(help="datasets, pipelines, metrics or reports.")] = None,
    name: Annotated[str | None, typer.Argument(help="One dataset or pipeline, to show its parameters.")] = None,
) -> None:
    """List plug-ins, or the parameters of a dataset's importer or of a pipeline."""
    from fbench.replay.cli.plugin_list import show_group, show_parameters

    if name is not None:
        show_parameters(group or "", name)
    else:
        show_group(group)
