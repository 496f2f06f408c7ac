"""Plates and cracks."""

from functools import cache
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gmsh
import numpy as np
import scipy.sparse as sparse
import scipy.sparse.linalg
from book import Row, case
from helpers import DEMOS, gmsh_model
from matplotlib.collections import PolyCollection

import fenics_crack as fc


def cracked_plate(
    width: float, height: float, cracks: list[dict[str, Any]], mesh: dict[str, Any], **changes: Any
) -> fc.Scene:
    """A plate clamped at its lower edge and pulled at the upper, as a scene; some keys changed."""
    tables: dict[str, Any] = {
        "geometry": {"width": width, "height": height, "thickness": 1.0},
        "material": {"young": 1.0, "poisson": 0.3, "density": 1.0},
        "damping": {"ratio": 0.01},
        "excitation": {"omega": 1.0, "point": [width, height], "force_sin": [1.0, 0.0]},
        "mesh": mesh,
    }
    tables["loads"] = [{"edge": "top", "traction_mean": [0.0, 1.0]}]
    if cracks:
        tables |= {"crack": cracks[0], "cracks": cracks[1:], "contact": {"stiffness": 1.0}}
    return fc.Scene.from_mapping(tables).replace(changes)


# --- published frequencies ------------------------------------------------------------------------


