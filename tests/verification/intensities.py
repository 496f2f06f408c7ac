"""Cracks in solids."""

import math
from collections.abc import Callable
from functools import cache
from itertools import combinations, pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import gmsh
import numpy as np
from book import Row, case, label
from fatigue.test_ellipse import CASES, brute_force, law, table_of
from fronts import furthest
from helpers import gmsh_model
from mpi4py import MPI
from petsc4py import PETSc
from scipy import sparse
from scipy.sparse.linalg import spsolve
from study.test_fronts import STRESS, YOUNG, solid

import fenics_crack as fc
from fenics_crack.fatigue import growth
from fenics_crack.fatigue.ellipse import EllipseSizePath, integrate_ellipse_growth
from fenics_crack.fem.front_intensities import TETRAHEDRON_EDGES, front_functionals
from fenics_crack.study.prepare import prepare

PENNY, BLOCK = 0.01, 0.1
"""Radius of the crack and edge of the block around it [m]."""
LONG, DEEP, SIDE = 0.025, 0.006, 0.15
"""Half axes of the ellipse and edge of the block around it [m]."""
RADIUS, LIGAMENT, HALF = 0.01, 0.006, 0.015
"""Of the bar in torsion, and half of its length [m]."""


def meshed(
    make: Callable[[Any], tuple[list[Any], list[Any]]],
    front: np.ndarray, sizes: np.ndarray, coarser: float, largest: float,
) -> tuple[fc.Scene, fc.Structure]:  # fmt: skip
    """A solid cut by faces, by way of a mesh file: clamped below, the crack in y = 0; elements are
    so long at points of the front, and longer away from it."""

    def size(_dimension: int, _tag: int, *place: float) -> float:
        aways = np.linalg.norm(front - place[:3], axis=1)
        nearest_size, distance = sizes[aways.argmin()], aways.min()
        return float(min(nearest_size + coarser * max(distance - 1.5 * nearest_size, 0.0), largest))

    with TemporaryDirectory() as folder:
        path = str(Path(folder) / "solid.msh")
        with gmsh_model() as model:
            body, face = make(model.occ)
            face = model.occ.intersect(face, body, removeTool=False)[0]
            model.occ.fragment(body, face)
            model.occ.synchronize()
            ends = {tag: np.array(model.getBoundingBox(2, tag)) for _, tag in model.getEntities(2)}
            lower_y = min(box[1] for box in ends.values())
            lower_tags = [tag for tag, box in ends.items() if box[4] < 0.9 * lower_y]
            height_tolerance = 1e-3 * abs(lower_y)
            crack = [
                tag for tag, box in ends.items() if np.abs(box[[1, 4]]).max() < height_tolerance
            ]
            model.setPhysicalName(3, model.addPhysicalGroup(3, [1]), "solid")
            for tags, name in ((lower_tags, "clamp"), (crack, "crack")):
                model.setPhysicalName(2, model.addPhysicalGroup(2, tags), name)
            for key in ("FromPoints", "ExtendFromBoundary", "FromCurvature"):
                gmsh.option.setNumber(f"Mesh.MeshSize{key}", 0)
            model.mesh.setSizeCallback(size)
            model.mesh.generate(3)
            gmsh.write(path)
        changes = {"mesh.layout": "file", "mesh.file": path, "crack": None, "sweep": None}
        changes |= {"mesh.size": None, "mesh.lip_elements": None, "geometry.width": None}
        changes |= {"geometry.height": None, "geometry.thickness": None}
        changes |= {"excitation.point": (0.0, round(-lower_y, 6), 0.0)}
        scene = solid().replace(changes)
        return scene, prepare(scene, MPI.COMM_SELF, whole=True).structure


