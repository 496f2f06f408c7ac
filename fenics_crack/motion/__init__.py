"""Motions of small structures: their flows, and periodic orbits."""

import fenics_crack.parallel  # noqa: F401  (MPI before PETSc)
