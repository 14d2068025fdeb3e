"""The page of the live view: style and base script of the report, figures that grow."""

from __future__ import annotations

from kr270_milling.show.report.page.page import page_text

__all__ = ["watch_page"]


def watch_page() -> str:
    """Return the HTML text; the page requests /events only."""
    return page_text("watch", ("base", "watch"), title="kr270_milling: live")
