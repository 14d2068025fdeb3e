"""``python -m kr270_milling``: the command line."""

import sys

from kr270_milling.cli import main

if __name__ == "__main__":
    sys.exit(main())
