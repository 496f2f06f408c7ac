"""Stress intensity at the tips of a plate's cracks, as a linear functional of the displacement.

At any instant a plate is at rest under its loads, the contact forces on its crack faces and the
inertia of its motion: K u = r. With e_1 ahead of a straight crack, s the derivative by x_1 of the
field around a tip of unit K_I or K_II (it is in balance, leaves the crack faces free, and grows
like r^-1/2), and a weight q that is 1 at the tip and 0 from a distance on, Betti's theorem gives

    2 K / E = int [s . sigma(u) - u . sigma(s)] . grad q dx - 1 / t (r . q s),

which is the interaction integral (Yau, Wang, Corten, Journal of Applied Mechanics 47, 1980, 335) in
the form over a domain (Shih, Moran, Nakamura, International Journal of Fracture 30, 1986, 79) after
one integration by parts: its integrand vanishes next to the tip, where elements resolve little. The
last term is what inertia, body forces and contact inside the domain do. With w, that is q s at the
nodes, it is w . K u: so the whole is one vector times the displacement, whatever acts.

At the crack faces s is too uneven for that: contact acts by the integral of its pressure, which is
linear between the pairs, and constant from the last one to the tip, instead of by forces at nodes.
So K_I of a crack that is closed is zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.fem import compat
from fenics_crack.fem.compat import dolfinx, ufl
from fenics_crack.fem.cracks import LIP_TAGS, CrackPath
from fenics_crack.fem.elasticity import constants, stress
from fenics_crack.fem.plate import Dofs
from fenics_crack.model.receptance import check_matrices
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene

DOMAIN = 0.8
"""Radius of the domain over the distance from the crack tip to the nearest boundary or other
tip."""
INNER = 0.2
"""Fraction of the radius up to which the weight is 1."""
QUADRATURE_DEGREE = 8
"""Degree of the quadrature: the singular field is no polynomial."""


@dataclass(frozen=True)
class Tip:
    """A tip of a crack.

    Attributes
    ----------
    name : str
        "the crack tip"; of a crack inside "the left crack tip"; of several cracks
        "the crack tip of crack 1".
    crack : int
        Number of the crack, from 0.
    point, ahead : (2,) [m], (2,)
        Where it is, and the direction in which the crack would grow straight on.
    position : float [m]
        Its distance along the crack.
    radius : float [m]
        Of the domain.
    """

    name: str
    crack: int
    point: np.ndarray
    growth_direction: np.ndarray
    position: float
    radius: float


def find_tips(dofs: Dofs) -> list[Tip]:
    """All tips of the cracks of a plate (collective)."""
    found: list[Tip] = []
    lips = dofs.plate.cracks
    edge = gather_rows(dofs.comm, _outer_points(dofs))
    for crack, lip in enumerate(lips):
        assert isinstance(lip, CrackPath)
        several = f" of crack {crack + 1}" if len(lips) > 1 else ""
        whole = float(lip.corner_positions[-1])
        ends = [("crack tip" if lip.has_mouth else "right crack tip", lip.points, whole)]
        if not lip.has_mouth:
            ends.append(("left crack tip", lip.points[::-1], 0.0))
        for name, points, position in ends:
            tip = points[-1]
            steps = tip - points[:-1]
            ahead = steps[-1] / np.linalg.norm(steps[-1])
            off = np.abs(steps @ [-ahead[1], ahead[0]]) > 1e-6 * np.linalg.norm(steps, axis=1)
            straight = np.linalg.norm(steps[np.flatnonzero(off).max(initial=-1) + 1 :][0])
            others = [other.locate(tip[None])[0][0] for other in lips if other is not lip]
            room = min(straight, np.linalg.norm(edge - tip, axis=1).min(), *others)
            found.append(Tip(f"the {name}{several}", crack, tip, ahead, position, DOMAIN * room))
    return found


def _outer_points(dofs: Dofs) -> np.ndarray:
    """This rank's nodes on the edges of a plate that are no crack faces: (n, 2) [m]."""
    plate = dofs.plate
    topology = plate.mesh.topology
    topology.create_connectivity(1, 2)
    lips = np.concatenate([plate.facets(name) for name in LIP_TAGS])
    outer = np.setdiff1d(dolfinx.mesh.exterior_facet_indices(topology), lips).astype(np.int32)
    nodes = dolfinx.fem.locate_dofs_topological(dofs.space, 1, outer)
    return dofs.points[nodes[nodes < dofs.n_nodes]]


