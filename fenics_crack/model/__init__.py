"""Structures, their modes, reductions and contact laws."""

import fenics_crack.parallel  # noqa: F401  (MPI before PETSc)
