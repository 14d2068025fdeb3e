"""The page of the live view: style and base script of the report, figures that grow."""

from __future__ import annotations

import functools
from pathlib import Path

from kr270_milling.report.page.page import BASE_SCRIPT, page_text

__all__ = ["page"]

HERE = Path(__file__).parent


@functools.cache
def page() -> str:
    """Return the HTML text; the page requests /events only."""
    return page_text(HERE / "watch.html", [BASE_SCRIPT, HERE / "watch.js"])
