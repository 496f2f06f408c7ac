"""From a scene to its results."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
