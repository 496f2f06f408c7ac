"""Results of the commands, with their scene, their errors and their last sentence."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
