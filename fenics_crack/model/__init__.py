"""Structures, their modes, reductions and contact laws."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
