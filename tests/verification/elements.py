"""Finite elements: orders of convergence."""

from functools import cache
from typing import Any

import numpy as np
import scipy.sparse.linalg
from book import Row, case, label
from helpers import log_slope
from plates import cracked_plate, csr, pull, tada
from scipy.integrate import quad

import fenics_crack as fc

POISSON = 0.3
MESHES = (8, 16, 32, 64)


# --- manufactured solution ------------------------------------------------------------------------


def wave(x: np.ndarray, frequency: float, order: int, *, fourth: bool = False) -> np.ndarray:
    """sin^2(f pi x), or sin^4, or a derivative, by cosines of multiples of 2 f pi x."""
    weights = (3.0 / 8.0, -0.5, 1.0 / 8.0) if fourth else (0.5, -0.5, 0.0)
    wave_values = np.zeros_like(x)
    for multiple, weight in enumerate(weights):
        rate = 2.0 * np.pi * frequency * multiple
        wave_values += weight * rate**order * np.cos(rate * x + 0.5 * np.pi * order)
    return wave_values


WAVES = ((1.0, (1.0, 1.0)), (-0.7, (2.0, 1.0)))
"""u = a sin^2(f pi x) sin^4(g pi y): a and (f, g) of either component."""


def made(x: np.ndarray, y: np.ndarray, component: int, along: tuple[int, int]) -> np.ndarray:
    """A derivative of a component of the manufactured displacement."""
    size, (f, g) = WAVES[component]
    return np.asarray(size * wave(x, f, along[0]) * wave(y, g, along[1], fourth=True))


