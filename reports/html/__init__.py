"""The HTML report: one file that opens anywhere and asks for nothing."""

from fbench.reports.html.page import HtmlReport

__all__ = ["HtmlReport"]
