"""The page of the live view: the report's look and base script, figures that grow."""

from __future__ import annotations

import functools
from pathlib import Path

import jinja2
from markupsafe import Markup

from kr270_milling import __version__
from kr270_milling.report.page import page as report_page

__all__ = ["page"]

HERE = Path(__file__).parent


@functools.cache
def page() -> str:
    """The HTML text; it asks for nothing but /events."""
    text = (HERE / "watch.html").read_text(encoding="utf-8")
    return jinja2.Template(text, autoescape=True, undefined=jinja2.StrictUndefined).render(
        version=__version__,
        style=Markup((report_page.HERE / "report.css").read_text(encoding="utf-8")),
        plotly=report_page.plotly_script(),
        scripts=report_page.script_text(["base.js"]) + Markup((HERE / "watch.js").read_text(encoding="utf-8")),
    )
