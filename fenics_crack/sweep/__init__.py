"""Many cases of a scene, spread over ranks."""

import fenics_crack.parallel  # noqa: F401  (MPI before PETSc)
