"""Motions of small structures: the exact flow, and its periodic orbits."""

import fenics_crack.parallel  # noqa: F401  (MPI before PETSc)
