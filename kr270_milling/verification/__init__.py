"""The verification book: every physical check with its expected value, its source and what came out.

Importing this fills ``checks.CHECKS``, in this order.
"""

from kr270_milling.verification import arm, mass, cut, motion, compensation, paper, stability  # noqa: F401, I001
from kr270_milling.verification.checks import CHECKS, Check, Outcome, UnknownCheckError, chosen, run

__all__ = ["CHECKS", "Check", "Outcome", "UnknownCheckError", "chosen", "run"]
