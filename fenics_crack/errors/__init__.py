"""Estimate errors in an answer's numbers, cause by cause."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
