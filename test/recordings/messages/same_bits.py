"""Two records compared to the bit."""

from __future__ import annotations

import dataclasses

import numpy as np


def same_bits(one, other) -> str:
    """The name of the first field in which two records differ in any bit; "" where they are the same.

    Arrays are the same where type, shape and bytes are: 0.0 is not -0.0, and a NaN is that NaN.
    """
    if type(one) is not type(other):
        return "type"
    names = one._fields if hasattr(one, "_fields") else [field.name for field in dataclasses.fields(one)]
    for name in names:
        a, b = getattr(one, name), getattr(other, name)
        if isinstance(a, (np.ndarray, float)) and type(a) is type(b):
            a, b = np.asarray(a), np.asarray(b)
            equal = a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
        else:
            equal = type(a) is type(b) and a == b
        if not equal:
            return name
    return ""
