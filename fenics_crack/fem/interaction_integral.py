"""Compute stress intensities at crack tips in plates.

They are linear functionals of the displacement. At any instant a plate is at rest under its loads,
its contact forces and its inertia: K u = r. Let e_1 point ahead of a straight crack. Let s be the
x_1 derivative of the field with unit K_I or K_II around its tip. The field s is in equilibrium,
leaves the crack faces free, and grows like r^-1/2. Let q be a weight function that is 1 at the tip
and 0 beyond a radius. Betti's theorem gives

    2 K / E = int [s . sigma(u) - u . sigma(s)] . grad q dx - 1 / t (r . q s).

This is the interaction integral in domain form after one integration by parts. Its integrand
vanishes next to the tip, where elements resolve little. The last term is the effect of inertia,
body forces and contact inside the domain. With w, the values of q s at the nodes, the term is w . K
u. So K is a vector times the displacement, whatever the loads are.

At the crack faces, s is too uneven for nodal contact forces. So contact acts by the integral of its
pressure. The pressure is linear between pairs, and constant from the last pair to the tip.
Therefore K_I of a closed crack is zero.

References
----------
Yau, Wang and Corten, Journal of Applied Mechanics 47, 1980, 335: interaction integral.
Shih, Moran and Nakamura, International Journal of Fracture 30, 1986, 79: domain form.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.fem import compat
from fenics_crack.fem.compat import dolfinx, ufl
from fenics_crack.fem.cracks import CRACK_FACE_NAMES, CrackPath
from fenics_crack.fem.elasticity import form_constants, stress_expression
from fenics_crack.fem.plate import Dofs
from fenics_crack.model.receptance import check_has_matrices
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene

RADIUS_TO_CLEARANCE = 0.8
"""Radius of the integration domain, relative to the tip's distance from the nearest boundary, bend
or other crack."""
WEIGHT_PLATEAU_RADIUS_FRACTION = 0.2
"""Fraction of the integration domain's radius up to which the weight q is 1."""
QUADRATURE_DEGREE = 8
"""Polynomial degree up to which quadrature is exact. The singular field is no polynomial, hence the
high degree."""


@dataclass(frozen=True)
class Station:
    """Point on a crack tip or front at which stress intensities are computed.

    Attributes
    ----------
    name : str
        Name in results, as "the crack tip", "the left crack tip" of a crack inside, "the crack tip
        of crack 1", or "the crack front at 3.2 mm" with the distance along the front.
    crack_index : int
        Index of the crack in the mesh.
    point, growth_direction : (d,) [m], (d,)
        Position, and unit vector ahead of the crack.
    arc_length : float [m]
        Distance along a crack's path, or along a front, from the first point.
    adjacent_pairs : (k,) int
        Contact pairs with a patch at the front, between the previous and the next station. The
        crack is closed at the station while all these pairs are closed. Always empty for a plate.
    """

    name: str
    crack_index: int
    point: np.ndarray
    growth_direction: np.ndarray
    arc_length: float
    adjacent_pairs: Sequence[int] | np.ndarray = ()


@dataclass(frozen=True)
class Tip(Station):
    """Crack tip in a plate.

    Attributes
    ----------
    domain_radius : float [m]
        Radius of the integration domain, 0.8 times the distance from the nearest boundary, bend or
        other crack.
    """

    domain_radius: float = 0.0


