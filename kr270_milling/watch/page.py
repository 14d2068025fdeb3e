"""The page of the live view: the report's look and base script, figures that grow."""

from __future__ import annotations

import functools
from pathlib import Path

from kr270_milling.report.page.page import BASE_SCRIPT, page_text

__all__ = ["page"]

HERE = Path(__file__).parent


@functools.cache
def page() -> str:
    """The HTML text; it asks for nothing but /events."""
    return page_text(HERE / "watch.html", [BASE_SCRIPT, HERE / "watch.js"])
