"""Finished passes of a compensation as files, from which an interrupted compensation continues."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from kr270_milling.base.errors import InputError
from kr270_milling.base.files import write_files
from kr270_milling.base.version import __version__
from kr270_milling.cell.cell import Cell
from kr270_milling.cell.cell_file import cell_text
from kr270_milling.path.trajectory import Trajectory, fingerprint
from kr270_milling.physics.compensation.revision import PassRecord

__all__ = ["SavedPasses"]


class SavedPasses:
    """The records of the passes after the first one, ``pass_1.bin`` and so on; each file appears as a whole.

    A pass is taken from its file only for the same version, cell, path file, words and reference. Then the revisions
    that follow are the same as those of the interrupted run.

    words: what else decides about the passes, such as the method and the plant; resume: False deletes the files of an
    earlier run.
    """

    def __init__(self, directory, cell: Cell, words: Sequence[str | None] = (), resume: bool = False):
        self.directory = Path(directory)
        settings = repr((__version__, *words, cell.programmed.sha256, cell_text(cell)))
        self._cell = hashlib.sha256(settings.encode()).hexdigest()
        self._number = 0
        self._resumes = resume
        if not resume:
            self.remove()

    def next(self, reference: Trajectory) -> PassRecord | None:
        """The record of the next pass, which runs ``reference``; None where no file has it.

        Raises InputError for a file of another cell or reference.
        """
        self._number += 1
        path = self._path
        if not self._resumes or not path.is_file():
            return None
        head, _, data = path.read_bytes().partition(b"\n")
        try:
            about = json.loads(head)
            rows = np.frombuffer(data).reshape(-1, about.pop("columns"))
            known = about.pop("of")
            time_ns, wrench = np.ascontiguousarray(rows[:, 0]).view(np.int64), rows[:, 4:]
            ran = PassRecord(time_ns, rows[:, 1:4], wrench=wrench if wrench.size else None, **about)
        except (ValueError, KeyError, TypeError, AttributeError):
            raise InputError(path, "is no finished pass; run without --resume") from None
        if known != self._of(reference):
            raise InputError(path, "is a pass of another cell, method or version; run without --resume")
        return ran

    def save(self, reference: Trajectory, ran: PassRecord) -> None:
        """Write the pass that ``next`` did not have; raises InputError."""
        columns = [ran.time_ns.astype(np.int64).view(float)[:, None], ran.position]
        rows = np.hstack(columns if ran.wrench is None else [*columns, ran.wrench])
        about = {name: getattr(ran, name) for name in ("scored_from_ns", "revolution_ns", "noise")}
        head = json.dumps({"of": self._of(reference), "columns": rows.shape[1], **about})
        try:
            self.directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(self.directory, f"cannot be written into ({error.strerror})") from None
        write_files({self._path: [head.encode() + b"\n", rows.tobytes()]})

    def remove(self) -> None:
        """Delete the files: the compensation is finished, or starts again."""
        shutil.rmtree(self.directory, ignore_errors=True)

    @property
    def _path(self) -> Path:
        return self.directory / f"pass_{self._number}.bin"

    def _of(self, reference: Trajectory) -> str:
        return f"{self._cell} {fingerprint(reference)}"
