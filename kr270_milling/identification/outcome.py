"""What an identification ends with: numbers, tables, sentences, pictures, and a parameter file to include."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from kr270_milling import __version__
from kr270_milling.base.files import staged
from kr270_milling.base.include import write_include
from kr270_milling.identification.figures import write_page

__all__ = ["Outcome"]


@dataclass(frozen=True)
class Outcome:
    """What is printed, and written into a directory as a page and as a parameter file."""

    name: str  #: of its files
    title: str
    result: dict  #: for JSON
    tables: Sequence[tuple[str, Sequence[str], Sequence[Sequence[str]]]]  #: title, columns, rows
    said: Sequence[str]  #: sentences
    figures: Callable[[], list] | None = None  #: makes the pictures of the page; None: there is no page
    sections: dict | None = None  #: of the parameter file; None: there is none
    use: str = ""  #: how to include it

    def write(self, directory) -> list[Path]:
        """Write page and parameter file; returns their paths."""
        notes = [f"{self.title}, identified by kr270_milling {__version__}", *self.said, self.use]
        files = []
        with staged(directory) as (draft, final):
            if self.sections is not None:
                files.append(write_include(draft / f"{self.name}.yaml", self.sections, notes))
            if self.figures is not None:
                page = draft / f"{self.name}.html"
                files.append(write_page(page, self.title, self.said, self.tables, self.figures()))
            return [final(path) for path in files]
