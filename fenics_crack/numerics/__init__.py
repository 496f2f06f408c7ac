"""Numerical methods that know nothing of contact."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
