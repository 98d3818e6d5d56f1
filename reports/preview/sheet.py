"""The contact sheet: one page that shows picture files beside it."""

from importlib.resources import files

import jinja2
from markupsafe import Markup

from fbench.reports.html.text import visible
from fbench.reports.preview.content import Content


def sheet(content: Content) -> str:
    """Return the page as text; all texts are escaped, and it loads nothing but the pictures."""
    style = files("fbench.reports.html").joinpath("style.css").read_text("utf-8") + _resource("sheet.css")
    return (
        _environment()
        .get_template("sheet.html")
        .render(
            content=content,
            style=Markup(style),  # noqa: S704 - part of the package
        )
    )


def _resource(name: str) -> str:
    return files("fbench.reports.preview").joinpath(name).read_text("utf-8")


def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.FunctionLoader(_resource),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=_shown,
    )


def _shown(value: object) -> object:
    """Make text visible before it is escaped."""
    return visible(value) if isinstance(value, str) and not isinstance(value, Markup) else value
