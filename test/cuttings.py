"""The two force laws with the coefficients that many tests use, and the profile of a machined slot."""

import numpy as np

from kr270_milling.physics.cutting import AL7075_T6, KLIMCHIK2014, Cutting

PAPER_LAW = Cutting(fractional=KLIMCHIK2014)
ALUMINIUM = Cutting(law="linear_edge", linear_edge=AL7075_T6)
LAWS = {"fractional": PAPER_LAW, "linear_edge": ALUMINIUM}
#: the same for a command line, on a cell that has the other law
SET_ALUMINIUM = [
    "cutting.law=linear_edge",
    "cutting.linear_edge.tangential_cutting_n_per_mm2=600.46",
    "cutting.linear_edge.tangential_edge_n_per_mm=17.9",
    "cutting.linear_edge.radial_cutting_n_per_mm2=180.96",
    "cutting.linear_edge.radial_edge_n_per_mm=20.42",
]


def profile(cut) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x of each column that was cut (m,), its lowest and its highest cleared y (m,) [m]."""
    x, y, z = cut.heights()
    cleared = z < cut.stock.max[2]
    found = cleared.any(axis=1)
    first, last = cleared[found].argmax(axis=1), cleared[found, ::-1].argmax(axis=1)
    return x[found], y[first], y[::-1][last]
