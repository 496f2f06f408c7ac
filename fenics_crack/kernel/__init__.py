"""The compiled kernel: loops over points, instants and steps, in C.

The C files in this folder hold loops next to the equations. cffi compiles the files when the
package is installed (``build.py``). The kernel calls SciPy's LAPACK by addresses. No C function
checks its arguments: callers check array shapes first (:func:`require_shape`).
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
"""Functions and constants of the C files, by name."""
NULL: Any = ffi.NULL
"""The null pointer."""
C_ARRAY_TYPE_BY_DTYPE = {
    np.dtype(kind): ffi.typeof(f"{name}[]")
    for name, kinds in {
        "double": (float, complex), "int": (np.intc,), "signed char": (bool, np.int8),
    }.items()
    for kind in kinds
}  # fmt: skip
"""C array type for cffi, by the NumPy dtype of the entries."""


def _bind_lapack() -> None:
    """Give the kernel the addresses of SciPy's BLAS and LAPACK functions."""
    get_name = ctypes.pythonapi.PyCapsule_GetName
    get_pointer = ctypes.pythonapi.PyCapsule_GetPointer
    get_name.restype, get_name.argtypes = ctypes.c_char_p, [ctypes.py_object]
    get_pointer.restype, get_pointer.argtypes = ctypes.c_void_p, [ctypes.py_object, ctypes.c_char_p]
    capsule_by_name = {**cython_blas.__pyx_capi__, **cython_lapack.__pyx_capi__}
    addresses = ffi.new("void *[]", lib.LAPACK_FUNCTIONS)
    for name in ("dgemv", "dgemm", "dgetrf", "dgetrs", "dpotrf", "dpotri", "dgeev"):
        capsule = capsule_by_name[name]
        address = get_pointer(capsule, get_name(capsule))
        addresses[getattr(lib, name.upper())] = ffi.cast("void *", address)
    lib.bind_lapack(addresses)


def require_shape(array: Any, *shape: int, kind: type = float) -> np.ndarray:
    """Check an array's shape; return the array C-contiguous, with type ``kind``.

    ``shape`` has the length of each axis. The kernel does not check shapes. A copy is made
    only if necessary.

    Raises
    ------
    ValueError
        The array has another shape.
    """
    contiguous_array: np.ndarray = np.ascontiguousarray(array, dtype=kind)
    if np.shape(array) != shape:
        raise ValueError(f"an array of shape {np.shape(array)} instead of {shape}")
    return contiguous_array


def pointer(array: np.ndarray) -> Any:
    """Return the address of a C-contiguous array's entries for the kernel.

    Raises
    ------
    ValueError
        The array is not contiguous, or the kernel has no C type for its dtype.
    """
    array_type = C_ARRAY_TYPE_BY_DTYPE.get(array.dtype)
    if array_type is None:
        allowed_types = ", ".join(map(str, C_ARRAY_TYPE_BY_DTYPE))
        raise ValueError(f"numbers of type {array.dtype} instead of {allowed_types}")
    return ffi.from_buffer(array_type, array)


def attach_destructor(allocation: Any, destructor: Any) -> Any:
    """Let Python free a kernel object when the last reference ends.

    ``allocation`` is the C pointer to the object, ``destructor`` the kernel function to free the
    object. The result is the pointer with this behaviour.

    Raises
    ------
    MemoryError
        ``allocation`` is a null pointer: the kernel had no memory.
    """
    if not allocation:
        raise MemoryError
    return ffi.gc(allocation, destructor)


class Struct:
    """C struct of the kernel, created from the values of its members by name.

    A value is a number, an array, a pointer from the kernel, another struct or None (a null
    pointer). The object keeps arrays and structs alive for the C pointers.

    Attributes
    ----------
    address : cffi pointer
        Pointer to the struct, an argument for kernel functions. Members are attributes.
    """

    def __init__(self, struct_type: str, **members: Any) -> None:
        self._value_by_member = members
        c_value_by_member_name = {
            name: _as_c_member(member_value) for name, member_value in members.items()
        }
        self.address = ffi.new(f"{struct_type} *", c_value_by_member_name)

    def with_members(self, **members: Any) -> Struct:
        """Return a copy with changed values of the given members, quicker than a new struct."""
        copy = Struct.__new__(Struct)
        copy._value_by_member = self._value_by_member | members
        copy.address = ffi.new(ffi.typeof(self.address), self.address[0])
        for name, member_value in members.items():
            setattr(copy.address, name, _as_c_member(member_value))
        return copy


def _as_c_member(member_value: Any) -> Any:
    """Convert a member's value for cffi: array to pointer, Struct to C struct, None to NULL."""
    if isinstance(member_value, np.ndarray):
        return pointer(member_value)
    if isinstance(member_value, Struct):
        return member_value.address[0]
    return NULL if member_value is None else member_value


_bind_lapack()
