"""What rotation adds to a plate: centrifugal load, geometric stiffness and spin softening.

The axis lies in the plate's plane, parallel to x, at y = -R; the radius is R + y. In-plane
velocities then have a Coriolis force normal to the plane only. At W = 1 rad/s, t the thickness,

    f_c . v = t int rho (R + y) v_y dx                        centrifugal load
    u . M_y v = t int rho u_y v_y dx                          spin softening: it grows with u_y
    u . K_g v = t int sigma_ij u_k,i v_k,j dx                 geometric stiffness

sigma is the stress that f_c makes in the plate at rest, K u_c + B lambda = f_c, with contact where
f_c presses the lips together (clearances count as zero; most cracks are opened). All of it grows
with W^2, so that a few matrices serve every speed:

    M u'' + C u' + (K + W^2 (K_g - M_y)) u + B lambda(g) = f + W^2 f_c.

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

__all__ = ["constants", "plane_stress", "rotation_of"]


def plane_stress(scene: Scene, space: Any, displacement: Any) -> Any:
    """sigma = E / (1 - nu^2) ((1 - nu) eps + nu tr(eps) I), eps = sym(grad u)."""
    young, poisson = constants(space, scene.material.young, scene.material.poisson)
    strain = ufl.sym(ufl.grad(displacement))
    stress = (1.0 - poisson) * strain + poisson * ufl.tr(strain) * ufl.Identity(2)
    return young / (1.0 - poisson**2) * stress


def constants(space: Any, *values: float) -> list[Any]:
    """Numbers that a form holds without being compiled anew."""
    return [dolfinx.fem.Constant(space.mesh, PETSc.ScalarType(value)) for value in values]


def rotation_of(scene: Scene, space: Any, dofs: Dofs, at_rest: Structure) -> Rotation:
    """Assemble what the rotation of a scene adds to its structure at rest (collective)."""
    assert scene.rotation is not None
    thickness, density, hub = constants(
        space, scene.geometry.thickness, scene.material.density, scene.rotation.hub_radius
    )
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    radius = hub + ufl.SpatialCoordinate(space.mesh)[1]
    load = compat.assembled_vector(thickness * density * radius * v[1] * ufl.dx)[dofs.free]
    moved, _ = static_state(at_rest, load, np.zeros(at_rest.n_pairs))
    stress = plane_stress(scene, space, _function(space, dofs, moved))
    # One form each: together they would be integrated with the higher degree.
    bent = thickness * ufl.inner(ufl.dot(ufl.grad(u), stress), ufl.grad(v)) * ufl.dx
    geometric = dofs.free_block(compat.assembled_matrix(bent))
    softening = compat.assembled_matrix(thickness * density * u[1] * v[1] * ufl.dx)
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
