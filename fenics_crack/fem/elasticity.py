"""Isotropic linear elasticity of plates in plane stress and of solids, at rest and rotating, as
DOLFINx's forms.

    plate    sigma = E / (1 - nu^2) ((1 - nu) eps + nu tr(eps) I),    measure t dx
    solid    sigma = 2 mu eps + lambda tr(eps) I,                     measure dx

with eps = sym(grad u), the thickness t, mu = E / (2 (1 + nu)), lambda = 2 mu nu / (1 - 2 nu).

A rotation adds centrifugal load, geometric stiffness and spin softening.

The axis is parallel to x, at y = -R and, of a solid, z = 0; r = (0, R + y, z) is the place seen
from it, P the part of a vector normal to it. The Coriolis force of velocities in a plate's plane is
normal to that; of a solid it is left out. At W = 1 rad/s, t the thickness of a plate, 1 of a solid,

    f_c . v = t int rho r . v dx                              centrifugal load
    u . M_s v = t int rho P u . v dx                          spin softening: it grows with P u
    u . K_g v = t int sigma_ij u_k,i v_k,j dx                 geometric stiffness

sigma is the stress that f_c makes at rest, K u_c + B lambda = f_c, with contact where
f_c presses the lips together (clearances count as zero; most cracks are opened). All of it grows
with W^2, so that a few matrices serve every speed:

    M u'' + C u' + (K + W^2 (K_g - M_s)) u + B lambda(g) = f + W^2 f_c.

The equation is one for the whole displacement, as that of a rotating beam, (EI w'')'' - (T w')' = p
with T the tension (Wright, Smith, Thresher, Wang, Journal of Applied Mechanics 49, 1982, 197). Two
other forms are in use, and not here. With K_g u_c added to the load, the static state is u_c: but a
mean load, or a blade that is not straight, then bends as at rest, without the stiffening. With the
stresses of the mean load in sigma, K_g does not vanish with the speed. What is left out is of the
size of the strains, and of (W / w_r)^2 with w_r the first natural frequency along the radius.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc

from fenics_crack.fem import compat
from fenics_crack.fem.compat import dolfinx, ufl
from fenics_crack.fem.numbering import Dofs
from fenics_crack.model.factor import weighted_sum
from fenics_crack.model.rotation import Rotation, static_state
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene

__all__ = ["constants", "rotation_of", "stress", "thickness"]


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


def rotation_of(scene: Scene, space: Any, dofs: Dofs, at_rest: Structure) -> Rotation:
    """Assemble what the rotation of a scene adds to its structure at rest (collective)."""
    assert scene.rotation is not None
    density, hub = constants(space, scene.material.density, scene.rotation.hub_radius)
    t = thickness(scene, space)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    normal = [0.0, *[1.0] * (scene.dimension - 1)]
    across = ufl.diag(ufl.as_vector(normal))
    center = hub * ufl.as_vector([0.0, -1.0, 0.0][: scene.dimension])
    radius = across * (ufl.SpatialCoordinate(space.mesh) - center)
    load = compat.assembled_vector(t * density * ufl.inner(radius, v) * ufl.dx)[dofs.free]
    moved, _ = static_state(at_rest, load, np.zeros(at_rest.n_pairs))
    tension = stress(scene, space, _function(space, dofs, moved))
    # One form each: together they would be integrated with the higher degree.
    bent = t * ufl.inner(ufl.dot(ufl.grad(u), tension), ufl.grad(v)) * ufl.dx
    geometric = dofs.free_block(compat.assembled_matrix(bent))
    softening = compat.assembled_matrix(t * density * ufl.inner(across * u, v) * ufl.dx)
    softening = dofs.free_block(softening)
    stiffness = weighted_sum(geometric, -1.0, softening)
    geometric.destroy()
    softening.destroy()
    return Rotation(at_rest, stiffness, load, scene.rotation.speed)


def _function(space: Any, dofs: Dofs, displacement: np.ndarray) -> Any:
    """Displacements of the free dofs (n_local,) as a function; zero where the plate is clamped."""
    found = dolfinx.fem.Function(space)
    found.x.array[dofs.free] = displacement
    found.x.scatter_forward()
    return found
