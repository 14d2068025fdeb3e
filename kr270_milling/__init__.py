"""Predict and compensate the compliance errors of robotic milling [Klimchik2012]."""

__version__ = "0.1.0"
