"""The decorator of every compiled function of the cut."""

from numba import njit

#: Without fastmath, so that a run repeats bit for bit. Without reference counting of arrays, which would take most of
#: the time: nothing compiled here makes an array, it only works on those of its caller.
OPTIONS: dict = dict(cache=True, error_model="numpy", _nrt=False)
compiled = njit(**OPTIONS)

#: The same for what runs in the innermost loops.
inlined = njit(**OPTIONS, forceinline=True)
