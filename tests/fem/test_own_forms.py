"""Structures from UFL forms on a mesh of DOLFINx, and displacements as DOLFINx's Functions."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import dolfinx
import numpy as np
import pytest
import scipy.sparse as sparse
import ufl
from helpers import catch_error, oscillator
from mpi4py import MPI
from surroundings import DEMOS
from test_solids import of_file, write_box, write_hexahedra

import fenics_crack as fc
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.fem import compat
from fenics_crack.fem.loads import rigid_motion_displacements
from fenics_crack.fem.plate import MeshWithNamedParts, build_plate_or_solid_mesh
from fenics_crack.model.modes import multiply_columns

PLATE = fc.Scene.load(DEMOS / "paper_plate.toml").replace(
    {"mesh.columns": 8, "mesh.rows": 4, "contact.pairs": "all", "contact.stiffness": 1e9}
    | {"damping.ratio": 0.01, "geometry.thickness": 0.5}
)
SOLID: dict[str, Any] = {
    "geometry": {"kind": "solid", "width": 0.03, "height": 0.06, "thickness": 0.006},
    "crack": {"edge": "left", "height": 0.02, "length": 0.012},
    "material": {"young": 2.1e11, "poisson": 0.3, "density": 7850.0},
    "damping": {"ratio": 0.002},
    "excitation": {"point": [0.0, 0.06, 0.003], "force_cos": [0.0, 0.0, 1.0], "omega": 1e3},
    "contact": {"law": "penalty", "stiffness": 1e8},
    "mesh": {"layout": "graded", "order": 2, "size": 0.02, "lip_elements": 2},
}
INSIDE = {"edge": None, "center": 0.05, "length": 0.04}
GRADED = {"mesh.layout": "graded", "mesh.columns": None, "mesh.rows": None, "mesh.size": 0.03}
SCENES = {
    "a grid of order 1": PLATE,
    "two tips, triangles of order 2": PLATE.replace(
        {f"crack.{key}": value for key, value in INSIDE.items()}
        | GRADED
        | {"mesh.lip_elements": 6, "mesh.cells": "triangle", "mesh.order": 2}
    ),
    "an inclined crack in a file": fc.Scene.load(DEMOS / "inclined_crack.toml"),
    "tetrahedra": fc.Scene.from_mapping(SOLID),
}


def vectors(mesh: Any, order: int) -> Any:
    """The space as its user makes it."""
    if not hasattr(dolfinx.fem, "functionspace"):
        return dolfinx.fem.VectorFunctionSpace(mesh, ("Lagrange", order))
    return dolfinx.fem.functionspace(mesh, ("Lagrange", order, (mesh.geometry.dim,)))


def given(scene: fc.Scene, comm: MPI.Comm) -> tuple[list[Any], dict[str, Any], MeshWithNamedParts]:
    """Space and forms of a scene's material on a mesh of its own, and the other arguments."""
    plate, material, d = build_plate_or_solid_mesh(scene, comm), scene.material, scene.dimension
    space = vectors(plate.mesh, scene.mesh.order)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    t, nu = (scene.geometry.thickness if d == 2 else 1.0), material.poisson
    strain = ufl.sym(ufl.grad(u))
    stress = strain + nu / (1.0 - (d - 1) * nu) * ufl.tr(strain) * ufl.Identity(d)
    stiffness = t * material.young / (1.0 + nu) * ufl.inner(stress, ufl.sym(ufl.grad(v)))
    mass = t * material.density * ufl.inner(u, v) * ufl.dx
    nodes = dolfinx.fem.locate_dofs_topological(space, d - 1, plate.facets("clamp"))
    tags = (plate.tags_by_group[name][0] for name in ("lower_lip", "upper_lip"))
    options = {
        "bcs": [dolfinx.fem.dirichletbc(np.zeros(d), nodes, space)],
        "crack": (plate.facet_tags, *tags),
        "thickness": t,
        "damping": fc.ModalDamping(0.01),
    }
    return [space, stiffness * ufl.dx, mass], options, plate