def draw_shapes(axes: Any, structure: fc.Structure, names: list[str], columns: int) -> None:
    """The first modes of a plate, side by side."""
    nodes = structure.nodes
    shapes = fc.solve_modes(structure, len(names)).shapes
    is_free, size = nodes.dofs >= 0, np.ptp(nodes.points, axis=0)
    for mode, name in enumerate(names):
        motion = np.zeros(nodes.points.shape)
        motion[is_free] = shapes[nodes.dofs[is_free], mode]
        place = np.array([mode % columns, -(mode // columns)]) * 1.3 * size
        moved_points = nodes.points + place + 0.15 * size.max() / np.abs(motion).max() * motion
        axes.add_collection(
            PolyCollection(
                moved_points[nodes.cells[:, :4]], facecolor="C0", edgecolor="w", linewidth=0.2
            )
        )
        label_point = nodes.points.min(axis=0) + place + size * [0.5, -0.05]
        axes.text(*label_point, name, ha="center", va="top", fontsize="small")
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.axis("off")


@cache
def tapered() -> fc.Structure:
    """The membrane on 32 x 16 nine-node quadrilaterals from a gmsh file."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "taper.msh"
        with gmsh_model() as model:
            _draw_taper(model)
            gmsh.write(str(path))
        scene = fc.Scene.from_mapping(
            {
                "geometry": {"thickness": 0.05},
                "material": {"young": 2e11, "poisson": 0.3, "density": 8000.0},
                "damping": {"ratio": 0.0},
                "excitation": {"omega": 1.0},
                "mesh": {"layout": "file", "file": str(path), "order": 2},
            }
        )
        return fc.build_structure(scene)


TARGET = (44.623, 130.03, 162.70, 246.05, 379.90, 391.44)


def draw_tapered(axes: Any) -> None:
    """Its six modes; clamped on the left."""
    draw_shapes(axes, tapered(), [f"{target:g} Hz" for target in TARGET], 3)


@case(draw=draw_tapered)
def tapered_membrane() -> list[Row]:
    """NAFEMS FV32: cantilevered tapered membrane.

    Plane stress; 10 m long, 5 m deep at the clamp and 1 m at the end, 0.05 m thick, E = 2e11 Pa, nu
    = 0.3, 8000 kg/m^3; 32 x 16 nine-node quadrilaterals from a gmsh file.

    Reference: NAFEMS, The Standard NAFEMS Benchmarks (1990), test FV32; and 64 x 32 nine-node
    quadrilaterals of another program.
    """
    finer_hertz = [44.617, 130.011, 162.689, 245.987, 379.719, 391.406]
    hertz = fc.solve_modes(tapered(), 6).omega / (2.0 * np.pi)
    rows = [Row(f"f{i + 1} [Hz], target", hertz[i], TARGET[i], 1e-3) for i in range(6)]
    return rows + [
        Row(f"f{i + 1} [Hz], finer mesh", hertz[i], finer_hertz[i], 1e-4) for i in range(6)
    ]


def _draw_taper(model: Any) -> None:
    geo = model.geo
    corners = [(0.0, -2.5), (10.0, -0.5), (10.0, 0.5), (0.0, 2.5)]
    points = [geo.addPoint(x, y, 0.0) for x, y in corners]
    lines = [geo.addLine(points[i], points[(i + 1) % 4]) for i in range(4)]
    for line, cells in zip(lines, (32, 16, 32, 16), strict=True):
        geo.mesh.setTransfiniteCurve(line, cells + 1)
    surface = geo.addPlaneSurface([geo.addCurveLoop(lines)])
    geo.mesh.setTransfiniteSurface(surface)
    geo.mesh.setRecombine(2, surface)
    geo.synchronize()
    for name, dimension, tag in (
        ("membrane", 2, surface), ("clamp", 1, lines[3]), ("load", 0, points[2])
    ):  # fmt: skip
        model.setPhysicalName(dimension, model.addPhysicalGroup(dimension, [tag]), name)
    model.mesh.generate(2)


@cache
def square() -> fc.Structure:
    """Unit square of 24 x 24 nine-node quadrilaterals."""
    mesh = {"layout": "grid", "columns": 24, "rows": 24, "order": 2}
    return fc.build_structure(cracked_plate(1.0, 1.0, [], mesh))


SQUARE = (0.65816, 1.57953, 1.77205)


def draw_square(axes: Any) -> None:
    """Its three modes; clamped below."""
    draw_shapes(axes, square(), [f"{value:g}" for value in SQUARE], 3)


@case(draw=draw_square)
def square_cantilever() -> list[Row]:
    """Square plate in its plane, clamped on one side.

    nu = 0.3, plane stress; w L sqrt(rho / E) of the first three modes. 24 x 24 nine-node
    quadrilaterals.

    Reference: published values of fine meshes, to five digits.
    """
    omegas = fc.solve_modes(square(), 3).omega
    return [Row(f"mode {i + 1}", omegas[i], SQUARE[i], 1e-3) for i in range(3)]


# --- stress intensity -----------------------------------------------------------------------------


def csr(matrix: Any) -> sparse.csr_matrix:
    """A sequential PETSc matrix for SciPy."""
    starts, columns, values = matrix.getValuesCSR()
    return sparse.csr_matrix((values, columns, starts), matrix.size)


def pull(scene: fc.Scene) -> float:
    """Work of a uniform traction of 1 on the upper edge: f . u, with an open crack."""
    structure = fc.build_structure(scene)
    force = structure.force[0]
    displacement = scipy.sparse.linalg.spsolve(
        csr(structure.stiffness).tocsc(), force, "MMD_AT_PLUS_A"
    )
    return float(force @ displacement)


@cache
def stress_intensity(kind: str, share: float, size: float) -> float:
    """K_I / sqrt(pi a) from the energy release rate; the crack, or half of it, over W is known.

    With the load fixed G = dC/dA / 2 with C = f . u; in plane stress K_I = sqrt(E G), E = t = 1.
    """
    height = 4.0
    a = share if kind == "edge" else 0.5 * share

    def compliance(a: float) -> float:
        cracks = {
            "edge": [{"edge": "left", "height": 2.0, "length": a}],
            "centre": [{"center": 0.5, "height": 2.0, "length": 2.0 * a}],
            "two edges": [{"edge": e, "height": 2.0, "length": a} for e in ("left", "right")],
        }[kind]
        mesh = {
            "layout": "graded", "size": size, "grading": 8.0, "order": 2,
            "lip_elements": round(1.6 / size),
        }  # fmt: skip
        return pull(cracked_plate(1.0, height, cracks, mesh))

    step, tips = 0.02 * a, 1 if kind == "edge" else 2
    release = (compliance(a + step) - compliance(a - step)) / (2.0 * step) / (2.0 * tips)
    return float(np.sqrt(release / (np.pi * a)))


def tada(kind: str, share: float) -> float:
    """K_I / (sigma sqrt(pi a)); share is a / W of an edge crack, else 2 a / W."""
    angle = np.pi * share / 2.0
    if kind == "centre":
        return float((1.0 - 0.025 * share**2 + 0.06 * share**4) / np.sqrt(np.cos(angle)))
    if kind == "two edges":
        return float((1.0 + 0.122 * np.cos(angle) ** 4) * np.sqrt(np.tan(angle) / angle))
    polynomial = 0.752 + 2.02 * share + 0.37 * (1.0 - np.sin(angle)) ** 3
    return float(np.sqrt(np.tan(angle) / angle) * polynomial / np.cos(angle))


STRIPS = [("edge", share) for share in (0.1, 0.2, 0.3, 0.5)]
STRIPS += list(product(("centre", "two edges"), (0.3, 0.5)))


def strip_factor(kind: str, share: float) -> float:
    """F of a strip on the meshes of the page."""
    return stress_intensity(kind, share, 0.12 if kind == "centre" else 0.2)


def draw_factors(axes: Any) -> None:
    """F over the crack's share of the width."""
    shares = np.linspace(0.01, 0.6, 60)
    for colour, kind in zip(("C0", "C1", "C2"), ("edge", "centre", "two edges"), strict=True):
        axes.plot(shares, [tada(kind, share) for share in shares], colour, label=f"{kind}, Tada")
        factors = [
            (share, strip_factor(kind, share)) for strip_kind, share in STRIPS if strip_kind == kind
        ]
        axes.plot(*np.transpose(factors), f"{colour}o", label=f"{kind}, fenics_crack")
    axes.set(xlabel="a / W of the edge crack, 2 a / W of the others", ylabel="F")
    axes.legend(fontsize="small")


@case(draw=draw_factors)
def stress_intensity_factors() -> list[Row]:
    """Stress intensity of cracks in tension.

    Strips of width W and height 4 W in tension with an edge crack, a crack in the centre and two
    edge cracks; F = K_I / (s sqrt(pi a)), from the energy release rate of cracks 4 % of a apart.

    Reference: Tada, Paris and Irwin, The Stress Analysis of Cracks Handbook (edge crack: as in
    Anderson, Fracture Mechanics, table 2.4), good to 0.5 %, 0.1 % and 0.5 %. The edge crack's plate
    is clamped below, 2 W from the crack.
    """
    return [
        Row(
            f"F, {kind}, {'a' if kind == 'edge' else '2 a'} / W = {share:g}",
            strip_factor(kind, share), tada(kind, share), 0.01,
        )
        for kind, share in STRIPS
    ]  # fmt: skip


# --- the paper's plate ----------------------------------------------------------------------------


@cache
def soft_plate() -> fc.Structure:
    """With 1 % of critical damping."""
    return fc.build_structure(
        fc.Scene.load(DEMOS / "paper_plate.toml").replace({"damping.ratio": 0.01})
    )


def draw_soft_contact(axes: Any) -> None:
    """The gap over two periods with 5 and 40 harmonics."""
    for harmonics in (5, 10, 40):
        solution = fc.solve_harmonic_balance(
            soft_plate(), 2000.0, fc.UnilateralPenalty(1e9), harmonics=harmonics
        )
        share = np.linspace(0.0, 2.0, 801)
        axes.plot(
            share, -1e6 * solution.gap(share * solution.period)[:, 0], label=f"H = {harmonics}"
        )
    axes.axhline(1.451955, color="k", ls=":", lw=1, label="largest, exact")
    axes.axhline(0.0, color="0.7", lw=1)
    axes.set(xlabel="t / period", ylabel="opening [µm]", xlim=(0.0, 2.0))
    axes.legend(fontsize="small")


@case(draw=draw_soft_contact)
def paper_plate_soft_contact() -> list[Row]:
    """The paper's plate, breathing.

    The plate of Kharyton and others (`demos/paper_plate.toml`) with k = 1e9 N/m, 1 % of critical
    damping in all 50 modes, at 2000 rad/s.

    Reference: event-driven integration of all modes by another program, beside
    `fc.integrate_events` from rest and harmonic balance.
    """
    structure, law = soft_plate(), fc.UnilateralPenalty(1e9)
    corner = structure.find_dof((0.1, 0.1), "x")
    march = fc.integrate_events(
        structure, 2000.0, law, periods=300, settle=1e-11, record_periods=1, steps_per_period=4096
    )
    solution = fc.solve_harmonic_balance(structure, 2000.0, law, harmonics=20)
    t = march.time
    pairs = (
        ("flow", march.gap[:, 0], march.displacement([corner])[:, 0], 1e-6),
        ("H = 20", solution.gap(t)[:, 0], solution.displacement(t, [corner])[:, 0], 2e-3),
    )
    rows = []
    for name, gap, motion, tolerance in pairs:
        (mean, *gaps), (rest, *moves) = (_spectrum(wave) for wave in (gap, motion))
        rows += [
            Row(f"{name}: mean of g [m]", mean, -4.317675e-7, tolerance),
            Row(f"{name}: abs(g1) [m]", gaps[0], 7.418206e-7, tolerance),
            Row(f"{name}: abs(g2) [m]", gaps[1], 2.357526e-7, tolerance),
            Row(f"{name}: abs(g3) [m]", gaps[2], 1.52476e-8, 10.0 * tolerance),
            Row(f"{name}: largest opening [m]", -gap.min(), 1.451955e-6, tolerance),
            Row(f"{name}: corner, mean of u [m]", rest, 1.860995e-7, tolerance),
            Row(f"{name}: corner, abs(u1) [m]", moves[0], 1.145796e-6, tolerance),
            Row(f"{name}: corner, abs(u2) [m]", moves[1], 1.775296e-7, tolerance),
            Row(f"{name}: corner, smallest u [m]", motion.min(), -1.152750e-6, tolerance),
            Row(f"{name}: corner, largest u [m]", motion.max(), 1.156557e-6, tolerance),
        ]
    rows += [Row("flow: largest penetration [m]", march.gap.max(), 1.06264e-7, 2e-3)]
    for harmonics, opening in ((5, 1.3898e-6), (10, 1.4347e-6), (20, 1.4515e-6), (40, 1.4519e-6)):
        found = fc.solve_harmonic_balance(structure, 2000.0, law, harmonics=harmonics)
        name = f"H = {harmonics}: largest opening, by another program [m]"
        rows += [Row(name, -found.gap(t).min(), opening, 1e-3)]
    return rows


def _spectrum(wave: np.ndarray) -> list[float]:
    values = np.fft.rfft(wave) / len(wave)
    return [float(values[0].real), *(2.0 * np.abs(values[1:4]))]
