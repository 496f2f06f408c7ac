"""Prepare and solve a scene, and read numbers from the solution."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
