"""Crack growth under vibration."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
