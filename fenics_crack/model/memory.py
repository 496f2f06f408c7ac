"""Memory that structures of meshes and their equations need, stated before it is spent.

Nested dissection leaves O(n log n) numbers in the factor of the stiffness of a plane mesh with n
dofs (George, SIAM Journal on Numerical Analysis 10, 1973, 345); the constant here is that of MUMPS
with its work space, from 4,000 to a million dofs of quadratic cells. In space they are O(n^(4/3)),
with a constant that falls with the thickness: of quadratic tetrahedra, from 7,000 to 180,000 dofs,
it is 95 to 136 in twisted blades, 133 to 203 in plates, 210 to 233 in cubes. Modes are counted by a
second factor while the first one is held.
"""

from __future__ import annotations

import ctypes
import os
import resource
from contextlib import suppress
from pathlib import Path

import numpy as np
from petsc4py import PETSc

from fenics_crack.errors import InputError
from fenics_crack.kernel import kernel
from fenics_crack.model.factor import AT_A_TIME
from fenics_crack.model.modes import krylov_vectors
from fenics_crack.model.rotation import SPEEDS
from fenics_crack.model.structure import Structure

__all__ = [
    "addresses_left", "check_memory", "machine_memory", "reduction_memory", "run_up_memory",
    "whole_memory",
]  # fmt: skip

FACTOR = 60.0
"""Bytes of a factor over n log2 n."""
SOLID_FACTOR = 130.0
"""Of a solid over n^(4/3)."""
MATRICES = 4
"""Dense matrices of the size of the Jacobian that are held at a time, or stiffnesses of coupled
pairs at all instants."""
BASES = 3
"""Of a run-up: as it is put together, what comes in, and what is made of both."""


def machine_memory() -> float:
    """Memory of this machine [byte]."""
    return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))


def addresses_left() -> float:
    """Memory that this process may still ask for under ``ulimit -v`` [byte]; inf without one."""
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit == resource.RLIM_INFINITY:
        return float("inf")
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    return float(limit - pages * os.sysconf("SC_PAGE_SIZE"))


def reduction_memory(structure: Structure, modes: int, method: str) -> float:
    """Most memory of all ranks during :func:`reduce_structure`, what is held already included
    [byte] (collective)."""
    dofs, columns = structure.n_dofs, structure.n_pairs + 1
    kept = modes + max(modes // 2, 10) if method == "massless" else modes
    # Blocks of static responses, or all of them in a basis and that of its reference.
    static = 8.0 * dofs * (4 * AT_A_TIME if method == "massless" else 10 * columns)
    most = max(static, _more_for_modes(structure, kept))
    return _held(structure) + _factor(structure) + 8.0 * dofs * kept + most


def whole_memory(structure: Structure, harmonics: int) -> float:
    """The same of solving it as it is: a factor for each harmonic, all kept (collective)."""
    return _held(structure) + (harmonics + 1) * _factor(structure)


def run_up_memory(structure: Structure, modes: int) -> float:
    """The same of :func:`run_up_structure`: the modes of another speed, with its stiffness, beside
    the basis of the others, or the whole basis as it is made (collective)."""
    basis = 8.0 * structure.n_dofs * SPEEDS * (modes + structure.n_pairs + 1)
    of_modes = _factor(structure) + _more_for_modes(structure, modes) + basis
    return _held(structure) + _matrix(structure) + max(of_modes, BASES * basis)


def _more_for_modes(structure: Structure, count: int) -> float:
    """Of finding modes by a factor: vectors, or another factor, of a matrix and its copy."""
    krylov = 8.0 * structure.n_dofs * krylov_vectors(count)
    return max(krylov, _factor(structure) + 2 * _matrix(structure))


def _matrix(structure: Structure) -> float:
    """A matrix of the stiffness's pattern (collective)."""
    entry = np.dtype(PETSc.ScalarType).itemsize + np.dtype(PETSc.IntType).itemsize
    found: float = structure.stiffness.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]
    return entry * found


def _factor(structure: Structure) -> float:
    if structure.nodes is not None and structure.nodes.points.shape[1] == 3:
        return SOLID_FACTOR * structure.n_dofs ** (4.0 / 3.0)
    return FACTOR * structure.n_dofs * float(np.log2(structure.n_dofs + 1))


def _held(structure: Structure) -> float:
    """Memory that all ranks hold now, without what is free but kept [byte]."""
    with suppress(AttributeError):  # a C library without it
        ctypes.CDLL(None).malloc_trim(0)
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return float(structure.comm.allreduce(pages * os.sysconf("SC_PAGE_SIZE")))


def check_memory(structure: Structure, harmonics: int) -> None:
    """Raise InputError where the dense Jacobian of the equations would not fit, or of coupled pairs
    what they are at all instants, and the vectors of solutions."""
    pairs = structure.n_pairs
    unknowns, order = (2 * harmonics + 1) * pairs, 2
    numbers = MATRICES * unknowns**2
    if structure.light_lips:  # of an estimate too, with twice the harmonics
        vectors = 2 * kernel.KRYLOV_MOST + 2  # those kept, and those of a solution
        numbers, order = 2 * (2 * MATRICES * pairs + vectors) * unknowns, 1
    memory = machine_memory()
    if 8 * numbers > 0.8 * memory:
        fits = int(harmonics * (0.1 * memory / numbers) ** (1.0 / order))
        raise InputError(
            "harmonics",
            harmonics,
            f"at most {fits} with {pairs} pairs: {unknowns} unknowns need "
            f"{numbers * 8 / 2**30:.0f} GiB of this machine's {memory / 2**30:.0f}",
        )
