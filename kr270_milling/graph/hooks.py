"""What somebody else wants to do or to know while a graph runs: a test that disturbs it, a soak that measures it."""

from __future__ import annotations

import sys

__all__ = ["Hooks"]


class Hooks:
    """The hooks of a run on the command line; a subclass overrides what it needs."""

    def looked(self) -> None:
        """Called some 50 times a second while something is waited for, before the graph looks at its processes."""

    def pass_recorded(self) -> None:
        """Called at the end of a pass, while its recorder is still there."""

    def tell(self, sentence: str) -> None:
        """What the user should know while the run goes on."""
        print(f"kr270_milling: {sentence}", file=sys.stderr)
