"""Define DOLFINx's forms of linear elasticity, at rest and rotating.

Plates are in plane stress (d = 2); solids have d = 3. With the strain eps = sym(grad u), the stress
is

    sigma = E / (1 + nu) (eps + nu / (1 - (d - 1) nu) tr(eps) I).

The measure is t dx with the thickness t of a plate, and t = 1 for a solid.

Rotation
--------
Rotation adds centrifugal load, geometric stiffness and spin softening. Let c be a point on the axis
and a the axis' direction. Then P = I - a a^T projects vectors onto the plane normal to the axis,
and r = P (x - c) is the radius vector. For a plate, a is along x, and c lies at y = -R. The
Coriolis force of velocities in a plate's plane is normal to this plane; for a solid it is
neglected. At the speed W = 1 rad/s,

    f_c . v = t int rho r . v dx                              centrifugal load
    u . M_s v = t int rho P u . v dx                          spin softening: it grows with P u
    u . K_g v = t int sigma_ij u_k,i v_k,j dx                 geometric stiffness

Here sigma is the stress that f_c causes at rest, K u_c + B lambda = f_c. Contact acts where f_c
presses the crack faces together; clearances count as zero, and most cracks are opened. Most of this
stress grows with W^2, so a few matrices serve every speed. The static displacement u_s due to
rotation, and any motion v about it, satisfy

    (K + W^2 K_1) u_s = W^2 f_c,                                      K_1 = K_g - M_s,
    M v'' + C v' + (K + W^2 (K_1 + K_2) + W^4 K_3) v + B lambda = f.

The first equation determines the whole displacement, like the equation of a rotating beam, (EI
w'')'' - (T w')' = p with the tension T. With K_2 and K_3 it would count twice how much a twisted
blade resists further untwisting. In the second equation, K_2 and K_3 are the stiffness due to the
displaced shape: with e(v) = sym((grad u_c)^T grad v),

    u . K_2 v = t int sigma(eps(u)) : e(v) + sigma(eps(v)) : e(u) dx,
    u . K_3 v = t int sigma(e(u)) : e(v) dx.

In a straight blade, which is only stretched, they are negligible compared with K_g. They are as
large as K_g if rotation turns cross-sections, as in a twisted blade. A mean load f bends the
rotating blade by the second equation, with the first equation's stress in sigma. Three effects are
neglected: those of relative size (strain), (rotation of the material)^2, and (W / w_r)^2 with the
first natural frequency w_r along the radius.

References
----------
Wright, Smith, Thresher and Wang, Journal of Applied Mechanics 49, 1982, 197: rotating beams.
Bathe, Finite Element Procedures, 1996, section 6.3: stiffness due to the displaced shape.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from petsc4py import PETSc

from fenics_crack.fem import compat
from fenics_crack.fem.compat import dolfinx, ufl
from fenics_crack.fem.plate import Dofs
from fenics_crack.model.factor import matrix_plus_weighted_matrix
from fenics_crack.model.rotation import Rotation, static_displacement_and_forces
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene


def form_constants(space: Any, *values: float | np.ndarray) -> list[Any]:
    """Wrap numbers, vectors or matrices as DOLFINx constants for forms on a space.

    A form with changed constants is not compiled again.
    """
    arrays = [np.array(value, PETSc.ScalarType, order="C") for value in values]
    return [dolfinx.fem.Constant(space.mesh, array) for array in arrays]


def thickness_constant(scene: Scene, space: Any) -> Any:
    """Return the thickness t as a constant for forms: a plate's [m], 1 for a solid."""
    return form_constants(
        space, (scene.geometry.thickness or 1.0) if scene.dimension == 2 else 1.0
    )[0]


def stress_expression(scene: Scene, space: Any, strain: Any) -> Any:
    """Return the UFL expression of the stress [Pa] for a strain expression (d, d).

    Plates are in plane stress; the material is the scene's.
    """
    young, poisson = form_constants(space, scene.material.young, scene.material.poisson)
    dimension = scene.dimension
    volumetric_strain_term = (
        poisson / (1.0 - (dimension - 1) * poisson) * ufl.tr(strain) * ufl.Identity(dimension)
    )
    return young / (1.0 + poisson) * (strain + volumetric_strain_term)


