"""The decorators of compiled functions that make no array."""

from numba import njit

#: Without fastmath, so that a run repeats bit for bit. Without reference counting of arrays, which would take most of
#: the time: nothing compiled here makes an array, it only works on those of its caller. A function without a stated
#: ``forceinline`` takes over that of the function for which it is compiled. A number in a call, as in f(x, 1), makes
#: Numba compile f anew for this number: pass a variable.
OPTIONS: dict = dict(cache=True, error_model="numpy", _nrt=False, no_cfunc_wrapper=True, forceinline=False, nogil=True)
compiled = njit(**OPTIONS)

#: For functions that compiled functions alone call: the wrapper for Python is a further copy to compile. Called from
#: Python, such a function crashes.
INNER: dict = dict(**OPTIONS, no_cpython_wrapper=True)
inner = njit(**INNER)

#: The same for what runs in the innermost loops.
inlined = njit(**{**INNER, "forceinline": True})