def find_tips(dofs: Dofs) -> list[Tip]:
    """Find all crack tips in a plate, crack by crack (collective).

    A crack with a mouth has a single tip, a crack inside the right tip, then the left tip.
    """
    tips: list[Tip] = []
    cracks = dofs.part_mesh.crack_paths_or_surfaces
    outer_boundary_points = gather_rows(dofs.comm, _outer_boundary_points(dofs))
    for crack_index, crack in enumerate(cracks):
        assert isinstance(crack, CrackPath)
        crack_note = f" of crack {crack_index + 1}" if len(cracks) > 1 else ""
        crack_length = float(crack.corner_arc_lengths[-1])
        tip_ends = [
            ("crack tip" if crack.has_mouth else "right crack tip", crack.points, crack_length)
        ]
        if not crack.has_mouth:
            tip_ends.append(("left crack tip", crack.points[::-1], 0.0))
        for tip_name, path_points_to_tip, arc_length in tip_ends:
            tip_point = path_points_to_tip[-1]
            tip_offsets_from_path_corners = tip_point - path_points_to_tip[:-1]
            growth_direction = tip_offsets_from_path_corners[-1] / np.linalg.norm(
                tip_offsets_from_path_corners[-1]
            )
            is_off_line = np.abs(
                tip_offsets_from_path_corners @ [-growth_direction[1], growth_direction[0]]
            ) > 1e-6 * np.linalg.norm(tip_offsets_from_path_corners, axis=1)
            straight_length = np.linalg.norm(
                tip_offsets_from_path_corners[np.flatnonzero(is_off_line).max(initial=-1) + 1 :][0]
            )
            distances_to_other_cracks = [
                other_crack.find_distances_and_positions(tip_point[None])[0][0]
                for other_crack in cracks
                if other_crack is not crack
            ]
            tip_clearance = min(
                straight_length,
                np.linalg.norm(outer_boundary_points - tip_point, axis=1).min(),
                *distances_to_other_cracks,
            )
            tips.append(
                Tip(
                    f"the {tip_name}{crack_note}",
                    crack_index,
                    tip_point,
                    growth_direction,
                    arc_length,
                    domain_radius=RADIUS_TO_CLEARANCE * tip_clearance,
                )
            )
    return tips


def _outer_boundary_points(dofs: Dofs) -> np.ndarray:
    """Return this rank's nodes on the plate's boundary except crack faces: (n, 2) [m]."""
    part_mesh = dofs.part_mesh
    topology = part_mesh.mesh.topology
    topology.create_connectivity(1, 2)
    crack_face_facets = np.concatenate(
        [part_mesh.facets(crack_face_name) for crack_face_name in CRACK_FACE_NAMES]
    )
    outer_facets = np.setdiff1d(
        dolfinx.mesh.exterior_facet_indices(topology), crack_face_facets
    ).astype(np.int32)
    outer_nodes = dolfinx.fem.locate_dofs_topological(dofs.space, 1, outer_facets)
    return dofs.points[outer_nodes[outer_nodes < dofs.n_nodes_owned_by_rank]]


def _check_tips_are_resolved(scene: Scene, tips: list[Tip], face_points: np.ndarray) -> None:
    """Raise InputError if an element at a crack tip is too long for stress intensities.

    Stress intensities are integrals over a domain around the tip, weighted by a function from 1 at
    the tip to 0 at the domain's radius. An element longer than this radius cannot follow the
    function. ``face_points`` (n, 2) [m] are the nodes on crack faces, from which the element
    lengths are found.
    """
    for tip in tips:
        tip_distances_of_face_nodes = np.linalg.norm(face_points - tip.point, axis=1)
        element_length = (
            scene.mesh.order
            * tip_distances_of_face_nodes[
                tip_distances_of_face_nodes > 1e-9 * tip.domain_radius
            ].min()
        )
        if tip.domain_radius >= element_length:
            continue
        tip_clearance = tip.domain_radius / RADIUS_TO_CLEARANCE
        problem_text = f"{tip.name}, {tip_clearance:.3g} m from an edge, a bend or another crack"
        required_clearance = element_length / RADIUS_TO_CLEARANCE
        requirement = (
            f"a tip at least {required_clearance:.3g} m away, for stress intensities; or"
            " use shorter elements along the crack"
        )
        raise InputError("crack", problem_text, requirement)


