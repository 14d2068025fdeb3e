"""Names of the compensation methods, importable without any library."""

__all__ = ["METHODS"]

METHODS = ("linear", "spline", "learned", "mirror")
