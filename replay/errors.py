"""Errors and exit codes: every failure that fbench foresees is one `FbenchError` with one clear line."""

EXIT_OK = 0
EXIT_NO = 1
EXIT_USAGE = 2
EXIT_DATA = 3
EXIT_LOSSY = 4


class FbenchError(Exception):
    """Root of all errors that fbench raises on purpose.

    The message is one line: what, where (file, topic, stamp, offset), what to do.
    """

    exit_code = EXIT_DATA


class ConfigError(FbenchError):
    """Usage or configuration: an unknown name, a wrong parameter, an output folder that exists."""

    exit_code = EXIT_USAGE


class LogError(FbenchError):
    """A log that can't be used: wrong format, no calibration, no such sensor."""


class DecodeError(LogError):
    """One message whose payload can't be decoded; readers count it and go on."""


class DataError(FbenchError):
    """An array of the wrong shape or dtype: names field, expected and got."""


class ModelError(FbenchError):
    """Weights that can't be loaded or whose outputs aren't understood."""


class RunError(FbenchError):
    """A run folder that is missing, incomplete or of another version."""


class MetricError(FbenchError):
    """Truth or results that can't be scored."""
