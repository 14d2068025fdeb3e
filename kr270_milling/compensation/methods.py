"""Names of the compensation methods, importable without any library."""

__all__ = ["LIFTED", "METHODS"]

METHODS = ("linear", "spline", "learned", "mirror", "inverse")

#: methods whose knots come from the response of the arm to each of them
LIFTED = ("learned", "inverse")
