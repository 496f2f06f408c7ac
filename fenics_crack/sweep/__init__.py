"""Many cases of a scene, spread over ranks."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