def _check_resolved(scene: Scene, tips: list[Tip], lips: np.ndarray) -> None:
    """Raise InputError where the element of the crack faces at a tip is longer than the domain's
    radius: the weight then falls within one element, and what is integrated has nothing to do with
    K."""
    for tip in tips:
        distance = np.linalg.norm(lips - tip.point, axis=1)
        element = scene.mesh.order * distance[distance > 1e-9 * tip.radius].min()
        if tip.radius >= element:
            continue
        value = f"{tip.name}, {tip.radius / DOMAIN:.3g} m from an edge, a bend or another crack"
        allowed = f"further away than {element / DOMAIN:.3g} m where stress intensities are"
        allowed += " requested, or with shorter elements along the crack"
        raise InputError("crack", value, allowed)


def tip_functionals(scene: Scene, structure: Structure) -> tuple[list[Tip], np.ndarray, np.ndarray]:
    """The tips, and what a displacement and the contact forces are multiplied by for K_I and K_II
    at each of them (collective).

    Parameters
    ----------
    scene : Scene
        A plate with its crack length known.
    structure : Structure
        Made from it, whole.

    Returns
    -------
    tips : list of Tip
    of_displacement : (2 n_tips, n_local) [Pa m^1/2 / m]
    of_forces : (2 n_tips, n_pairs) [Pa m^1/2 / N]

    Raises
    ------
    InputError
        A tip is closer to an edge, a bend or another crack than the elements of its crack faces are
        long.
    """
    check_matrices(structure, "stress intensities")
    assert structure.nodes is not None
    dofs: Dofs = structure.nodes.numbered
    tips, sides, points = find_tips(dofs), _sides(dofs), dofs.points
    row_of, rows, pressed = _form(scene, dofs), [], []
    on_lips = np.any(sides != 0.0, axis=1)[: dofs.n_nodes]
    _check_resolved(scene, tips, gather_rows(dofs.comm, points[: dofs.n_nodes][on_lips]))
    for tip in tips:
        for kind in range(2):
            field = _nodal(scene, tip, kind, points, sides)
            rows.append(row_of(tip, kind, field))
            pressed.append(_of_forces(scene, structure, tip, kind, dofs.free_part(field.ravel())))
    return tips, np.array(rows), np.array(pressed)


def _sides(dofs: Dofs) -> np.ndarray:
    """Outward normals of the crack faces at this rank's nodes (n_nodes, 2), zero away from the
    crack faces."""
    normal, test = ufl.FacetNormal(dofs.plate.mesh), ufl.TestFunction(dofs.space)
    work = ufl.inner(normal, test) * dofs.plate.measure_on(*LIP_TAGS)
    return compat.assembled_vector(work).reshape(-1, 2)


def _singular(r: Any, c: Any, s: Any, kappa: float, kind: Any) -> tuple[Any, Any]:
    """4 G (2 pi)^1/2 times the derivative by x_1 of the field of unit K_I (kind 0) or K_II (1),
    at a distance r with c and s the cosine and sine of half the angle; for numbers and forms."""
    cosine, sine = c * c - s * s, 2.0 * c * s
    one = ((kappa - cosine - 2.0 * sine * sine) * c, -(kappa - cosine + 2.0 * sine * sine) * s)
    two = (
        -(kappa + 2.0 + cosine - 2.0 * sine * sine) * s,
        -(kappa - 2.0 + cosine + 2.0 * sine * sine) * c,
    )
    x, y = ((1.0 - kind) * a + kind * b for a, b in zip(one, two, strict=True))
    return x / r**0.5, y / r**0.5


def _scale(scene: Scene) -> tuple[float, float]:
    """kappa of plane stress, and 1 / (4 G (2 pi)^1/2)."""
    nu = scene.material.poisson
    shear = scene.material.young / (2.0 * (1.0 + nu))
    return (3.0 - nu) / (1.0 + nu), 1.0 / (4.0 * shear * np.sqrt(2.0 * np.pi))


def _weight(r: np.ndarray, radius: float) -> np.ndarray:
    """q."""
    xi = np.clip((r / radius - INNER) / (1.0 - INNER), 0.0, 1.0)
    return np.asarray(1.0 - xi**3 * (10.0 - 15.0 * xi + 6.0 * xi**2))


def _nodal(
    scene: Scene, tip: Tip, kind: int, points: np.ndarray, normals: np.ndarray
) -> np.ndarray:
    """w = q s at nodes (n, 2), zero at the tip itself."""
    to = points - tip.point
    r = np.linalg.norm(to, axis=1)
    near = (r < tip.radius) & (r > 1e-9 * tip.radius)
    across = np.array([-tip.growth_direction[1], tip.growth_direction[0]])
    found = np.zeros_like(points)
    r, x, y = r[near], to[near] @ tip.growth_direction, to[near] @ across
    out = normals[near] @ across
    side = np.where(out == 0.0, np.where(y >= 0.0, 1.0, -1.0), -np.sign(out))
    c, s = (np.sqrt(np.maximum(r + sign * x, 0.0) / (2.0 * r)) for sign in (1.0, -1.0))
    kappa, scale = _scale(scene)
    one, two = _singular(r, c, side * s, kappa, kind)
    q = scale * _weight(r, tip.radius)
    found[near] = (q * one)[:, None] * tip.growth_direction + (q * two)[:, None] * across
    return found


