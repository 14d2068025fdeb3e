"""``python -m kr270_milling.live.nodes NAME ...``: what the console script NAME does."""

import sys

from kr270_milling.live.nodes.start import NODES, start

if len(sys.argv) < 2 or sys.argv[1] not in NODES:
    sys.exit(f"python -m kr270_milling.live.nodes NAME, one of {', '.join(NODES)}")
del sys.argv[0]
raise SystemExit(start(sys.argv[0]))