def whole(matrix: Any, comm: MPI.Comm) -> sparse.csr_matrix:
    """All rows of PETSc's, or of those of a rank."""
    if not sparse.issparse(matrix):
        starts, columns, values = matrix.getValuesCSR()
        matrix = sparse.csr_matrix(
            (values, columns, starts), (matrix.local_size[0], matrix.size[1])
        )
    return sparse.vstack(comm.allgather(matrix)).tocsr()


def matched(structure: fc.Structure, comm: MPI.Comm) -> list[Any]:
    """M, K, B and B_t by place, node (that of a lower face first) and component."""
    nodes = structure.nodes
    points, dofs, cells = (gather_rows(comm, x) for x in (nodes.points, nodes.dofs, nodes.cells))
    cell = np.repeat(np.arange(len(cells)), cells.shape[1])
    cell_incidence = sparse.csr_matrix((np.ones(cells.size), (cells.ravel(), cell)))
    middle = cell_incidence @ points[cells].mean(axis=1) / cell_incidence.getnnz(axis=1)[:, None]
    rows = dofs[np.lexsort(np.column_stack([middle, points]).round(9).T)].ravel()
    rows = rows[rows >= 0]
    matrices = [whole(part, comm)[rows] for part in (structure.mass, structure.stiffness)]
    matrices = [part[:, rows] for part in matrices] + [whole(structure.gap, comm)[rows]]
    if structure.tangential is not None:
        matrices.append(whole(structure.tangential, comm)[rows])
    return matrices


def differences(text: str, comm: MPI.Comm) -> list[float]:
    """The largest of M, K, B and B_t, areas, positions and frequencies, relative to the largest
    entry."""
    scene = fc.Scene.from_text(text)
    forms, options, _ = given(scene, comm)
    pair = fc.build_structure(scene, comm), fc.structure_from_forms(*forms, **options)
    assert pair[0].watched_pairs == pair[1].watched_pairs
    values = [matched(s, comm) + [s.pair_areas, s.pairs.positions] for s in pair]
    omega = [fc.solve_modes(structure, 3).omega for structure in pair]
    matrix_pairs = [*zip(*values, strict=True), omega]
    return [
        float(abs(first_matrix - second_matrix).max() / abs(first_matrix).max())
        for first_matrix, second_matrix in matrix_pairs
    ]


NIGHTLY = [pytest.param(name, marks=pytest.mark.nightly) for name in [*SCENES][2:]]


@pytest.mark.mpi
@pytest.mark.parametrize("name", [*[*SCENES][:2], *NIGHTLY])
def test_the_structure_of_a_scene(name: str, on_ranks: Callable[..., Any]) -> None:
    """Of the same forms: M, K and B to 1e-12 of their largest entry, frequencies to 1e-10; on one
    rank and on two."""
    text = SCENES[name].as_toml()
    for *matrix_errors, of_omega in (differences(text, MPI.COMM_SELF), on_ranks(differences, text)):
        assert max(matrix_errors) < 1e-12 and of_omega < 1e-10


@pytest.mark.nightly
@pytest.mark.parametrize("write", [write_hexahedra, partial(write_box, order=2)])
def test_the_structure_of_a_mesh_of_gmsh(
    write: Callable[[Path], None], tmp_path: Path, on_ranks: Callable[..., Any]
) -> None:
    """Hexahedra, whose facets have four corners in turn; and tetrahedra with curved edges."""
    write(tmp_path / "box.msh")
    text = of_file(tmp_path / "box.msh").as_toml()
    for *matrix_errors, of_omega in (differences(text, MPI.COMM_SELF), on_ranks(differences, text)):
        assert max(matrix_errors) < 1e-12 and of_omega < 1e-10


def test_solids_of_order_1() -> None:
    """No scene has them: pairs have the areas of order 2, and no rigid motion opens one."""
    scene = SCENES["tetrahedra"]
    [space, *_], options, _ = given(scene, MPI.COMM_SELF)
    space = vectors(space.mesh, 1)
    u, v = ufl.TrialFunction(space), ufl.TestFunction(space)
    forms = ufl.inner(ufl.sym(ufl.grad(u)), ufl.sym(ufl.grad(v))) * ufl.dx, ufl.inner(u, v) * ufl.dx
    structure = fc.structure_from_forms(space, *forms, crack=options["crack"])
    two = fc.build_structure(scene)
    assert structure.pair_areas == pytest.approx(two.pair_areas, rel=1e-12)
    points, dofs = structure.nodes.points, structure.nodes.dofs
    for motion in rigid_motion_displacements(points)[:, np.argsort(dofs.ravel())]:
        assert abs(structure.apply_bt(motion[None])).max() < 1e-12