def _form(scene: Scene, dofs: Dofs) -> Callable[[Tip, int, np.ndarray], np.ndarray]:
    """A function of a tip, a kind and a field: what the displacement of this rank's free dofs is
    multiplied by, (n_local,). The form is the same for all of them but for its constants."""
    space = dofs.space
    moved = dolfinx.fem.Function(space)
    given = constants(space, *(0.0,) * 6, *_scale(scene), scene.material.young)
    x0, y0, a, b, radius, which, kappa, scale, young = given
    to = ufl.SpatialCoordinate(space.mesh) - ufl.as_vector([x0, y0])
    ahead, across = ufl.as_vector([a, b]), ufl.as_vector([-b, a])
    x, y = ufl.dot(to, ahead), ufl.dot(to, across)
    r = ufl.sqrt(x * x + y * y)
    c, s = ufl.sqrt((r + x) / (2.0 * r)), ufl.sign(y) * ufl.sqrt((r - x) / (2.0 * r))
    one, two = _singular(r, c, s, kappa, which)
    singular = scale * (one * ahead + two * across)
    xi = (r / radius - INNER) / (1.0 - INNER)
    slope = -30.0 * xi**2 * (1.0 - xi) ** 2 / (radius * (1.0 - INNER))
    inside = ufl.And(ufl.gt(xi, 0.0), ufl.lt(xi, 1.0))
    falling = ufl.conditional(inside, slope, 0.0) / r * to
    test = ufl.TestFunction(space)
    strained, own, at_nodes = (ufl.sym(ufl.grad(one)) for one in (test, singular, moved))
    betti = ufl.inner(stress(scene, space, strained), ufl.outer(singular, falling))
    betti -= ufl.inner(stress(scene, space, own), ufl.outer(test, falling))
    form = 0.5 * young * betti * ufl.dx(metadata={"quadrature_degree": QUADRATURE_DEGREE})
    form -= 0.5 * young * ufl.inner(stress(scene, space, at_nodes), strained) * ufl.dx
    compiled = compat.compile_form(form)

    def row_of(tip: Tip, kind: int, field: np.ndarray) -> np.ndarray:
        moved.x.array[: field.size] = field.ravel()
        moved.x.scatter_forward()
        for constant, value in zip(
            given, (*tip.point, *tip.growth_direction, tip.radius, kind), strict=False
        ):
            constant.value = value
        return dofs.free_part(compat.assembled_vector(compiled))

    return row_of


def _of_forces(
    scene: Scene, structure: Structure, tip: Tip, kind: int, field: np.ndarray
) -> np.ndarray:
    """Return the factors of the contact forces in K, (n_pairs,): from their pressure along the
    crack faces instead of forces at nodes. It has no part in K_II, and forces at the mouth alone
    stay at their nodes."""
    forces = np.zeros(structure.n_pairs)
    if kind == 1 or scene.contact is None or scene.contact.pairs == "mouth":
        return forces
    pairs, thickness = structure.pairs, scene.geometry.thickness or 1.0
    assert pairs.cracks is not None and pairs.positions is not None and pairs.areas is not None
    forces -= structure.apply_bt(field[None])[0]
    own = np.flatnonzero(pairs.cracks == tip.crack)
    own = own[np.argsort(np.abs(tip.position - pairs.positions[own]))]
    distance = np.abs(tip.position - pairs.positions[own])
    places, weights = _rule(distance, tip.radius)
    kappa, scale = _scale(scene)
    acting = 2.0 * (kappa + 1.0) * scale * _weight(places, tip.radius) * weights
    hats = np.array([np.interp(places, distance, row) for row in np.eye(len(own))])
    forces[own] += thickness * hats @ acting / pairs.areas[own]
    return 0.5 * scene.material.young / thickness * forces


def _rule(ends: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Places r in (0, radius) and weights of integrals of r^-1/2, between ends, by xi^2 = r."""
    roots = np.sqrt(np.unique(np.clip([0.0, *ends, radius], 0.0, radius)))
    nodes, weights = np.polynomial.legendre.leggauss(QUADRATURE_DEGREE)
    half = 0.5 * np.diff(roots)[:, None]
    xi = roots[:-1, None] + half * (1.0 + nodes)
    return (xi**2).ravel(), (2.0 * half * weights).ravel()