def tip_functionals(scene: Scene, structure: Structure) -> tuple[list[Tip], np.ndarray, np.ndarray]:
    """Return the crack tips, and the factors for K_I and K_II (collective).

    The stress intensities are ``displacement_factors`` times the displacement plus
    ``force_factors`` times the contact forces.

    Parameters
    ----------
    scene : Scene
        Plate with known crack lengths.
    structure : Structure
        Structure of the scene, not reduced.

    Returns
    -------
    tips : list of Tip
    displacement_factors : (2 n_tips, n_local) [Pa m^1/2 / m]
        Factors of this rank's displacement in K_I and K_II, tip after tip.
    force_factors : (2 n_tips, n_pairs) [Pa m^1/2 / N]
        Factors of the pairs' contact forces, in the same order of rows.

    Raises
    ------
    InputError
        An element on a crack face is longer than the radius of the domain for the integrals K_I and
        K_II. The tip is then close to an edge, a bend or another crack.
    """
    check_has_matrices(structure, "stress intensities")
    assert structure.nodes is not None
    dofs: Dofs = structure.nodes.dolfinx_mesh_and_dofs
    tips = find_tips(dofs)
    face_normals = _crack_face_normals_at_nodes(dofs)
    node_positions = dofs.points
    assemble_row, displacement_factor_rows, contact_force_factor_rows = (
        _make_row_assembler(scene, dofs),
        [],
        [],
    )
    is_face_node = np.any(face_normals != 0.0, axis=1)[: dofs.n_nodes_owned_by_rank]
    _check_tips_are_resolved(
        scene,
        tips,
        gather_rows(dofs.comm, node_positions[: dofs.n_nodes_owned_by_rank][is_face_node]),
    )
    for tip in tips:
        for mode in range(2):
            nodal_field = _weighted_singular_displacement_slope(
                scene, tip, mode, node_positions, face_normals
            )
            displacement_factor_rows.append(assemble_row(tip, mode, nodal_field))
            contact_force_factor_rows.append(
                _contact_force_factors(
                    scene, structure, tip, mode, dofs.restrict_to_free(nodal_field.ravel())
                )
            )
    return tips, np.array(displacement_factor_rows), np.array(contact_force_factor_rows)


def _crack_face_normals_at_nodes(dofs: Dofs) -> np.ndarray:
    """Integrate basis function times outward normal on the crack faces: (n_nodes, 2) [m].

    The vector at a node has the direction of the normal, and is 0 off the crack faces.
    """
    facet_normal, test_function = ufl.FacetNormal(dofs.part_mesh.mesh), ufl.TestFunction(dofs.space)
    normal_form = ufl.inner(facet_normal, test_function) * dofs.part_mesh.measure_on(
        *CRACK_FACE_NAMES
    )
    return compat.assembled_vector(normal_form).reshape(-1, 2)


def _singular_displacement_derivative(
    r: Any, cos_half_angle: Any, sin_half_angle: Any, kolosov: float, mode: Any
) -> tuple[Any, Any]:
    """Return the derivative, ahead of the crack, of the displacement around a tip.

    The field has K_I = 1 or K_II = 1.

    Parameters
    ----------
    r, cos_half_angle, sin_half_angle : numbers or UFL expressions
        Distance from the tip, and cosine and sine of half the angle from the crack's direction.
    kolosov : float
        Kolosov's constant, (3 - nu) / (1 + nu) in plane stress.
    mode : 0 or 1, or a constant in a form
        0 for K_I, 1 for K_II.

    Returns
    -------
    derivative_1, derivative_2 : numbers or UFL expressions
        Components ahead of the crack and normal to it, multiplied by 4 G (2 pi)^1/2 with the shear
        modulus G.
    """
    cos_angle = cos_half_angle * cos_half_angle - sin_half_angle * sin_half_angle
    sin_angle = 2.0 * cos_half_angle * sin_half_angle
    mode_1_components = (
        (kolosov - cos_angle - 2.0 * sin_angle * sin_angle) * cos_half_angle,
        -(kolosov - cos_angle + 2.0 * sin_angle * sin_angle) * sin_half_angle,
    )
    mode_2_components = (
        -(kolosov + 2.0 + cos_angle - 2.0 * sin_angle * sin_angle) * sin_half_angle,
        -(kolosov - 2.0 + cos_angle + 2.0 * sin_angle * sin_angle) * cos_half_angle,
    )
    derivative_component_1, derivative_component_2 = (
        (1.0 - mode) * mode_1_part + mode * mode_2_part
        for mode_1_part, mode_2_part in zip(mode_1_components, mode_2_components, strict=True)
    )
    return derivative_component_1 / r**0.5, derivative_component_2 / r**0.5