# --- loads, damping, Functions --------------------------------------------------------------------


def solved() -> tuple[list[Any], fc.PeriodicSolution]:
    """The plate under a traction at its top and a mean, with Rayleigh damping as a form."""
    forms, options, plate = given(PLATE, MPI.COMM_SELF)
    space, stiffness, mass = forms
    x, _ = ufl.TestFunction(space)
    top = plate.measure_on("top")
    loads = ufl.TestFunction(space)[1] * top, 2.0 * x * top, None
    options |= {"loads": loads, "damping": 20.0 * mass + 1e-6 * stiffness, "clearance": 1e-9}
    return forms, fc.solve_harmonic_balance(
        fc.structure_from_forms(*forms, **options), 2000.0, fc.UnilateralPenalty(1e9), harmonics=9
    )


def test_loads_and_damping_are_those_of_a_scene() -> None:
    """Mean, sine and a damping matrix; the whole solution."""
    table = {"damping.ratio": None, "damping.mass": 20.0, "damping.stiffness": 1e-6}
    lines = PLATE.replace(table).as_toml().splitlines()
    lines = [line for line in lines if not line.startswith(("point", "force_sin"))]
    edge = 'edge = "top"\ntraction_sin = [4.0, 0.0]\ntraction_mean = [0.0, 2.0]\n'
    scene = fc.Scene.from_text("\n".join([*lines, "[[loads]]", edge]))
    scene_structure = fc.build_structure(scene).varied(clearance=1e-9)
    solution = fc.solve_harmonic_balance(
        scene_structure, 2000.0, fc.UnilateralPenalty(1e9), harmonics=9
    )
    _, form_solution = solved()
    assert (
        abs(form_solution.structure.force - scene_structure.force).max()
        < 1e-12 * abs(scene_structure.force).max()
    )
    for name in ("displacement_coefficients", "gap_coefficients"):
        form_array, scene_array = getattr(form_solution, name), getattr(solution, name)
        assert abs(form_array - scene_array).max() < 1e-9 * abs(scene_array).max()


def of_function(solution: fc.PeriodicSolution) -> float:
    """The largest difference of a Function at this rank's nodes, relative to the displacement;
    clamped nodes rest."""
    structure, time = solution.structure.whole, 0.3 * solution.period
    exact_displacement = solution.displacement(np.array([time]), [*range(structure.n_dofs)])[0]
    dofs = structure.nodes.dofs.ravel()
    values = solution.function(time).x.array[: len(dofs)]
    exact_displacement = np.where(dofs >= 0, exact_displacement[dofs], 0.0)
    return float(abs(values - exact_displacement).max() / abs(exact_displacement).max())


@pytest.mark.parametrize("reduce", [None, "free_interface", "massless"])
def test_functions(reduce: str | None) -> None:
    """Displacements at an instant and mode shapes are Functions on the space, for further forms:
    its nodes have what the solution has there, and the clamp rests."""
    (space, _, mass), solution = solved()
    full_structure = solution.structure
    if reduce is not None:
        reduced_structure = fc.reduce_structure(full_structure, modes=6, method=reduce)
        law = fc.UnilateralPenalty(1e9)
        solution = fc.solve_harmonic_balance(reduced_structure, 2000.0, law, harmonics=9)
    assert solution.function(0.0).function_space == space
    assert of_function(solution) < 1e-12
    shape = fc.solve_modes(solution.structure, 2).function(1)
    form = dolfinx.fem.form(ufl.action(ufl.action(mass, shape), shape))
    assert dolfinx.fem.assemble_scalar(form) == pytest.approx(1.0, rel=1e-10)


