"""Isotropic linear elasticity of plates in plane stress and of solids, at rest and rotating, as
DOLFINx's forms.

    sigma = E / (1 + nu) (eps + nu / (1 - (d - 1) nu) tr(eps) I),

with eps = sym(grad u); of a plate d = 2, and of a solid d = 3. The measure is t dx, with the
thickness t of a plate, or dx.

A rotation adds centrifugal load, geometric stiffness and spin softening.

With a point c of the axis and its direction a, P = I - a a^T is the part of a vector normal to it
and r = P (x - c) the place seen from it; of a plate a is along x and c at y = -R. The Coriolis
force of velocities in a plate's plane is normal to that; of a solid it is left out. At W = 1 rad/s,
t the thickness of a plate, 1 of a solid,

    f_c . v = t int rho r . v dx                              centrifugal load
    u . M_s v = t int rho P u . v dx                          spin softening: it grows with P u
    u . K_g v = t int sigma_ij u_k,i v_k,j dx                 geometric stiffness

sigma is the stress that f_c makes at rest, K u_c + B lambda = f_c, with contact where f_c presses
the crack faces together (clearances count as zero; most cracks are opened). Most of it grows with
W^2, so that a few matrices serve every speed. The displacement u_s that rotation itself makes, and
any motion v about it, are those of

    (K + W^2 K_1) u_s = W^2 f_c,                                      K_1 = K_g - M_s,
    M v'' + C v' + (K + W^2 (K_1 + K_2) + W^4 K_3) v + B lambda = f.

The first equation is one for the whole displacement, as that of a rotating beam, (EI w'')'' -
(T w')' = p with T the tension (Wright, Smith, Thresher, Wang, Journal of Applied Mechanics 49,
1982, 197); with K_2 and K_3 in it, it would count twice by how much a twisted blade resists being
untwisted further. In the second one they are the stiffness that comes with the displaced shape
(Bathe, Finite Element Procedures, 1996, 6.3): with e(v) = sym((grad u_c)^T grad v)

    u . K_2 v = t int sigma(eps(u)) : e(v) + sigma(eps(v)) : e(u) dx,
    u . K_3 v = t int sigma(e(u)) : e(v) dx.

They are nothing beside K_g in a straight blade, which is stretched alone, and as large where
rotation turns cross-sections, as those of a twisted blade. A mean load f bends the rotating blade
by the second equation, the first one's stress in sigma. What is left out is of the size of the
strains, of the square of the rotations, and of (W / w_r)^2 with w_r the first natural frequency
along the radius.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenics_crack.fem import compat
from fenics_crack.fem.compat import dolfinx, ufl
from fenics_crack.fem.plate import Dofs
from fenics_crack.model.factor import weighted_sum
from fenics_crack.model.rotation import Rotation, static_state
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene


def constants(space: Any, *values: float | np.ndarray) -> list[Any]:
    """Numbers, vectors and matrices that a form holds without being compiled anew."""
    arrays = [np.array(value, PETSc.ScalarType, order="C") for value in values]
    return [dolfinx.fem.Constant(space.mesh, array) for array in arrays]


def thickness(scene: Scene, space: Any) -> Any:
    """t of a plate, 1 of a solid: what the volume is, over the mesh's own."""
    return constants(space, (scene.geometry.thickness or 1.0) if scene.dimension == 2 else 1.0)[0]


def stress(scene: Scene, space: Any, strain: Any) -> Any:
    """sigma of a strain."""
    young, poisson = constants(space, scene.material.young, scene.material.poisson)
    d = scene.dimension
    spread = poisson / (1.0 - (d - 1) * poisson) * ufl.tr(strain) * ufl.Identity(d)
    return young / (1.0 + poisson) * (strain + spread)


Static = Callable[[np.ndarray], np.ndarray]
"""Displacement (n_local, 1) under a constant load on each sector of a wheel."""


def rotation_of(
    scene: Scene, dofs: Dofs, at_rest: Structure, static: Static | None = None
) -> Rotation:
    """Assemble what the rotation of a scene adds to its structure at rest, of a wheel with its
    ``static`` displacement (collective)."""
    space, size, (place, axis) = dofs.space, scene.dimension, scene.axis
    across = (np.eye(3) - np.outer(axis, axis))[:size, :size]
    density, center, normal = constants(space, scene.material.density, place[:size], across)
    t = thickness(scene, space)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    radius = normal * (ufl.SpatialCoordinate(space.mesh) - center)
    load = compat.assembled_vector(t * density * ufl.inner(radius, v) * ufl.dx)
    load = dofs.free_part(load)
    if static is not None:
        moved = static(load[:, None])[:, 0]
    else:
        moved, _ = static_state(at_rest, load, np.zeros(at_rest.n_pairs))
    turned = ufl.grad(dofs.function(moved))
    tension = stress(scene, space, ufl.sym(turned))

    def crossed(one: Any, other: Any) -> Any:
        return ufl.inner(stress(scene, space, ufl.sym(ufl.grad(one))), turned.T * ufl.grad(other))

    def bent(displacement: Any) -> Any:
        return ufl.sym(turned.T * ufl.grad(displacement))

    def work(one: Any, other: Any) -> Any:
        return t * ufl.inner(stress(scene, space, one), other) * ufl.dx

    # One form each: together they would be integrated with the highest degree.
    geometric, softening, second, third = (
        dofs.free_block(compat.assembled_matrix(form))
        for form in (
            t * ufl.inner(ufl.dot(ufl.grad(u), tension), ufl.grad(v)) * ufl.dx,
            t * density * ufl.inner(normal * u, v) * ufl.dx,
            work(ufl.sym(ufl.grad(u)), bent(v)) + work(bent(u), ufl.sym(ufl.grad(v))),
            work(bent(u), bent(v)),
        )
    )
    first = weighted_sum(geometric, -1.0, softening)
    geometric.destroy()
    softening.destroy()
    return Rotation(at_rest, first, (second, third), load, scene.given("rotation").speed)
