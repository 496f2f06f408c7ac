"""The compiled kernel: what is called for every point, every instant or every step.

The C files beside this one hold the equations next to the loops; cffi compiles them when the
package is installed (``build.py``). LAPACK is SciPy's, handed over as addresses. A kernel does
not check its arguments: callers check the shapes of what they are given (:func:`shaped`).
"""

from __future__ import annotations

import ctypes
from typing import Any

import numpy as np
from scipy.linalg import cython_blas, cython_lapack

try:
    from fenics_crack.kernel._kernel import ffi, lib
except ImportError as error:  # pragma: no cover
    raise ImportError(
        "the compiled kernel of fenics_crack is missing or broken: run 'sh install.sh'"
    ) from error

kernel: Any = lib
"""The functions of the C files, by their names."""
NULL: Any = ffi.NULL
"""The null pointer."""
IN_C = {
    np.dtype(kind): ffi.typeof(f"{name}[]")
    for name, kinds in {
        "double": (float, complex), "int": (np.intc,), "signed char": (bool, np.int8),
    }.items()
    for kind in kinds
}  # fmt: skip
"""Kinds of numbers in arrays, and their C types."""


def _bind() -> None:
    """Hand the kernel its BLAS and LAPACK."""
    name_of, pointer_of = ctypes.pythonapi.PyCapsule_GetName, ctypes.pythonapi.PyCapsule_GetPointer
    name_of.restype, name_of.argtypes = ctypes.c_char_p, [ctypes.py_object]
    pointer_of.restype, pointer_of.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    known = {**cython_blas.__pyx_capi__, **cython_lapack.__pyx_capi__}
    table = ffi.new("void *[]", lib.LAPACK_FUNCTIONS)
    for name in ("dgemv", "dgemm", "dgetrf", "dgetrs", "dpotrf", "dpotri", "dgeev"):
        capsule = known[name]
        address = pointer_of(capsule, name_of(capsule))
        table[getattr(lib, name.upper())] = ffi.cast("void *", address)
    lib.bind_lapack(table)


def shaped(array: Any, *shape: int, kind: type = float) -> np.ndarray:
    """An array of a kind, C-contiguous, if it has this shape; a copy only where it must be one.

    Raises
    ------
    ValueError
        It has another shape.
    """
    found: np.ndarray = np.ascontiguousarray(array, dtype=kind)
    if np.shape(array) != shape:
        raise ValueError(f"an array of shape {np.shape(array)} instead of {shape}")
    return found


def pointer(array: np.ndarray) -> Any:
    """Numbers of a C-contiguous array, as functions of the kernel take them.

    Raises
    ------
    ValueError
        It has gaps, or they are of no kind that the kernel knows.
    """
    known = IN_C.get(array.dtype)
    if known is None:
        raise ValueError(f"numbers of type {array.dtype} instead of {', '.join(map(str, IN_C))}")
    return ffi.from_buffer(known, array)


def owned(pointer: Any, free: Any) -> Any:
    """Return an object that a kernel function has allocated, freed by ``free`` in the end."""
    if not pointer:
        raise MemoryError
    return ffi.gc(pointer, free)


class Struct:
    """A struct of the C files: numbers, arrays, objects (``owned``) and other structs by the names
    of its members. They live as long as it does; None is a null pointer.

    Attributes
    ----------
    at : its address, what functions take
    """

    def __init__(self, kind: str, **members: Any) -> None:
        self._members = members
        given = {name: _as_member(value) for name, value in members.items()}
        self.at = ffi.new(f"{kind} *", given)

    def but(self, **members: Any) -> Struct:
        """A copy with other values of some members: a part of the time of another one."""
        found = Struct.__new__(Struct)
        found._members = self._members | members
        found.at = ffi.new(ffi.typeof(self.at), self.at[0])
        for name, value in members.items():
            setattr(found.at, name, _as_member(value))
        return found


def _as_member(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return pointer(value)
    if isinstance(value, Struct):
        return value.at[0]
    return NULL if value is None else value


_bind()