def body_force(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """-div sigma in plane stress with E = 1: (2, ...)."""
    normal, shear = 1.0 / (1.0 - POISSON**2), 0.5 / (1.0 + POISSON)
    mixed_modulus = POISSON * normal + shear
    return -np.array(
        [
            normal * made(x, y, 0, (2, 0)) + shear * made(x, y, 0, (0, 2))
            + mixed_modulus * made(x, y, 1, (1, 1)),
            normal * made(x, y, 1, (0, 2)) + shear * made(x, y, 1, (2, 0))
            + mixed_modulus * made(x, y, 0, (1, 1)),
        ]
    )  # fmt: skip


def lagrange(order: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and derivatives (instants, nodes) of Lagrange's polynomials on [0, 1]."""
    nodes = np.linspace(0.0, 1.0, order + 1)
    values, slopes = [], []
    for i in range(order + 1):
        other_nodes = np.delete(nodes, i)
        polynomial = np.poly1d(other_nodes, r=True) / np.prod(nodes[i] - other_nodes)
        values.append(polynomial(at))
        slopes.append(polynomial.deriv()(at))
    return np.array(values).T, np.array(slopes).T


def errors_of_the_made(cells: int, order: int) -> tuple[float, float]:
    """Errors of the displacement and of its gradient in L2, by Gauss's quadrature in each cell.

    The body force is interpolated in the elements' own space, f = M b / density, which keeps the
    order of both errors.
    """
    mesh = {"layout": "grid", "columns": cells, "rows": cells, "order": order}
    structure = fc.build_structure(cracked_plate(1.0, 1.0, [], mesh))
    points, dofs = structure.nodes.points, structure.nodes.dofs
    is_free = dofs >= 0
    load = np.zeros(structure.n_dofs)
    load[dofs[is_free]] = body_force(*points.T).T[is_free]
    displacement = scipy.sparse.linalg.spsolve(
        csr(structure.stiffness).tocsc(), csr(structure.mass) @ load, "MMD_AT_PLUS_A"
    )
    count = order * cells + 1
    place = np.round(points * (count - 1)).astype(int)
    values = np.zeros((2, count, count))
    for component in (0, 1):
        is_free_here = is_free[:, component]
        values[(component, *place[is_free_here].T)] = displacement[dofs[is_free_here, component]]
    gauss, weights = np.polynomial.legendre.leggauss(6)
    gauss, weights = 0.5 * (gauss + 1.0), 0.5 * weights / cells
    shapes, slopes = lagrange(order, gauss)
    nodes = order * np.arange(cells)[:, None] + np.arange(order + 1)
    gauss_points = ((np.arange(cells)[:, None] + gauss) / cells).ravel()
    x, y = np.meshgrid(gauss_points, gauss_points, indexing="ij")
    weight = np.outer(np.tile(weights, cells), np.tile(weights, cells))
    errors = np.zeros(2)
    for component in (0, 1):
        blocks = values[component][nodes[:, None, :, None], nodes[None, :, None, :]]
        for kind, derivatives, (x_table, y_table) in (
            (0, (0, 0), (shapes, shapes)),
            (1, (1, 0), (cells * slopes, shapes)),
            (1, (0, 1), (shapes, cells * slopes)),
        ):
            field = np.einsum("ijab,pa,qb->ipjq", blocks, x_table, y_table).reshape(x.shape)
            errors[kind] += np.sum(weight * (field - made(x, y, component, derivatives)) ** 2)
    return float(np.sqrt(errors[0])), float(np.sqrt(errors[1]))


@cache
def made_errors() -> dict[int, np.ndarray]:
    """By order: errors (mesh, kind)."""
    return {
        order: np.array([errors_of_the_made(cells, order) for cells in MESHES]) for order in (1, 2)
    }


def draw_made(axes: Any) -> None:
    """Errors over the size of the cells."""
    sizes = 1.0 / np.array(MESHES)
    for order, errors in made_errors().items():
        for kind, word in enumerate(("displacement", "gradient")):
            name = f"order {order}, {word}: {log_slope(sizes[-2:], errors[-2:, kind]):.2f}"
            axes.loglog(
                sizes, errors[:, kind], f"C{order}{'o-' if kind == 0 else 's--'}", label=name
            )
    axes.set(xlabel="size of the cells", ylabel="error in L2")
    axes.minorticks_off()
    axes.set_xticks(sizes, [f"1/{cells}" for cells in MESHES])
    axes.legend(fontsize="small")


@case(draw=draw_made)
def manufactured_solution() -> list[Row]:
    """Manufactured solution in plane stress.

    Unit square, E = 1, nu = 0.3, u = (sin^2(pi x) sin^4(pi y), -0.7 sin^2(2 pi x) sin^4(pi y)),
    zero with its gradient on all edges. The body force b = -div sigma is put on the nodes.

    Reference: the order of the elements, p + 1 for the displacement and p for its gradient in L2
    (Roache, J. Fluids Eng. 124, 2002, 4-10), fitted over 32 and 64 cells a side, four- and
    nine-node quadrilaterals.
    """
    rows = []
    for order, errors in made_errors().items():
        for kind, word in enumerate(("displacement", "gradient")):
            slope = log_slope(1.0 / np.array(MESHES[-2:]), errors[-2:, kind])
            expected_order = order + 1 - kind
            rows += [Row(f"order {order}: {word}", slope, expected_order, 0.05, absolute=True)]
    return rows


# --- cracks ---------------------------------------------------------------------------------------


def fitted_order(values: Any) -> float:
    """From three meshes, each with half the size of the one before."""
    return float(np.log2((values[0] - values[1]) / (values[1] - values[2])))


def extrapolated(values: Any, order: float) -> float:
    """Richardson's, from the last two meshes."""
    return float(values[2] + (values[2] - values[1]) / (2.0**order - 1.0))


@cache
def cracked_modes(
    mesh: tuple[tuple[str, Any], ...], poisson: float = POISSON
) -> tuple[int, np.ndarray]:
    """Dofs and the first two frequencies of a unit square with a crack to its middle."""
    crack = {"edge": "left", "height": 0.5, "length": 0.5}
    scene = cracked_plate(1.0, 1.0, [crack], dict(mesh), **{"material.poisson": poisson})
    structure = fc.build_structure(scene)
    return structure.n_dofs, fc.solve_modes(structure, 2).omega


def grid(cells: int, order: int) -> tuple[tuple[str, Any], ...]:
    """Of equal cells."""
    return (("layout", "grid"), ("columns", cells), ("rows", cells), ("order", order))


def graded(size: float, lips: int, grading: float) -> tuple[tuple[str, Any], ...]:
    """Nine-node quadrilaterals, smaller towards the tip."""
    keys = ("layout", "size", "lip_elements", "grading", "order")
    return tuple(zip(keys, ("graded", size, lips, grading, 2), strict=True))


UNIFORM = {1: (16, 32, 64), 2: (8, 16, 32)}
GRADED = (graded(0.2, 4, 4.0), graded(0.1, 8, 16.0), graded(0.1, 12, 50.0))


def crack_limit(poisson: float = POISSON) -> np.ndarray:
    """Frequencies extrapolated from the grids of nine-node quadrilaterals with order 1."""
    values = np.array([cracked_modes(grid(cells, 2), poisson)[1] for cells in UNIFORM[2]])
    return np.array([extrapolated(values[:, mode], 1.0) for mode in (0, 1)])


def smallest_cell(lips: int, grading: float) -> float:
    """At the tip of the crack of 0.5: sizes are a geometric series."""
    ratio = grading ** (1.0 / (lips - 1))
    return 0.5 * (ratio - 1.0) / (ratio**lips - 1.0)


def towards_the_tip() -> list[Row]:
    """Only the cells at the tip become smaller; without lateral contraction."""
    limit, lips, gradings = crack_limit(0.0)[0], 14, (2.0, 32.0)
    dofs_and_omegas = [cracked_modes(graded(0.1, lips, grading), 0.0) for grading in gradings]
    sizes = [smallest_cell(lips, grading) for grading in gradings]
    errors = [omega[0] / limit - 1.0 for _, omega in dofs_and_omegas]
    order, dofs = log_slope(sizes, errors), dofs_and_omegas[1][0] / dofs_and_omegas[0][0]
    name = "the same, times the dofs; reference: equal cells"
    return [
        Row("nu = 0: order of frequency 1 in the smallest cell", order, 1.0, 0.1, absolute=True),
        Row(name, dofs, (sizes[0] / sizes[1]) ** 2, None),
    ]


def draw_crack_order(axes: Any) -> None:
    """Errors of the first frequency over the dofs."""
    limit = crack_limit()[0]
    for order, cells in UNIFORM.items():
        dofs_and_omegas = [cracked_modes(grid(count, order)) for count in cells]
        errors = [omega[0] / limit - 1.0 for _, omega in dofs_and_omegas]
        name = f"equal cells, order {order}: h^{log_slope(1.0 / np.array(cells), errors):.2f}"
        axes.loglog([dofs for dofs, _ in dofs_and_omegas], errors, "o-", label=name)
    dofs_and_omegas = [cracked_modes(mesh) for mesh in GRADED]
    errors = [omega[0] / limit - 1.0 for _, omega in dofs_and_omegas]
    axes.loglog([dofs for dofs, _ in dofs_and_omegas], errors, "s-", label="graded, order 2")
    axes.set(xlabel="dofs", ylabel="relative error of the first frequency")
    axes.legend(fontsize="small")


@case(draw=draw_crack_order)
def frequencies_with_a_crack() -> list[Row]:
    """Natural frequencies with a crack: order, and what grading recovers.

    A unit square (E = 1, nu = 0.3, density 1), clamped below, with an open crack from its left side
    to its middle. Stresses at the tip grow like r^(-1/2), so the error of a frequency falls like h,
    whatever the order of the elements.

    Reference: that order (Strang and Fix, An Analysis of the Finite Element Method, chapter 8),
    fitted over 16, 32, 64 cells a side (four nodes) and 8, 16, 32 (nine nodes). A graded mesh of
    8000 dofs has a quarter of the error of 32 x 32 equal cells and less. Only the cells at the tip
    matter: the order is found in their size alone (last rows, nu = 0).
    """
    rows = []
    for order, cells in UNIFORM.items():
        values = np.array([cracked_modes(grid(count, order))[1] for count in cells])
        for mode in (0, 1):
            name = f"order of frequency {mode + 1}, equal cells with {(order + 1) ** 2} nodes"
            rows += [Row(name, fitted_order(values[:, mode]), 1.0, 0.1, absolute=True)]
    limit = crack_limit()
    omega = cracked_modes(GRADED[-1])[1]
    for mode in (0, 1):
        rows += [Row(f"frequency {mode + 1}, graded mesh", omega[mode], limit[mode], 2e-3)]
    coarse_omegas = cracked_modes(grid(32, 2))[1]
    for mode in (0, 1):
        share = (omega[mode] - limit[mode]) / (coarse_omegas[mode] - limit[mode])
        name = f"frequency {mode + 1}: error of the graded mesh over that of 32 x 32 equal cells"
        rows += [Row(name, share, 0.0, 0.3, absolute=True)]
    return rows + towards_the_tip()


COLUMNS = (10, 20, 40)
GROWTH = np.pi * (0.4**2 - 0.2**2)


@cache
def releases() -> list[float]:
    """C(0.4) - C(0.2) of the strip with an edge crack of so many W, by the grid's columns."""

    def compliance(columns: int, length: float) -> float:
        crack = {"edge": "left", "height": 2.0, "length": length}
        mesh = {"layout": "grid", "columns": columns, "rows": 4 * columns, "order": 2}
        return pull(cracked_plate(1.0, 4.0, [crack], mesh))

    return [compliance(columns, 0.4) - compliance(columns, 0.2) for columns in COLUMNS]


def mean_tada() -> float:
    """Root of the mean of F^2 over the growth, weighted by a: Tada's."""
    theory = quad(lambda a: 2.0 * np.pi * a * tada("edge", a) ** 2, 0.2, 0.4)[0]
    return float(np.sqrt(theory / GROWTH))


def release_convergence() -> fc.GridConvergence:
    """Of these, over the size of the cells."""
    return fc.grid_convergence([1.0 / columns for columns in COLUMNS], releases(), formal=1.0)


def draw_release(axes: Any) -> None:
    """F over the size of the cells."""
    sizes, values = 1.0 / np.array(COLUMNS), np.array(releases())
    limit = np.sqrt(release_convergence().extrapolated / GROWTH)
    axes.plot(sizes, np.sqrt(values / GROWTH), "o", label="fenics_crack")
    axes.plot([0.0, sizes[-1]], [limit, np.sqrt(values[-1] / GROWTH)], "C0--", lw=1)
    axes.plot([0.0], [limit], "C0s", label="extrapolated")
    axes.axhspan(0.995 * mean_tada(), 1.005 * mean_tada(), color="0.9", label="Tada, 0.5 %")
    axes.axhline(mean_tada(), color="k", ls=":", lw=1)
    label(axes, xlabel="size of the cells / W", ylabel="F", xlim=(-0.003, 0.105))


@case(draw=draw_release)
def energy_release_on_three_meshes() -> list[Row]:
    """Energy release on three meshes.

    A strip of W x 4 W in tension (E = 1, plane stress) whose edge crack grows from 0.2 W to 0.4 W,
    on 10, 20 and 40 nine-node quadrilaterals across. F is the mean of K_I / (s sqrt(pi a)): C(0.4)
    - C(0.2) = 2 pi F^2 times the integral of a, with C = f . u and G = K_I^2 / E = dC/da / 2.

    Reference: order 1, because of stresses like r^(-1/2), and Tada's formula for F (0.5 %). The
    last row is the grid convergence index of the finest mesh (Roache, J. Fluids Eng. 116, 1994,
    405-413; `fc.grid_convergence`); that of F is half of that of F^2.
    """
    values = np.array(releases())
    convergence = release_convergence()
    limit, reference = convergence.extrapolated, mean_tada()
    rows = [
        Row(f"F, {columns} cells across", float(np.sqrt(value / GROWTH)), reference, tolerance)
        for columns, value, tolerance in zip(COLUMNS, values, (None, None, 0.01), strict=True)
    ]
    return [
        *rows,
        Row("order of the energy", convergence.order, 1.0, 0.1, absolute=True),
        Row("F, extrapolated", float(np.sqrt(limit / GROWTH)), reference, 0.005),
        Row(
            "grid convergence index of F, 40 cells", 0.5 * convergence.gci, 0.0, 0.02, absolute=True
        ),
    ]
