"""Cracks that grow under the vibration of their structure."""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
