"""Sweeps: many cases for one scene, shared by ranks."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
