"""The two force laws with the coefficients that many tests use."""

from kr270_milling.cutting import AL7075_T6, KLIMCHIK2012, Cutting

PAPER_LAW = Cutting(fractional=KLIMCHIK2012)
ALUMINIUM = Cutting(law="linear_edge", linear_edge=AL7075_T6)
LAWS = {"fractional": PAPER_LAW, "linear_edge": ALUMINIUM}
