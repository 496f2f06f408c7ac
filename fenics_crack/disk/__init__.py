"""Model bladed disks, from the sector to pictures.

``cyclic`` solves a wheel with equal sectors. ``wheel`` models and reduces the mistuned wheel with
cracks. ``sector`` matches the sides of a meshed sector. ``bladed_disk`` computes the results of the
commands for disks, and ``plot_disk`` draws pictures.
"""

import fenics_crack.basics.ranks  # noqa: F401  (MPI before PETSc)
