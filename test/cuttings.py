"""The two force laws with the coefficients that many tests use."""

from kr270_milling.cutting import AL7075_T6, KLIMCHIK2012, Cutting

PAPER_LAW = Cutting(fractional=KLIMCHIK2012)
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