def displaced(structure: fc.Structure, load: np.ndarray, held: np.ndarray) -> np.ndarray:
    """Displacement under forces, where dofs (n_nodes, 3) are held."""
    dofs = structure.nodes.dofs[held]
    matrix = structure.stiffness.copy()
    diagonal = matrix.getDiagonal()
    diagonal.array[dofs[dofs >= 0]] += 1e3 * YOUNG
    matrix.setDiagonal(diagonal)
    solver, (vector, forces) = PETSc.KSP().create(), matrix.createVecs()
    solver.setOperators(matrix)
    solver.setType("preonly")
    solver.getPC().setType("cholesky")
    solver.getPC().setFactorSolverType("mumps")
    forces.array[:] = load
    solver.solve(forces, vector)
    return np.array(vector.array_r)


def pressed_open(
    long: float, deep: float, side: float, element: float, bent: float, corner: bool = False
) -> tuple[np.ndarray, np.ndarray, int]:
    """Angles of the stations; K_I, K_II, K_III (n, 3) of an ellipse in the middle of a block whose
    crack has a pressure of 1 MPa on its faces, or of a quarter of both, with planes of symmetry at
    x = 0 and z = 0; and the number of dofs. Elements at the front are no longer than a part of its
    radius of curvature."""

    def make(occ: Any) -> tuple[list[Any], list[Any]]:
        start = 0.0 if corner else -0.5 * side
        box = [
            (3, occ.addBox(start, -0.5 * side, start, 0.5 * side - start, side, 0.5 * side - start))
        ]
        face = [(2, occ.addDisk(0.0, 0.0, 0.0, long, deep))]
        occ.rotate(face, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.5 * math.pi)
        return box, face

    t = np.linspace(0.0, 2.0 * np.pi, 400)
    front = np.column_stack([long * np.cos(t), 0.0 * t, deep * np.sin(t)])
    radius = ((long * np.sin(t)) ** 2 + (deep * np.cos(t)) ** 2) ** 1.5 / (long * deep)
    scene, structure = meshed(make, front, np.minimum(element, bent * radius), 0.5, side / 4.0)
    stations, rows, of_forces = front_functionals(scene, structure)
    forces = STRESS * structure.pair_areas
    clamped_axes = (np.abs(structure.nodes.points) < 1e-9) & [corner, False, corner]
    values = (
        rows @ displaced(structure, -(structure.gap @ forces), clamped_axes) + of_forces @ forces
    )
    x, _, z = np.array([station.point for station in stations]).T
    return np.arctan2(z / deep, x / long), values.reshape(-1, 3), structure.n_dofs


def root_mean_square(found: np.ndarray) -> float:
    """Of values."""
    return float(np.sqrt(np.mean(found**2)))


def in_all(name: str, found: np.ndarray, each: float, both: float) -> list[Row]:
    """Rows of values (n,) over a reference: furthest off, and their root mean square."""
    return [
        Row(f"{name}, at the station where it is furthest off", furthest(found), 1.0, each),
        Row(f"{name}, root mean square", root_mean_square(found), 1.0, both),
    ]


def draw_modes(axes: Any, angles: np.ndarray, found: np.ndarray) -> None:
    """K_I, K_II, K_III (n, 3) at angles."""
    for name, mark, row in zip(("K_I", "K_II", "K_III"), "o+x", found.T, strict=True):
        axes.plot(np.degrees(angles), row, mark, label=name)


@cache
def penny() -> tuple[np.ndarray, np.ndarray]:
    """Angles, and K relative to 2 s sqrt(a / pi)."""
    angles, intensities, _ = pressed_open(PENNY, PENNY * (1.0 - 1e-9), BLOCK, 1e-3, 0.1)
    return angles, intensities / (2.0 * STRESS * np.sqrt(PENNY / np.pi))


def draw_penny(axes: Any) -> None:
    """K over the angle."""
    draw_modes(axes, *penny())
    axes.axhline(1.0, color="k", ls=":", lw=1, label="Sneddon, K_I")
    axes.set(xlabel="angle [degrees]", ylabel="K / (2 s sqrt(a / pi))", ylim=(-0.1, 1.2))
    axes.legend(loc="center right")


