"""Output directories that are filled as a whole or not at all."""

from __future__ import annotations

import contextlib
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from kr270_milling.base.errors import InputError

__all__ = ["staged"]


@contextlib.contextmanager
def staged(directory) -> Iterator[tuple[Path, Callable[[object], Path]]]:
    """A fresh directory to write into; when the block ends well, its files move to ``directory``.

    Yields it and the function that tells where one of its files will be. After an error nothing is left behind, and
    ``directory`` is as it was. Files of the same names are replaced; a link on the way is refused, so that nothing is
    written elsewhere. Raises InputError where the directory cannot be made.
    """
    final = Path(directory)
    try:
        final.parent.mkdir(parents=True, exist_ok=True)
        if final.exists() and not final.is_dir():
            raise InputError(final, "is a file, but must be a directory to write into")
        # inside of one that exists: it may be a mount point, to which nothing moves from outside
        place = final if final.is_dir() else final.parent
        draft = Path(tempfile.mkdtemp(prefix=f".{final.name}.", suffix=".part", dir=place))
    except OSError as error:
        raise InputError(final, f"cannot be written into ({error.strerror})") from None
    draft.chmod(0o777 & ~_umask())
    try:
        yield draft, lambda path: final / Path(path).relative_to(draft)
        _move(draft, final)
    finally:
        shutil.rmtree(draft, ignore_errors=True)


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


def _move(draft: Path, final: Path) -> None:
    files = [path for path in sorted(draft.rglob("*")) if path.is_file()]
    places = {path: final / path.relative_to(draft) for path in files}
    for place in places.values():
        for parent in place.parents:
            if parent == final:
                break
            if parent.is_symlink() or (parent.exists() and not parent.is_dir()):
                raise InputError(parent, "must be a directory of its own to write into, not a link or a file")
        if place.is_dir() and not place.is_symlink():
            raise InputError(place, "is a directory where a file is to be written")
    try:
        for path, place in places.items():
            place.parent.mkdir(parents=True, exist_ok=True)
            path.replace(place)
    except OSError as error:
        raise InputError(final, f"cannot be written into ({error.strerror})") from None
