"""How many examples hypothesis tries: few in the suite, all of them where KR270_MILLING_LONG_TESTS is set."""

import os

LONG = bool(os.environ.get("KR270_MILLING_LONG_TESTS"))


def budget(examples: int) -> int:
    """Of a long run; a fifth of it, but 20 at least, in a usual one."""
    return examples if LONG else min(examples, max(examples // 5, 20))