def _kolosov_and_field_scale(scene: Scene) -> tuple[float, float]:
    """Return Kolosov's constant in plane stress, and 1 / (4 G (2 pi)^1/2) [1/Pa].

    The constant is (3 - nu) / (1 + nu), with Poisson's ratio nu. G is the shear modulus.
    """
    nu = scene.material.poisson
    shear_modulus = scene.material.young / (2.0 * (1.0 + nu))
    return (3.0 - nu) / (1.0 + nu), 1.0 / (4.0 * shear_modulus * np.sqrt(2.0 * np.pi))


def find_weight_and_slope(radius_ratio: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the weight q of the interaction integral, and the slope dq / d(r / R).

    ``radius_ratio`` is r / R, distance from the tip or front over the integration domain's radius.
    q is 1 up to r = 0.2 R, and falls smoothly to 0 at R.
    """
    ramp_position = np.clip(
        (radius_ratio - WEIGHT_PLATEAU_RADIUS_FRACTION) / (1.0 - WEIGHT_PLATEAU_RADIUS_FRACTION),
        0.0,
        1.0,
    )
    slope_by_radius_ratio = (
        -30.0
        * ramp_position**2
        * (1.0 - ramp_position) ** 2
        / (1.0 - WEIGHT_PLATEAU_RADIUS_FRACTION)
    )
    weight = 1.0 - ramp_position**3 * (10.0 - 15.0 * ramp_position + 6.0 * ramp_position**2)
    return weight, slope_by_radius_ratio


def _weighted_singular_displacement_slope(
    scene: Scene, tip: Tip, mode: int, points: np.ndarray, outward_normals: np.ndarray
) -> np.ndarray:
    """Return the field w = q s around a crack tip, at given nodes: (n, 2).

    w is a factor of the nodal forces in K_I or K_II. q is a weight, 1 near the tip and 0 at the
    border of the integration domain. s is the derivative of a displacement field in the direction
    ahead of the crack. The displacement field has K_I = 1 or K_II = 1. At the tip w is 0.

    Parameters
    ----------
    scene : Scene
        Scene with the material.
    tip : Tip
        Tip, with the radius of the integration domain.
    mode : int
        0 for K_I = 1, 1 for K_II = 1.
    points : (n, 2) [m]
        Positions of the nodes.
    outward_normals : (n, 2)
        Normals at the nodes on crack faces, of any length; 0 at all other nodes. Used to tell the
        upper from the lower face.
    """
    offsets_from_tip = points - tip.point
    r = np.linalg.norm(offsets_from_tip, axis=1)
    is_in_domain = (r < tip.domain_radius) & (r > 1e-9 * tip.domain_radius)
    e_2 = np.array([-tip.growth_direction[1], tip.growth_direction[0]])
    weighted_field = np.zeros_like(points)
    r, x, y = (
        r[is_in_domain],
        offsets_from_tip[is_in_domain] @ tip.growth_direction,
        offsets_from_tip[is_in_domain] @ e_2,
    )
    normal_components = outward_normals[is_in_domain] @ e_2
    side_signs = np.where(
        normal_components == 0.0, np.where(y >= 0.0, 1.0, -1.0), -np.sign(normal_components)
    )
    cos_half_angle, sin_half_angle = (
        np.sqrt(np.maximum(r + x_sign * x, 0.0) / (2.0 * r)) for x_sign in (1.0, -1.0)
    )
    kolosov, field_scale = _kolosov_and_field_scale(scene)
    derivative_component_1, derivative_component_2 = _singular_displacement_derivative(
        r, cos_half_angle, side_signs * sin_half_angle, kolosov, mode
    )
    weights_times_field_scale = field_scale * find_weight_and_slope(r / tip.domain_radius)[0]
    weighted_field[is_in_domain] = (weights_times_field_scale * derivative_component_1)[
        :, None
    ] * tip.growth_direction + (weights_times_field_scale * derivative_component_2)[:, None] * e_2
    return weighted_field


def _make_row_assembler(scene: Scene, dofs: Dofs) -> Callable[[Tip, int, np.ndarray], np.ndarray]:
    """Return a function that computes the factors of the displacement in K_I or K_II.

    The function's arguments are a tip, a mode (0 for K_I, 1 for K_II), and the field w (n_nodes, 2)
    of :func:`_weighted_singular_displacement_slope`. The function returns a factor for each dof:
    (n_local,). All tips and modes share a compiled form, to save the time of compilation.
    """
    space = dofs.space
    nodal_function = dolfinx.fem.Function(space)
    tip_constants = form_constants(
        space, *(0.0,) * 6, *_kolosov_and_field_scale(scene), scene.material.young
    )
    tip_x, tip_y, e_1x, e_1y, domain_radius, mode_constant, kolosov, field_scale, youngs_modulus = (
        tip_constants
    )
    offset_from_tip = ufl.SpatialCoordinate(space.mesh) - ufl.as_vector([tip_x, tip_y])
    e_1, e_2 = ufl.as_vector([e_1x, e_1y]), ufl.as_vector([-e_1y, e_1x])
    x, y = ufl.dot(offset_from_tip, e_1), ufl.dot(offset_from_tip, e_2)
    r = ufl.sqrt(x * x + y * y)
    cos_half_angle = ufl.sqrt((r + x) / (2.0 * r))
    sin_half_angle = ufl.sign(y) * ufl.sqrt((r - x) / (2.0 * r))
    derivative_component_1, derivative_component_2 = _singular_displacement_derivative(
        r, cos_half_angle, sin_half_angle, kolosov, mode_constant
    )
    singular_derivative = field_scale * (
        derivative_component_1 * e_1 + derivative_component_2 * e_2
    )
    ramp_position = (r / domain_radius - WEIGHT_PLATEAU_RADIUS_FRACTION) / (
        1.0 - WEIGHT_PLATEAU_RADIUS_FRACTION
    )
    q_slope = (
        -30.0
        * ramp_position**2
        * (1.0 - ramp_position) ** 2
        / (domain_radius * (1.0 - WEIGHT_PLATEAU_RADIUS_FRACTION))
    )
    is_on_ramp = ufl.And(ufl.gt(ramp_position, 0.0), ufl.lt(ramp_position, 1.0))
    q_gradient = ufl.conditional(is_on_ramp, q_slope, 0.0) / r * offset_from_tip
    test_function = ufl.TestFunction(space)
    test_strain, derivative_strain, strain_of_nodal_field = (
        ufl.sym(ufl.grad(vector_field))
        for vector_field in (test_function, singular_derivative, nodal_function)
    )
    betti_integrand = ufl.inner(
        stress_expression(scene, space, test_strain), ufl.outer(singular_derivative, q_gradient)
    )
    betti_integrand -= ufl.inner(
        stress_expression(scene, space, derivative_strain), ufl.outer(test_function, q_gradient)
    )
    functional_form = (
        0.5
        * youngs_modulus
        * betti_integrand
        * ufl.dx(metadata={"quadrature_degree": QUADRATURE_DEGREE})
    )
    functional_form -= (
        0.5
        * youngs_modulus
        * ufl.inner(stress_expression(scene, space, strain_of_nodal_field), test_strain)
        * ufl.dx
    )
    compiled_form = compat.compile_form(functional_form)

    def assemble_row(tip: Tip, mode: int, nodal_field: np.ndarray) -> np.ndarray:
        """Assemble the displacement's factors in K_I (``mode`` 0) or K_II (1): (n_local,).

        ``nodal_field`` (n, 2) is w from :func:`_weighted_singular_displacement_slope`.
        """
        nodal_function.x.array[: nodal_field.size] = nodal_field.ravel()
        nodal_function.x.scatter_forward()
        for constant, value in zip(
            tip_constants,
            (*tip.point, *tip.growth_direction, tip.domain_radius, mode),
            strict=False,
        ):
            constant.value = value
        return dofs.restrict_to_free(compat.assembled_vector(compiled_form))

    return assemble_row


def _contact_force_factors(
    scene: Scene, structure: Structure, tip: Tip, mode: int, nodal_field: np.ndarray
) -> np.ndarray:
    """Return the factors of the contact forces in K_I or K_II at a tip: (n_pairs,).

    The pairs' contact forces are replaced by a pressure along the crack faces. Pressure does not
    enter K_II, so all factors for K_II are 0. With ``contact.pairs = "mouth"`` all factors are 0,
    because the force acts at a single node.

    Parameters
    ----------
    scene : Scene
        Scene with contact and material.
    structure : Structure
        Structure with the contact pairs.
    tip : Tip
        Tip at which the stress intensities are computed.
    mode : int
        0 for K_I, 1 for K_II.
    nodal_field : (n_local,)
        Field w of :func:`_weighted_singular_displacement_slope`, at the free dofs.
    """
    force_factors = np.zeros(structure.n_pairs)
    if mode == 1 or scene.contact is None or scene.contact.pairs == "mouth":
        return force_factors
    pairs, thickness = structure.pairs, scene.geometry.thickness or 1.0
    assert pairs.cracks is not None and pairs.positions is not None and pairs.areas is not None
    force_factors -= structure.apply_bt(nodal_field[None])[0]
    pairs_of_crack = np.flatnonzero(pairs.cracks == tip.crack_index)
    pairs_of_crack = pairs_of_crack[
        np.argsort(np.abs(tip.arc_length - pairs.positions[pairs_of_crack]))
    ]
    pair_distances = np.abs(tip.arc_length - pairs.positions[pairs_of_crack])
    quadrature_distances, rule_weights = _singular_quadrature_rule(
        pair_distances, tip.domain_radius
    )
    kolosov, field_scale = _kolosov_and_field_scale(scene)
    point_weights = (
        2.0
        * (kolosov + 1.0)
        * field_scale
        * find_weight_and_slope(quadrature_distances / tip.domain_radius)[0]
        * rule_weights
    )
    hat_values = np.array(
        [
            np.interp(quadrature_distances, pair_distances, identity_row)
            for identity_row in np.eye(len(pairs_of_crack))
        ]
    )
    force_factors[pairs_of_crack] += (
        thickness * hat_values @ point_weights / pairs.areas[pairs_of_crack]
    )
    return 0.5 * scene.material.young / thickness * force_factors


def _singular_quadrature_rule(
    interval_ends: np.ndarray, domain_radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return quadrature points r [m] and weights for int f(r) r^-1/2 dr.

    The integral runs from 0 to ``domain_radius`` [m]. f must be smooth between successive
    ``interval_ends`` [m], in any order. In each interval, Gauss's rule with 8 points is applied to
    the square root of r.

    Returns
    -------
    points, weights : (n,) [m], [m^1/2]
        The integral is the sum of f(points) times weights.
    """
    sqrt_ends = np.sqrt(
        np.unique(np.clip([0.0, *interval_ends, domain_radius], 0.0, domain_radius))
    )
    gauss_points, gauss_weights = np.polynomial.legendre.leggauss(QUADRATURE_DEGREE)
    half_widths = 0.5 * np.diff(sqrt_ends)[:, None]
    sqrt_points = sqrt_ends[:-1, None] + half_widths * (1.0 + gauss_points)
    return (sqrt_points**2).ravel(), (2.0 * half_widths * gauss_weights).ravel()