def of_functions(comm: MPI.Comm) -> list[float]:
    """Kinetic energy over (velocity)^2 by a form, and by M, of a scene's solution (collective)."""
    structure = fc.build_structure(PLATE, comm)
    solution = fc.solve_harmonic_balance(structure, 2000.0, fc.UnilateralPenalty(1e9), harmonics=5)
    displacement = solution.function(1e-4)
    displacement_field = solution.displacement_field(np.array([1e-4]))[0]
    product = structure.sum_over_ranks(
        displacement_field @ multiply_columns(structure.mass, displacement_field[:, None])
    )[0]
    form = dolfinx.fem.form(0.5 * 7800.0 * ufl.inner(displacement, displacement) * ufl.dx)
    energy = comm.allreduce(dolfinx.fem.assemble_scalar(form))
    return [energy / product, *comm.allgather(of_function(solution))]


@pytest.mark.mpi
def test_functions_of_scenes(on_ranks: Callable[..., Any]) -> None:
    """Theirs are on the program's space; on two ranks too, ghosts as owners have them."""
    ratio, *differ = on_ranks(of_functions)
    assert ratio == pytest.approx(1.0, rel=1e-12) and max(differ) < 1e-12


@pytest.mark.parametrize("index", [2, -1, 0.0, None])
def test_modes_that_there_are_not(index: Any) -> None:
    catch_error(
        lambda: fc.solve_modes(fc.build_structure(PLATE), 2).function(index),
        "index",
        index,
        names="0 to 1",
    )


def test_a_free_plate_without_a_crack() -> None:
    """As little as can be given: no conditions, no load, no damping."""
    forms, _, _ = given(PLATE, MPI.COMM_SELF)
    structure = fc.structure_from_forms(*forms)
    assert structure.n_pairs == 0 and structure.tangential is None and not np.any(structure.force)
    omega = fc.solve_modes(structure, 4).omega
    assert np.all(omega[:3] < 1e-3 * omega[3])


def test_functions_need_a_mesh() -> None:
    solution = fc.solve_linear(oscillator(), 0.5)
    catch_error(lambda: solution.function(0.0), "structure")
    catch_error(lambda: solution.function("now"), "time", "now")


# --- what is refused ------------------------------------------------------------------------------


