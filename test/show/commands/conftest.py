"""Commands without the figures of their report, for tests that look at something else."""

from __future__ import annotations

import pytest


@pytest.fixture
def quick(monkeypatch):
    def page(directory, *_, **__):
        path = directory / "report.html"
        path.write_text("figures left out")
        return path

    monkeypatch.setattr("kr270_milling.show.report.write_report", page)
