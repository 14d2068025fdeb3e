"""Results of an identification for terminal, JSON, page and parameter file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kr270_milling.base.column import TextTable
from kr270_milling.base.files import staged
from kr270_milling.base.parameter_file import write_include
from kr270_milling.base.version import __version__
from kr270_milling.show.report.study_page import write_page


@dataclass(frozen=True)
class Outcome:
    """A result that can be printed, and written to a directory as a page and as a parameter file."""

    name: str  #: stem of its files
    title: str
    result: dict  #: for JSON
    tables: Sequence[TextTable]
    sentences: Sequence[str]
    figures: Callable[[], list] | None = None  #: makes the figures of the page; None: no page
    sections: dict | None = None  #: text of the parameter file; None: no parameter file
    use: str = ""  #: sentence that says where to include the parameter file
    refused: bool = False  #: the result must not be used: no parameter file is written

    def write(self, directory, self_contained: bool = False) -> list[Path]:
        """Write page and parameter file; return their paths. self_contained: as of ``write_page``."""
        notes = [f"{self.title}, identified by kr270_milling {__version__}", *self.sentences, self.use]
        files = []
        with staged(directory) as (draft, final):
            if self.sections is not None and not self.refused:
                files.append(write_include(draft / f"{self.name}.yaml", self.sections, notes))
            if self.figures is not None:
                page = draft / f"{self.name}.html"
                figures = self.figures()
                write_page(page, self.title, self.sentences, self.tables, figures, self_contained=self_contained)
                files.append(page)
            return [final(path) for path in files]
