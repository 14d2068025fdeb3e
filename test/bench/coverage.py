"""How many 95 % intervals cover the truth in 100 campaigns of each kind: ``python -m bench.coverage``.

Run it in ``test/``; it takes some minutes. The exit code is 1 where a share is outside of 92 to 97 %.
"""

import sys

import numpy as np
from samples.campaigns import MODES, covered_compliances, covered_forces, find_modes, ring_down

CAMPAIGNS = 100
ALLOWED = 0.92, 0.97


def covered_modes() -> np.ndarray:
    """Ring-downs of 2 s at 200 Hz in three channels, 2 % of noise; frequencies and damping ratios of three modes."""
    hits = []
    for seed in range(CAMPAIGNS):
        modes = find_modes(ring_down(noise=0.02, n=400, step=5e-3, seed=seed), 2.0, 50.0)
        for f, zeta, _ in MODES:
            mode = min(modes, key=lambda mode, f=f: abs(mode.frequency - f))
            error = np.array([mode.frequency - f, mode.damping_ratio - zeta])
            hits.append(np.abs(error) <= mode.half_widths)
    return np.array(hits)


def main() -> int:
    kinds = {
        "compliances": lambda: covered_compliances(21, CAMPAIGNS, 20),
        "compliances, robust": lambda: covered_compliances(21, CAMPAIGNS, 20, robust=True),
        "force coefficients": lambda: covered_forces(22, CAMPAIGNS),
        "force coefficients, robust": lambda: covered_forces(22, CAMPAIGNS, robust=True),
        "modes": covered_modes,
    }
    outside = 0
    for name, campaigns in kinds.items():
        hits = campaigns()
        share = float(np.mean(hits))
        good = ALLOWED[0] <= share <= ALLOWED[1]
        outside += not good
        print(f"{name:28} {100 * share:5.1f} % of {hits.size} intervals {'' if good else 'OUTSIDE'}", flush=True)
    return int(outside > 0)


if __name__ == "__main__":
    sys.exit(main())