StaticSolver = Callable[[np.ndarray], np.ndarray]
"""Function from a load (n_local, 1), equal on each sector of a bladed disk, to the static
displacement (n_local, 1)."""


def assemble_rotation(
    scene: Scene, dofs: Dofs, structure_at_rest: Structure, solve_static: StaticSolver | None = None
) -> Rotation:
    """Assemble centrifugal load and rotational stiffness for a structure (collective).

    At the speed W [rad/s], the stiffness is K + W^2 (K_1 + K_2) + W^4 K_3, with the stiffness K at
    rest. K_1 is stress stiffening less spin softening. K_2 and K_3 arise because the centrifugal
    load displaces the structure.

    Parameters
    ----------
    scene : Scene
        Scene with a table ``[rotation]``.
    dofs : Dofs
        The mesh's free dofs.
    structure_at_rest : Structure
        Structure without rotation.
    solve_static : callable, optional
        Only for a sector of a bladed disk: function from a load (n_local, 1), equal on each sector,
        to the static displacement (n_local, 1). Default: solve ``structure_at_rest`` with rigid
        contact.

    Returns
    -------
    Rotation
        Scene's speed, with K_1, K_2, K_3 and the centrifugal load at 1 rad/s.
    """
    space, dimension = dofs.space, scene.dimension
    axis_point, axis_direction = scene.axis_point_and_direction
    projection_matrix = (np.eye(3) - np.outer(axis_direction, axis_direction))[
        :dimension, :dimension
    ]
    rho, c, axis_normal_projection = form_constants(
        space, scene.material.density, axis_point[:dimension], projection_matrix
    )
    thickness = thickness_constant(scene, space)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    r = axis_normal_projection * (ufl.SpatialCoordinate(space.mesh) - c)
    centrifugal_load = compat.assembled_vector(thickness * rho * ufl.inner(r, v) * ufl.dx)
    centrifugal_load = dofs.restrict_to_free(centrifugal_load)
    if solve_static is not None:
        u_c_vector = solve_static(centrifugal_load[:, None])[:, 0]
    else:
        u_c_vector, _ = static_displacement_and_forces(
            structure_at_rest, centrifugal_load, np.zeros(structure_at_rest.n_pairs)
        )
    grad_u_c = ufl.grad(dofs.function(u_c_vector))
    static_stress = stress_expression(scene, space, ufl.sym(grad_u_c))

    def gradient_strain(displacement: Any) -> Any:
        """Return e(v) = sym((grad u_c)^T grad v), the strain due to the displaced shape.

        u_c is the displacement under the centrifugal load, v is ``displacement``.
        """
        return ufl.sym(grad_u_c.T * ufl.grad(displacement))

    def virtual_work(strain: Any, test_strain: Any) -> Any:
        """Return the form t int sigma(strain) : test_strain dx.

        t is a plate's thickness, 1 for a solid; sigma is the stress by Hooke's law.
        """
        return thickness * ufl.inner(stress_expression(scene, space, strain), test_strain) * ufl.dx

    # One form for each matrix: a sum would be integrated with the highest degree.
    K_g, M_s, displaced_shape_stiffness_K_2, displaced_shape_stiffness_K_3 = (
        dofs.restrict_matrix(compat.assembled_petsc_matrix(form))
        for form in (
            thickness * ufl.inner(ufl.dot(ufl.grad(u), static_stress), ufl.grad(v)) * ufl.dx,
            thickness * rho * ufl.inner(axis_normal_projection * u, v) * ufl.dx,
            virtual_work(ufl.sym(ufl.grad(u)), gradient_strain(v))
            + virtual_work(gradient_strain(u), ufl.sym(ufl.grad(v))),
            virtual_work(gradient_strain(u), gradient_strain(v)),
        )
    )
    stiffness_K_1 = matrix_plus_weighted_matrix(K_g, -1.0, M_s)
    K_g.destroy()
    M_s.destroy()
    return Rotation(
        structure_at_rest,
        stiffness_K_1,
        (displaced_shape_stiffness_K_2, displaced_shape_stiffness_K_3),
        centrifugal_load,
        scene.given("rotation").speed,
    )
