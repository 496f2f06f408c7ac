"""Motion in time."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