@case(draw=draw_penny)
def penny_in_a_block() -> list[Row]:
    """Penny-shaped crack under pressure.

    A circular crack, a = 10 mm, in the middle of a block of 100 mm, nu = 0.3, its faces pressed
    apart by s = 1 MPa. `stress_intensity` of a static solution; K at a station is the mean over a
    hat that is 0 from its neighbours on.

    Reference: K_I = 2 s sqrt(a / pi), of a body without end (Sneddon, Proceedings of the Royal
    Society A 187, 1946, 229-260); K_II = K_III = 0.
    """
    ratios = penny()[1]
    rows = in_all("K_I / (2 s sqrt(a / pi))", ratios[:, 0], 0.015, 0.01)
    other_modes = float(np.abs(ratios[:, 1:]).max())
    return [*rows, Row("largest of K_II and K_III, as K_I", other_modes, 0.0, 0.01, absolute=True)]


def green(t: np.ndarray) -> np.ndarray:
    """K_I of an ellipse under 1 MPa at its angle (SSLV110) [Pa m^(1/2)]."""
    angle_factor = np.sin(t) ** 2 + (DEEP / LONG * np.cos(t)) ** 2
    return np.asarray(4.068e6 * np.sqrt(1e-3) * angle_factor**0.25)


@cache
def ellipse() -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Angles of the stations, K (n, 3) there, means of the closed form over their hats, which reach
    7.5 degrees to both sides, and dofs."""
    angles, intensities, count = pressed_open(LONG, DEEP, SIDE, 1e-3, 0.04, corner=True)
    t = np.linspace(0.0, 0.5 * np.pi, 4001)
    hats = np.maximum(0.0, 1.0 - np.abs(t - angles[:, None]) / (np.pi / 24.0))
    hats *= np.hypot(LONG * np.sin(t), DEEP * np.cos(t))
    means = hats @ green(t) / hats.sum(axis=1)
    means[0], means[-1] = 1.5 * means[[0, -1]] - 0.5 * means[[1, -2]]
    return angles, intensities, means, count


def draw_ellipse(axes: Any) -> None:
    """K over the angle."""
    angles, intensities, _, _ = ellipse()
    t = np.linspace(0.0, 0.5 * np.pi, 200)
    axes.plot(np.degrees(t), green(t) / 1e3, "k:", lw=1, label="closed form, K_I")
    draw_modes(axes, angles, intensities / 1e3)
    label(axes, xlabel="angle of the ellipse [degrees]", ylabel="K [kPa m$^{1/2}$]")


@case(draw=draw_ellipse)
def ellipse_in_a_block() -> list[Row]:
    """Elliptical crack in a block (code_aster's SSLV110).

    An elliptical crack, half axes a = 25 mm and b = 6 mm, in the middle of a block of 150 mm, nu =
    0.3, its faces pressed apart by 1 MPa. A quarter is meshed. At the angle t of the ellipse, in
    MPa and mm,

        K_I = 4.0680 (sin(t)^2 + (b / a)^2 cos(t)^2)^(1/4).

    Reference: this closed form of a body without end (Kassir and Sih, Journal of Applied Mechanics
    33, 1966, 601-611, with the benchmark's figures), as its mean over each station's hat of 7.5
    degrees to both sides. At the ends both take the straight line through the last two hats; 2.5 %
    are allowed there, 2 % elsewhere.
    """
    angles, intensities, means, count = ellipse()
    rows = []
    for angle, value, mean in zip(np.degrees(angles), intensities[:, 0], means, strict=True):
        tolerance = 0.02 if 1.0 < angle < 89.0 else 0.025
        name = f"K_I at {round(angle, 1) + 0.0:g} degrees [kPa m^0.5]"
        rows.append(Row(name, value / 1e3, mean / 1e3, tolerance))
    other_modes = float(np.abs(intensities[:, 1:]).max() / means.max())
    return [
        *rows,
        Row(
            "root mean square of K_I over its reference",
            root_mean_square(intensities[:, 0] / means),
            1.0,
            0.01,
        ),
        Row(
            "largest of K_II and K_III over the largest K_I", other_modes, 0.0, 0.02, absolute=True
        ),
        Row("dofs above 45,000", max(0, count - 45_000), 0.0, 0.0, absolute=True),
    ]


def line(x: np.ndarray, power: int) -> tuple[sparse.csr_matrix, sparse.csr_matrix]:
    """Integrals of N_i N_j x^power and N_i' N_j' x^power of quadratic elements between points."""
    mass, stiffness = np.zeros((2, 2 * len(x) - 1, 2 * len(x) - 1))
    q, w = np.polynomial.legendre.leggauss(5)
    q, w = 0.5 * (1.0 + q), 0.5 * w
    shape = np.array([(1.0 - q) * (1.0 - 2.0 * q), 4.0 * q * (1.0 - q), q * (2.0 * q - 1.0)])
    slope = np.array([4.0 * q - 3.0, 4.0 - 8.0 * q, 4.0 * q - 1.0])
    for number, (a, b) in enumerate(pairwise(x)):
        element_dofs, weights = slice(2 * number, 2 * number + 3), w * (a + (b - a) * q) ** power
        mass[element_dofs, element_dofs] += (b - a) * (shape * weights) @ shape.T
        stiffness[element_dofs, element_dofs] += (slope * weights) @ slope.T / (b - a)
    return sparse.csr_matrix(mass), sparse.csr_matrix(stiffness)


@cache
def ring(radius: float, ligament: float, half: float, count: int = 18) -> float:
    """K_III over the torque of a bar with a crack from its surface to a ligament: by what its
    compliance changes with the ligament. The angle phi(r, z) minimises int r^3 |grad phi|^2."""

    def torque(c: float) -> float:
        parts = np.append(0.55 ** np.arange(count), 0.0)
        r = np.append(c * (1.0 - parts), (c + (radius - c) * parts[::-1])[1:])
        (m_r, s_r), (m_z, s_z) = line(r, 3), line(half * parts[::-1], 0)
        matrix = (sparse.kron(s_r, m_z) + sparse.kron(m_r, s_z)).tocsr()
        places = np.arange(matrix.shape[0]).reshape(m_r.shape[0], -1)
        angle = np.zeros(matrix.shape[0])
        angle[places[:, -1]] = 1.0
        fixed_places = np.append(places[:, -1], places[: 2 * count + 1, 0])
        free_places = np.setdiff1d(places, fixed_places)
        angle[free_places] = spsolve(
            matrix[free_places][:, free_places].tocsc(), -(matrix[free_places] @ angle)
        )
        return float(2.0 * np.pi * angle @ (matrix @ angle))

    step = 1e-3 * ligament
    rise = (1.0 / torque(ligament - step) - 1.0 / torque(ligament + step)) / step
    return float(np.sqrt(rise / (2.0 * np.pi * ligament)))


@cache
def torsion(element: float = 1.2e-4) -> tuple[np.ndarray, np.ndarray, int]:
    """Angles, K over K_III of the axisymmetric bar with the torque of the mesh, and dofs: of a
    quarter of the bar, whose planes hold all but what is normal to them."""

    def make(occ: Any) -> tuple[list[Any], list[Any]]:
        bar = [(3, occ.addCylinder(0, -HALF, 0, 0, 2 * HALF, 0, RADIUS, angle=0.5 * math.pi))]
        disks = [[(2, occ.addDisk(0.0, 0.0, 0.0, r, r))] for r in (RADIUS, LIGAMENT)]
        face = occ.cut(*disks)[0]
        occ.rotate(face, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.5 * math.pi)
        return bar, face

    t = np.linspace(0.0, 0.5 * np.pi, 400)
    front = LIGAMENT * np.column_stack([np.cos(t), 0.0 * t, np.sin(t)])
    scene, structure = meshed(make, front, np.full(400, element), 0.6, RADIUS / 3.0)
    points, cells = structure.nodes.points, structure.nodes.cells
    load = np.zeros_like(points)
    for corners in combinations(range(4), 3):
        for cell in cells[np.all(points[cells[:, corners], 1] > HALF - 1e-9, axis=1)]:
            a, b, c = points[cell[list(corners)]]
            area = 0.5 * np.linalg.norm(np.cross(b - a, c - a))
            for edge in combinations(corners, 2):
                node = cell[4 + TETRAHEDRON_EDGES.index(edge)]
                load[node] += area / 3.0 * np.cross([0.0, 1.0, 0.0], points[node])
    torque = 4.0 * np.cross(points, load)[:, 1].sum()
    on_plane = np.abs(points) < 1e-9
    clamped_axes = np.column_stack(
        [on_plane[:, 2], on_plane[:, 0] | on_plane[:, 2], on_plane[:, 0]]
    )
    displacement = displaced(
        structure,
        structure.nodes.dolfinx_mesh_and_dofs.restrict_to_free(load.ravel()),
        clamped_axes,
    )
    stations, rows, _ = front_functionals(scene, structure)
    intensities = (rows @ displacement).reshape(-1, 3) / (torque * ring(RADIUS, LIGAMENT, HALF))
    x, _, z = np.array([station.point for station in stations]).T
    intensities[:, 2] *= np.sign(intensities[:, 2].sum())
    return np.arctan2(z, x), intensities, structure.n_dofs


def draw_torsion(axes: Any) -> None:
    """K over the angle."""
    draw_modes(axes, *torsion()[:2])
    axes.axhline(1.0, color="k", ls=":", lw=1, label="axisymmetric, K_III")
    axes.set(xlabel="angle [degrees]", ylabel="K over K_III of the axisymmetric bar")
    axes.set(ylim=(-0.1, 1.2))
    axes.legend(loc="center right")


@case(draw=draw_torsion)
def torsion_of_a_cracked_bar() -> list[Row]:
    """Torsion of a bar with a crack around it.

    A bar of 10 mm radius, cracked from its surface to a ligament of 6 mm radius, is twisted at its
    ends, 15 mm away. A quarter is meshed; K is relative to the torque of the mesh.

    Reference: K_III of the axisymmetric problem, solved here by quadratic elements: with u_theta =
    r phi(r, z) the angle phi minimises int r^3 |grad phi|^2, and with the twist phi_0, the torque T
    and the radius c of the ligament,

        K_III^2 = -mu T^2 / (2 pi c) d(phi_0 / T) / dc,         K_I = K_II = 0.

    The handbooks' polynomials are up to 1.8 % too large.
    """
    _, intensities, count = torsion()
    other_modes = float(np.abs(intensities[:, :2]).max())
    return [
        *in_all("K_III over the axisymmetric one", intensities[:, 2], 0.025, 0.015),
        Row("largest of K_I and K_II over K_III", other_modes, 0.0, 0.025, absolute=True),
        Row("dofs above 60,000", max(0, count - 60_000), 0.0, 0.0, absolute=True),
    ]


COARSE = (1.2e-3, 6e-4, 3e-4)
"""Elements at the front of the bar [m]."""


def draw_coarse(axes: Any) -> None:
    """Error over the size of elements."""
    errors = [1.0 - root_mean_square(torsion(element)[1][:, 2]) for element in COARSE]
    sizes = np.array(COARSE) * 1e3
    axes.loglog(sizes, errors, "o-", label="torsion, K_III")
    axes.loglog(sizes, errors[0] * sizes / sizes[0], "k:", lw=1, label="order 1")
    label(axes, xlabel="elements at the front [mm]", ylabel="error of K_III, root mean square")


@case(draw=draw_coarse)
def fronts_on_coarse_meshes() -> list[Row]:
    """Stress intensity along fronts on coarse meshes.

    The bar in [torsion](torsion_of_a_cracked_bar.md) and [the penny](penny_in_a_block.md), with
    elements up to ten times larger: 6,000 to 11,000 dofs. References as there; ratios are root mean
    squares over the stations. The error of K_III is of about first order.
    """
    errors = [1.0 - root_mean_square(torsion(element)[1][:, 2]) for element in COARSE[:2]]
    K_I = pressed_open(PENNY, PENNY * (1.0 - 1e-9), BLOCK, 2e-3, 0.4, corner=True)[1][:, 0]
    rows = [
        Row(
            f"torsion, elements of {name} mm: K_III over its reference", 1.0 - error, 1.0, tolerance
        )
        for name, error, tolerance in zip(("1.2", "0.6"), errors, (0.08, 0.05), strict=True)
    ]
    circular = root_mean_square(K_I) / (2.0 * STRESS * np.sqrt(PENNY / np.pi))
    return [
        *rows,
        Row("order of its error", math.log2(errors[0] / errors[1]), 1.0, 0.3),
        Row("penny, elements of 2 mm: K_I over its reference", circular, 1.0, 0.02),
    ]


@cache
def lives() -> tuple[list[EllipseSizePath], list[np.ndarray], list[float]]:
    """Of all cases the path by as many shapes as the program solves; depth, length and cycles
    without a table; and cycles by 8 x 8 shapes."""
    paths, exact, fine_cycles = [], [], []
    for start, end_depth, stress, exponent in CASES:
        table, fine_table = (
            table_of(count, start, end_depth, stress)
            for count in (growth.N_ELLIPSE_SIZES_PER_AXIS, 8)
        )
        paths.append(integrate_ellipse_growth(table, law(exponent), 2))
        exact.append(brute_force(start, end_depth, stress, exponent))
        fine_cycles.append(float(integrate_ellipse_growth(fine_table, law(exponent), 2).cycles[-1]))
    return paths, exact, fine_cycles


def draw_lives(axes: Any) -> None:
    """Depth over length of the cases that begin with the same depth."""
    paths, exact, _ = lives()
    for number in range(5, 10):
        tension, bending = CASES[number][2]
        name = f"tension {tension:g}, bending {bending:g}"
        [drawn_line] = axes.plot(
            paths[number].length_along_face * 1e3, paths[number].depth * 1e3, label=name
        )
        axes.plot(exact[number][1] * 1e3, exact[number][0] * 1e3, "x", color=drawn_line.get_color())
    axes.set(xlabel="length on the face [mm]", ylabel="depth [mm]", ylim=(0.0, None))
    axes.legend(title="x: ends without a table", fontsize=8)


@case(draw=draw_lives)
def growth_of_half_ellipses() -> list[Row]:
    """Growth of half-ellipses: cycles.

    A half-ellipse, depth a and length 2 c, in the face of a plate of 30 x 6 mm grows by the law of
    Paris with the stress intensities of Newman and Raju (Engineering Fracture Mechanics 15, 1981,
    185-192; NASA TM-83200) for tension and bending [100 MPa],

        da/dN = C K(90 degrees)^m,        dc/dN = C K(0)^m,        C = 1e-11, K in MPa m^(1/2),

    with K at least 0. The program interpolates K / sqrt(a) between 5 x 5 shapes, whose K are of the
    formula here. Growth ends at a depth, or where the crack is as long as 0.9 of the width.

    Reference: the same equations without a table, by SciPy's LSODA to 1e-9. 8 x 8 shapes (last
    rows) are no better where the deepest place comes to rest, as K has a kink there.
    """
    paths, exact, fine_cycles = lives()
    rows = []
    for (start, end_depth, stress, exponent), path, exact_path in zip(
        CASES, paths, exact, strict=True
    ):
        name = f"tension {stress[0]:g}, bending {stress[1]:g}, m = {exponent:g}, first 2 c ="
        name += f" {start[1] / start[0]:.3g} a: a {start[0] * 1e3:.3g} to {end_depth * 1e3:.3g} mm"
        rows.append(Row(name, float(path.cycles[-1]), float(exact_path[2]), 0.015))
    default_lives, fine_lives = (
        np.array(x) for x in ([path.cycles[-1] for path in paths], fine_cycles)
    )
    return [
        *(row for load in range(5) for row in rows[load::5]),
        Row("cycles by 8 x 8 shapes over these, furthest off",
            furthest(fine_lives / [exact_path[2] for exact_path in exact]), 1.0, None),
        Row("cycles by 5 x 5 over those by 8 x 8 shapes, furthest off",
            furthest(default_lives / fine_lives), 1.0, None),
    ]  # fmt: skip
