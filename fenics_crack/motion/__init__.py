"""Motions of small structures: their flows, and periodic orbits."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
