"""Estimate the errors of an answer's numbers, cause by cause."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
