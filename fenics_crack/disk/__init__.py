"""Bladed disks, from the sector to pictures.

``cyclic`` has modes and motions of a wheel with equal sectors, ``wheel`` the mistuned wheel with
cracks, and its reduction. ``sector`` matches the sides of a meshed sector. ``bladed_disk`` has
results of the commands for disks, and ``plot_disk`` their pictures.
"""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
