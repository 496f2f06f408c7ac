"""Errors of an answer's numbers, by what is varied and by what judges the change."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
