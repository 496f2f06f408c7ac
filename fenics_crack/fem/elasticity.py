"""Isotropic linear elasticity of plates in plane stress and of solids, as DOLFINx's forms.

    plate    sigma = E / (1 - nu^2) ((1 - nu) eps + nu tr(eps) I),    measure t dx
    solid    sigma = 2 mu eps + lambda tr(eps) I,                     measure dx

with eps = sym(grad u), the thickness t, mu = E / (2 (1 + nu)), lambda = 2 mu nu / (1 - 2 nu).
"""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

from fenics_crack.fem.compat import dolfinx, ufl
from fenics_crack.scene.scene import Scene

__all__ = ["constants", "stress", "thickness"]


def constants(space: Any, *values: float) -> list[Any]:
    """Numbers that a form holds without being compiled anew."""
    return [dolfinx.fem.Constant(space.mesh, PETSc.ScalarType(value)) for value in values]


def thickness(scene: Scene, space: Any) -> Any:
    """t of a plate, 1 of a solid: what the volume is, over the mesh's own."""
    return constants(space, (scene.geometry.thickness or 1.0) if scene.dimension == 2 else 1.0)[0]


def stress(scene: Scene, space: Any, displacement: Any) -> Any:
    """sigma of a displacement."""
    young, poisson = constants(space, scene.material.young, scene.material.poisson)
    strain = ufl.sym(ufl.grad(displacement))
    if scene.dimension == 2:
        found = (1.0 - poisson) * strain + poisson * ufl.tr(strain) * ufl.Identity(2)
        return young / (1.0 - poisson**2) * found
    found = strain + poisson / (1.0 - 2.0 * poisson) * ufl.tr(strain) * ufl.Identity(3)
    return young / (1.0 + poisson) * found
