"""Compliances, force coefficients and modes from the measurements of one robot, one tool and one material."""