def test_refused() -> None:
    """Wrong spaces, conditions, forms and tags: one line each, with the argument's name."""
    (space, stiffness, mass), options, plate = given(PLATE, MPI.COMM_SELF)
    mesh, (tags, lower, _) = space.mesh, options["crack"]
    other_space, solid = vectors(mesh, 2), dolfinx.mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1)
    test_x, test = ufl.TestFunction(space)[0], ufl.TestFunction(other_space)
    x = test_x * ufl.dx
    nodes = dolfinx.fem.locate_dofs_topological(space, 1, plate.facets("clamp"))
    clamp_dofs = dolfinx.fem.locate_dofs_topological(other_space, 1, plate.facets("clamp"))
    all_dofs = np.arange(space.dofmap.index_map.size_local, dtype=np.int32)
    dirichlet, rest = dolfinx.fem.dirichletbc, np.zeros(2)
    facets = dolfinx.mesh.locate_entities(
        mesh, 1, lambda p: np.isclose(p[1], 0.05) & (p[0] > 0.0499)
    )  # fmt: skip
    marks = dolfinx.mesh.meshtags(mesh, 1, np.sort(facets), np.full(len(facets), 9, np.int32))
    points = dolfinx.mesh.meshtags(mesh, 0, np.arange(9, dtype=np.int32), np.ones(9, np.int32))
    elsewhere = given(PLATE, MPI.COMM_SELF)[1]["crack"]
    valid_forms = {"stiffness": stiffness, "mass": mass}
    cases: list[tuple[str, dict[str, Any], str | None]] = [
        ("space", {"space": 3}, "'int'.*Lagrange"),
        ("space", {"space": vectors(mesh, 3)}, "order 1 or 2"),
        ("space", {"space": compat.function_space(mesh, 1, vectors=False)}, "order 1 or 2"),
        ("space", {"space": space.sub(0)}, "order 1 or 2"),
        ("stiffness", {"space": vectors(solid, 1)}, "functions: 2, on this space: 0"),
        ("stiffness", {"stiffness": 1.0}, "= 'float'"),
        ("stiffness", {"stiffness": x}, "functions: 1, on this space: 1"),
        ("stiffness", {"stiffness": -1.0 * stiffness}, "negative eigenvalue"),
        ("mass", {"mass": ufl.inner(ufl.TrialFunction(other_space), test) * ufl.dx}, "space: 0"),
        ("mass", {"mass": mass + ufl.TrialFunction(space)[1] * test_x * ufl.dx}, "asymmetric"),
        ("mass", {"mass": 0.0 * mass}, "functions: 0, on this space: 0"),
        ("damping", {"damping": 0.1}, "= 'float'"),
        ("bcs", {"bcs": 3}, "'int'"),
        ("bcs", {"bcs": ["clamp"]}, "Dirichlet"),
        ("bcs", {"bcs": [dirichlet(rest, clamp_dofs, other_space)]}, None),
        ("bcs", {"bcs": [dirichlet(np.array([0.0, 1e-9]), nodes, space)]}, None),
        ("bcs", {"bcs": [dirichlet(np.array([0.0, np.nan]), nodes, space)]}, None),
        ("mass", {"bcs": [dirichlet(rest, all_dofs, space)]}, r"\(0, 0\)"),
        ("loads", {"loads": x}, "mean, sin, cos"),
        ("loads", {"loads": (x,)}, "mean, sin, cos"),
        ("loads.sin", {"loads": (None, mass, None)}, "functions: 2, on this space: 2"),
        ("crack", {"crack": 3}, "facet_tags, lower, upper"),
        ("crack", {"crack": (tags, lower, lower)}, "facet_tags, lower, upper"),
        ("crack", {"crack": (tags, lower, 4.5)}, "facet_tags, lower, upper"),
        ("crack", {"crack": (points, 1, 2)}, "facet_tags, lower, upper"),
        ("crack", {"crack": elsewhere}, "facet_tags, lower, upper"),
        ("crack", {"crack": (tags, lower, 99)}, "0 facets of tag 99"),
        (
            "crack",
            {"crack": (marks, 9, 8)},
            f"{len(facets)} facets of tag 9, {len(facets)} of them",
        ),
        (
            "crack",
            {"crack": (tags, lower, plate.tags_by_group["top"][0])},
            r"'\d lower and \d upper nodes'",
        ),
        ("thickness", {"thickness": 0.0}, "> 0"),
        ("clearance", {"clearance": [1.0]}, " 4 with"),
    ]
    for key, change, names in cases:
        arguments = {"space": space} | valid_forms | options | change
        three = [arguments.pop(name) for name in ("space", "stiffness", "mass")]
        call = partial(fc.structure_from_forms, *three, **arguments)
        assert "\n" not in str(catch_error(call, key, names=names)), change


def refused_on_ranks(comm: MPI.Comm) -> list[str]:
    """What each rank is told of a condition and of a face that are wrong on one of them only."""
    (space, *forms), options, plate = given(PLATE, comm)
    corner = dolfinx.fem.locate_dofs_geometrical(space, lambda p: np.hypot(p[0], p[1]) < 1e-9)
    nonzero_condition = dolfinx.fem.dirichletbc(np.array([0.0, 1.0]), corner, space)
    left_facets = plate.facets("left")
    marks = dolfinx.mesh.meshtags(
        space.mesh, 1, np.sort(left_facets), np.full(len(left_facets), 9, np.int32)
    )  # fmt: skip
    messages = []
    for change in ({"bcs": [nonzero_condition]}, {"crack": (marks, 9, 8)}):
        call = partial(fc.structure_from_forms, space, *forms, **options | change)
        messages += comm.allgather(str(catch_error(call, *change)))
    return messages


@pytest.mark.mpi
def test_refused_on_every_rank(on_ranks: Callable[..., Any]) -> None:
    conditions, second_conditions, crack_message, second_crack_message = on_ranks(refused_on_ranks)
    assert conditions == second_conditions and conditions.startswith("bcs = ")
    assert crack_message == second_crack_message and "0 facets of tag 8" in crack_message
