"""The option `--detect-every`, short for a parameter that pipelines which detect and track have."""

from typing import Annotated

import typer

DetectEvery = Annotated[
    int | None,
    typer.Option(
        "--detect-every", metavar="N", min=1, help="Detect in every N-th frame only; tracks are predicted in between."
    ),
]
_PARAMETER = "detect_every"


def with_detect_every(pipeline: str, settings: list[str], every: int | None) -> list[str]:
    """Return the settings with that of the option behind them, where it was given.

    Raises:
        ConfigError: where the pipeline has no such parameter, or isn't known.
    """
    from fbench.replay.errors import ConfigError
    from fbench.replay.plugins import pipeline_parameters

    if every is None:
        return settings
    if _PARAMETER not in pipeline_parameters(pipeline, []):
        raise ConfigError(
            f"--detect-every {every}: pipeline '{pipeline}' has no parameter {_PARAMETER}; it decides itself when it "
            "detects"
        )
    return [*settings, f"{_PARAMETER}={every}"]
