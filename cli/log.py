"""`fbench log ...`."""

import typer

from fbench.cli import log_check, log_convert, log_export, log_import, log_info, log_preview, log_simulate
from fbench.cli import options as examples

app = typer.Typer(help="Look into logs and make them.", no_args_is_help=True)
app.command("info", epilog=examples.LOG_INFO)(log_info.info)
app.command("check", epilog=examples.LOG_CHECK)(log_check.check)
app.command("preview", epilog=examples.LOG_PREVIEW)(log_preview.preview)
app.command("convert", epilog=examples.LOG_CONVERT)(log_convert.convert)
app.command("import", epilog=examples.LOG_IMPORT)(log_import.import_)
app.command("export", epilog=examples.LOG_EXPORT)(log_export.export)
app.command("simulate", epilog=examples.LOG_SIMULATE)(log_simulate.simulate)
