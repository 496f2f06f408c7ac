"""Structures from matrices, look-ups, and the structures related to one."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sparse
from helpers import catch_error, dense
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from petsc4py import PETSc

from fenics_crack import (
    InputError,
    ModalDamping,
    RayleighDamping,
    ReducedStructure,
    Scene,
    Structure,
    build_structure,
    reduce_structure,
    solve_modes,
)

N, PAIRS = 5, 2


def good() -> dict[str, Any]:
    """Arguments of from_matrices as NumPy arrays: a random structure of 5 dofs and 2 pairs."""
    rng = np.random.default_rng(1)
    root_m, root_k, damping = rng.standard_normal((3, N, N))
    return {
        "mass": root_m @ root_m.T + np.eye(N),
        "stiffness": root_k @ root_k.T + np.eye(N),
        "gap": rng.standard_normal((N, PAIRS)),
        "force_sin": rng.standard_normal(N),
        "force_cos": rng.standard_normal(N),
        "force_mean": rng.standard_normal(N),
        "clearance": np.array([1e-3, -2e-3]),
        "damping": damping,
    }


def petsc(array: np.ndarray, kind: str = "aij") -> PETSc.Mat:
    """A sequential PETSc matrix."""
    matrix = PETSc.Mat().createDense(array.shape, comm=PETSc.COMM_SELF)
    matrix.setUp()
    for index, value in np.ndenumerate(array):
        matrix[index] = value
    matrix.assemble()
    return matrix if kind == "dense" else matrix.convert(kind, PETSc.Mat())


def test_matrices_in_the_order_mass_damping_stiffness() -> None:
    """Everybody's order is refused: the damping would be the stiffness."""
    mass, damping, stiffness = np.eye(2), 0.1 * np.eye(2), np.diag([1.0, 2.0])
    message = r"too many .*; its arguments are mass, stiffness, gap=\.\.\., .*damping=\.\.\.,"
    for third in (stiffness, [1.0, 0.0]):
        catch_error(
            partial(Structure.from_matrices, mass, damping, third), names=message, kind=TypeError
        )


# --- from_matrices --------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "convert",
    [
        np.array,
        np.ndarray.tolist,
        np.asfortranarray,
        sparse.csr_matrix,
        sparse.coo_matrix,
        sparse.csc_matrix,
        petsc,
        lambda array: petsc(array, "dense"),
        lambda array: petsc(array, "baij") if array.shape == (N, N) else petsc(array),
        "file",
    ],
    ids=["numpy", "list", "fortran", "csr", "coo", "csc", "aij", "dense", "baij", "file"],
)
def test_every_form_of_the_matrices_gives_the_same(convert: Any, tmp_path: Path) -> None:
    """NumPy, lists, SciPy, PETSc and Matrix Market files give the same structure."""
    arguments = good()
    originals = {name: np.copy(value) for name, value in arguments.items()}
    for name in ("mass", "stiffness", "gap", "damping"):
        if convert == "file":
            path = tmp_path / f"{name}.mtx"
            scipy.io.mmwrite(str(path), sparse.coo_matrix(arguments[name]))
            arguments[name] = path
        else:
            arguments[name] = convert(arguments[name])
    structure = Structure.from_matrices(**arguments)
    assert (structure.n_dofs, structure.n_pairs, structure.n_local) == (N, PAIRS, N)
    for name in ("mass", "stiffness", "damping"):
        np.testing.assert_allclose(dense(getattr(structure, name)), originals[name], rtol=1e-15)
    np.testing.assert_allclose(structure.gap.toarray(), originals["gap"], rtol=1e-15)
    np.testing.assert_array_equal(
        structure.force, [originals["force_mean"], originals["force_cos"], originals["force_sin"]]
    )
    np.testing.assert_array_equal(structure.clearance, originals["clearance"])
    displacement = np.random.default_rng(2).standard_normal((3, N))
    np.testing.assert_allclose(
        structure.apply_bt(displacement), displacement @ originals["gap"], rtol=1e-13, atol=1e-14
    )
    forces = displacement[:, :PAIRS]
    np.testing.assert_allclose(
        structure.apply_b(forces), forces @ originals["gap"].T, rtol=1e-13, atol=1e-14
    )


def test_forces_of_every_form_are_the_same(tmp_path: Path) -> None:
    """A force may be a vector, a column, sparse, PETSc's or a file."""
    arguments = good()
    force = arguments["force_sin"]
    vector = PETSc.Vec().createWithArray(force.copy(), comm=PETSc.COMM_SELF)
    path = tmp_path / "force.mtx"
    scipy.io.mmwrite(str(path), force[:, None])
    for form in (list(force), force[:, None], sparse.csr_matrix(force[:, None]), vector, path):
        structure = Structure.from_matrices(**(arguments | {"force_sin": form}))
        np.testing.assert_array_equal(structure.force[2], force)


def test_given_matrices_are_left_alone() -> None:
    """A PETSc matrix that was given neither changes nor changes the structure afterwards."""
    arguments = good()
    given_mass = petsc(arguments["mass"])
    structure = Structure.from_matrices(**(arguments | {"mass": given_mass}))
    given_mass.scale(2.0)
    np.testing.assert_allclose(dense(structure.mass), arguments["mass"], rtol=1e-15)


def with_entry(name: str, value: float) -> np.ndarray:
    """The good argument with its first entry replaced, and its symmetry kept."""
    array = np.copy(good()[name])
    array.flat[0] = value
    return array


SQUARE = np.ones((N + 1, N + 1)) + np.eye(N + 1)
SKEW = np.triu(np.ones((N, N)), 1)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("mass", np.ones((N, N + 1))),
        ("mass", petsc(np.ones((N, N + 1)))),
        ("mass", np.zeros((0, 0))),
        ("mass", []),
        ("mass", np.ones((2, 2, 2))),
        ("mass", None),
        ("mass", {}),
        ("mass", "missing.mtx"),
        ("mass", [[1.0, 2.0], [3.0]]),
        ("mass", good()["mass"] + SKEW),
        ("mass", sparse.csr_matrix(good()["mass"] + SKEW)),
        ("mass", petsc(good()["mass"] + SKEW)),
        ("mass", np.diag([1.0, 1.0, -1.0, 1.0, 1.0])),
        ("mass", np.diag([1.0, 1.0, 0.0, 1.0, 1.0])),
        ("mass", np.ones((N, N))),
        ("mass", np.zeros((N, N))),
        ("mass", sparse.csr_matrix((N, N))),
        ("mass", with_entry("mass", np.nan)),
        ("mass", with_entry("mass", np.inf)),
        ("mass", petsc(with_entry("mass", np.nan))),
        ("mass", good()["mass"] + 0j),
        ("mass", sparse.csr_matrix(good()["mass"] + 0j)),
        ("stiffness", SQUARE),
        ("stiffness", petsc(SQUARE)),
        ("stiffness", np.ones(N)),
        ("stiffness", good()["stiffness"] + SKEW),
        ("stiffness", with_entry("stiffness", -np.inf)),
        ("stiffness", petsc(with_entry("stiffness", np.nan))),
        ("stiffness", good()["stiffness"] * 1j),
        ("stiffness", -good()["stiffness"]),
        ("stiffness", petsc(-good()["stiffness"])),
        ("stiffness", good()["stiffness"] - 4.0 * np.eye(N)),
        ("stiffness", 1e297 * good()["stiffness"]),
        ("stiffness", 1e-297 * good()["stiffness"]),
        ("mass", petsc(1e297 * good()["mass"])),
        ("damping", 1e100 * good()["damping"]),
        ("force_sin", np.full(N, 1e61)),
        ("gap", np.ones((N + 1, PAIRS))),
        ("gap", np.ones((PAIRS, N))),
        ("gap", np.ones((N, PAIRS, 1))),
        ("gap", 1.0),
        ("gap", good()["gap"] * np.arange(PAIRS)),
        ("gap", sparse.csr_matrix(good()["gap"] * np.arange(PAIRS))),
        ("gap", with_entry("gap", np.nan)),
        ("gap", sparse.csr_matrix(with_entry("gap", np.nan))),
        ("gap", ["a"] * N),
        ("gap", good()["gap"] * 1j),
        ("force_sin", np.ones(N + 1)),
        ("force_sin", np.ones((N, 101))),
        ("force_mean", np.ones((N, 2))),
        ("force_sin", 1.0),
        ("force_sin", with_entry("force_sin", np.nan)),
        ("force_cos", np.ones(N - 1)),
        ("force_cos", 1j * np.ones(N)),
        ("force_mean", np.ones((1, N))),
        ("force_mean", with_entry("force_mean", np.inf)),
        ("clearance", np.zeros(PAIRS + 1)),
        ("clearance", np.zeros((PAIRS, 1))),
        ("clearance", np.nan),
        ("clearance", [0.0, np.inf]),
        ("clearance", None),
        ("clearance", "wide"),
        ("clearance", 1j),
        ("clearance", np.array([1j, 0.0])),
        ("damping", 0.01),
        ("damping", SQUARE),
        ("damping", with_entry("damping", np.nan)),
        ("damping", petsc(with_entry("damping", np.inf))),
        ("damping", good()["damping"] * 1j),
        ("damping", "little"),
    ],
)
def test_wrong_argument_is_named(name: str, value: Any) -> None:
    """One wrong argument of from_matrices gives one InputError with that argument's name."""
    catch_error(lambda: Structure.from_matrices(**(good() | {name: value})), name)


@pytest.mark.parametrize(
    "content",
    [
        "",
        "nonsense\n",
        "%%MatrixMarket matrix coordinate real general\n2 2 1\n",
        "%%MatrixMarket matrix coordinate real general\n5 5 1\n1 9 1.0\n",
        "%%MatrixMarket matrix coordinate complex general\n1 1 1\n1 1 1.0 1.0\n",
        "%%MatrixMarket matrix array real general\n1 1\nx\n",
    ],
)
def test_bad_matrix_market_file(content: str, tmp_path: Path) -> None:
    """A Matrix Market file that is cut off, broken or complex is refused."""
    path = tmp_path / "mass.mtx"
    path.write_text(content)
    catch_error(lambda: Structure.from_matrices(**(good() | {"mass": path})), "mass")


@pytest.mark.parametrize(
    ("key", "arguments"),
    [
        ("damping ratio", (-0.1,)),
        ("damping ratio", (np.nan,)),
        ("damping ratio", (np.inf,)),
        ("damping ratio", ([0.1, -0.1],)),
        ("damping ratio", ([[0.1]],)),
        ("damping ratio", ([],)),
        ("damping ratio", ("much",)),
        ("damping ratio", (None,)),
        ("damping ratio", ([[0.1], [0.1, 0.2]],)),
        ("damping modes", (0.1, 0)),
        ("damping modes", (0.1, -1)),
        ("damping modes", (0.1, 2.5)),
        ("damping modes", (0.1, True)),
        ("damping modes", (0.1, "all")),
    ],
)
def test_wrong_modal_damping(key: str, arguments: tuple[Any, ...]) -> None:
    """Ratios must be finite and not negative, the number of modes a whole number from 1 on."""
    catch_error(lambda: ModalDamping(*arguments), key, arguments[-1])


ANY_ARRAY = arrays(
    st.sampled_from([float, int, complex, object]),
    array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
    elements=st.sampled_from([0, 1, -1, 2, 3]),
)
ANY_MATRIX = (
    ANY_ARRAY
    | arrays(float, st.sampled_from([(3, 3), (3, 1), (3, 2), (3,)]), elements=st.floats())
    | st.sampled_from([np.eye(3), 2 * np.eye(3) + 1, sparse.eye(3), np.ones(3)])
    | st.none()
    | st.floats()
    | st.text(max_size=3)
)


@settings(max_examples=40)
@given(st.dictionaries(st.sampled_from(sorted(good())), ANY_MATRIX, min_size=1, max_size=3))
def test_any_matrices_give_a_structure_or_an_input_error(changes: dict[str, Any]) -> None:
    """Whatever is given for some of the arguments, the only exception is InputError."""
    arguments: dict[str, Any] = dict.fromkeys(("mass", "stiffness", "damping"), np.eye(3))
    arguments |= {"gap": np.ones((3, 2)), "clearance": 0.0} | changes
    try:
        with np.errstate(all="ignore"):
            structure = Structure.from_matrices(**arguments)
    except InputError as error:
        assert error.key in arguments
    else:
        n = structure.n_dofs
        assert len(structure.force) % 2 == 1 and structure.force.shape[1] == n
        assert structure.gap.shape == (n, structure.n_pairs)
        assert structure.clearance.shape == (structure.n_pairs,)
        assert np.linalg.eigvalsh(dense(structure.mass)).min() > 0.0


# --- displacements --------------------------------------------------------------------------------
def test_find_dof(paper_structure: Structure) -> None:
    """The dof of a node moves that node: its unit displacement shows at its place alone."""
    nodes = paper_structure.nodes
    for point in ((0.1, 0.1), (0.05, 0.05), (0.0, 0.0625)):
        place = np.flatnonzero(np.linalg.norm(nodes.points - point, axis=1) < 1e-9)
        dofs = [paper_structure.find_dof(point, component) for component in (0, 1, "x", "y")]
        assert dofs == [*nodes.dofs[place[0]], *nodes.dofs[place[0]]]
    np.testing.assert_array_equal(
        np.flatnonzero(paper_structure.force[2]), [paper_structure.find_dof((0.1, 0.1), "x")]
    )


@pytest.mark.parametrize(
    ("key", "point", "component", "names"),
    [
        ("point", (0.03, 0.05), 0, "0 are there"),
        ("point", (0.0, 0.05), 1, "2 are there"),
        ("point", (0.05, 0.0), 0, None),
        ("point", (0.1, 0.1, 0.0), 0, None),
        ("point", (np.nan, 0.1), 0, None),
        ("point", "corner", 0, None),
        ("point", None, 0, None),
        ("component", (0.1, 0.1), 2, "'x' or 'y'"),
        ("component", (0.1, 0.1), "z", "'x' or 'y'"),
        ("component", (0.1, 0.1), [0], "'x' or 'y'"),
        ("component", (0.1, 0.1), None, "'x' or 'y'"),
    ],
)
def test_find_dof_refuses(
    paper_structure: Structure, key: str, point: Any, component: Any, names: str | None
) -> None:
    """No node, two nodes, a clamped one, or something that is no point or no component."""
    catch_error(lambda: paper_structure.find_dof(point, component), key, names=names)


def test_find_dof_needs_a_mesh() -> None:
    """A structure made from matrices knows no positions."""
    catch_error(lambda: Structure.from_matrices(**good()).find_dof((0.0, 0.0), 0), "point")


def test_values_at() -> None:
    """Values are picked in the order asked for, repeated where asked for twice."""
    structure = Structure.from_matrices(**good())
    displacement = np.arange(2.0 * N).reshape(2, N)
    np.testing.assert_array_equal(
        structure.values_at(displacement, [3, 0, 3]), [[3, 0, 3], [8, 5, 8]]
    )
    assert structure.values_at(displacement, []).shape == (2, 0)
    assert structure.values_at(1j * displacement, [1])[1, 0] == 6j


@pytest.mark.parametrize("dofs", [[N], [-1], [0, 99], [0.5], [np.nan], "x", None])
def test_values_at_refuses(dofs: Any) -> None:
    """A dof that does not exist is refused, negative ones too."""
    catch_error(
        lambda: Structure.from_matrices(**good()).values_at(np.zeros((1, N)), dofs), "dofs", dofs
    )


# --- related structures ---------------------------------------------------------------------------
@pytest.mark.parametrize("stiffness", [7.0, np.array([7.0, 3.0]), 0.0])
def test_tied(stiffness: Any) -> None:
    """Tying adds B diag(k) B^T to the stiffness and takes the pairs away; the rest stays."""
    arguments = good()
    structure = Structure.from_matrices(**arguments)
    bonded_structure = structure.tied(stiffness)
    gap = arguments["gap"]
    springs = gap @ np.diag(np.broadcast_to(stiffness, PAIRS)) @ gap.T
    np.testing.assert_allclose(
        dense(bonded_structure.stiffness), arguments["stiffness"] + springs, rtol=1e-13, atol=1e-13
    )
    np.testing.assert_array_equal(dense(bonded_structure.mass), arguments["mass"])
    np.testing.assert_array_equal(dense(structure.stiffness), arguments["stiffness"])
    assert (bonded_structure.n_pairs, structure.n_pairs) == (0, PAIRS)
    np.testing.assert_array_equal(bonded_structure.force, structure.force)


def test_tied_plate(paper_structure: Structure) -> None:
    """The same on a sparse structure, where the springs add entries to the pattern."""
    gap = paper_structure.gap.toarray()
    exact_stiffness = dense(paper_structure.stiffness) + 1e11 * gap @ gap.T
    bonded_stiffness = dense(paper_structure.tied(1e11).stiffness)
    np.testing.assert_allclose(
        bonded_stiffness, exact_stiffness, rtol=1e-13, atol=1e-13 * exact_stiffness.max()
    )


@pytest.mark.parametrize("stiffness", [-1.0, np.nan, [1.0, 2.0, 3.0], "hard", np.inf])
def test_tied_refuses(stiffness: Any) -> None:
    """The stiffness is one finite number, or one for each pair; no springs push apart."""
    catch_error(lambda: Structure.from_matrices(**good()).tied(stiffness), "stiffness", stiffness)


def test_damped() -> None:
    """`damped` exchanges the damping and nothing else."""
    structure = Structure.from_matrices(**good())
    for damping in (ModalDamping(0.01), RayleighDamping(0.1, 0.01)):
        damped_structure = structure.damped(damping)
        assert damped_structure.damping is damping
    assert (
        damped_structure.mass is structure.mass
        and damped_structure.stiffness is structure.stiffness
    )
    assert structure.damped(None).damping is None


@pytest.mark.parametrize(
    ("cells", "order"), [("triangle", 1), ("quadrilateral", 1), ("quadrilateral", 2)]
)
def test_lumped(paper_scene: Scene, cells: str, order: int) -> None:
    """The lumped mass is diagonal, with the row sums of M, which are positive (Simpson's rule)."""
    structure = build_structure(paper_scene.replace({"mesh.cells": cells, "mesh.order": order}))
    lumped_structure = structure.lumped()
    sums = dense(structure.mass).sum(axis=1)
    assert sums.min() > 0.0
    np.testing.assert_allclose(dense(lumped_structure.mass), np.diag(sums), rtol=1e-12)
    assert lumped_structure.stiffness is structure.stiffness
    assert lumped_structure.n_pairs == structure.n_pairs


@pytest.mark.parametrize(("columns", "rows"), [(2, 8), (4, 4), (6, 2)])
def test_lumped_refuses_six_node_triangles(paper_scene: Scene, columns: int, rows: int) -> None:
    """The corners of quadratic triangles have no mass in the row sums: refused."""
    changes = {"mesh.cells": "triangle", "mesh.order": 2, "mesh.columns": columns}
    catch_error(
        lambda: build_structure(paper_scene.replace(changes | {"mesh.rows": rows})).lumped(), "mass"
    )


@pytest.mark.parametrize("free", [(), (0,), (0, 1), tuple(range(N))])
@pytest.mark.parametrize("convert", [np.asarray, sparse.csr_matrix, petsc])
def test_what_nothing_holds_is_met(free: tuple[int, ...], convert: Any) -> None:
    """A dof without stiffness moves freely, in rows without an entry too."""
    springs = np.ones(N)
    springs[[*free]] = 0.0
    structure = Structure.from_matrices(np.eye(N), convert(np.diag(springs)), gap=None)
    omega = solve_modes(structure, N).omega
    assert omega == pytest.approx(np.repeat([0.0, 1.0], [len(free), N - len(free)]))


def test_duplicate_entries_are_added() -> None:
    """CSR and COO matrices may give an entry in parts."""
    parts = sparse.coo_matrix(([1.0, 1.0, 3.0], ([0, 0, 1], [0, 0, 1])))
    for matrix in (parts, sparse.csr_matrix(([1.0, 1.0, 3.0], [0, 0, 1], [0, 2, 3]))):
        structure = Structure.from_matrices(np.eye(2), matrix, gap=None)
        assert np.array_equal(structure.stiffness[:, :], [[2.0, 0.0], [0.0, 3.0]])


def test_damped_refuses_what_is_no_rule() -> None:
    """A damping matrix needs a new structure."""
    catch_error(lambda: Structure.from_matrices(**good()).damped("much"), "damping", "much")  # type: ignore[arg-type]


# --- a structure never changes --------------------------------------------------------------------
def plates(scene: Scene) -> list[Structure]:
    """With a mesh, varied, reduced, and reduced and varied."""
    plate = build_structure(scene)
    reduced_structure = reduce_structure(plate, modes=5)
    return [plate, plate.varied(load=2.0), reduced_structure, reduced_structure.varied(damping=2.0)]


def test_no_attribute_can_be_set(paper_scene: Scene) -> None:
    """No attribute of any name can be set; the message says what to do instead."""
    for structure in plates(paper_scene):
        names = [name for name in dir(structure) if not name.startswith("_")]
        field_names = {
            "force",
            "clearance",
            "damping",
            "pair_areas",
            "mass",
            "n_dofs",
            "whole",
            "nodes",
        }
        assert field_names <= set(names)
        for name in [*names, "another"]:
            catch_error(
                partial(setattr, structure, name, 0.0),
                names=rf"^{name}: .* varied\(\)",
                kind=AttributeError,
            )


def test_arrays_are_read_only(paper_scene: Scene) -> None:
    """Those of the structure, of its nodes and of its gap."""
    for structure in plates(paper_scene):
        nodes = structure.nodes
        arrays = [structure.force, structure.clearance, structure.pair_points, structure.pair_areas]
        arrays += [nodes.points, nodes.dofs, nodes.cells, structure.gap.data]
        if isinstance(structure, ReducedStructure):
            arrays += [structure.basis, structure.omega, structure.reference.basis]
        for array in arrays:
            assert array is not None and array.size
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 1.0
    clearance = np.zeros(PAIRS)
    Structure.from_matrices(**(good() | {"clearance": clearance}))
    clearance[0] = 1.0  # that which was given is the user's


def test_ratios_that_were_given_may_change() -> None:
    """The damping has a copy of its own."""
    ratios = [0.1, 0.2]
    damping = ModalDamping(ratios)
    ratios[0] = 0.5
    assert damping.ratio == (0.1, 0.2) and damping == ModalDamping(np.array([0.1, 0.2]))


# --- varied copies --------------------------------------------------------------------------------
DAMPINGS = {
    "none": None,
    "one ratio": ModalDamping(0.1),
    "ratios": ModalDamping([0.1, 0.2], 2),
    "Rayleigh": RayleighDamping(0.1, 0.2),
    "matrix": good()["damping"],
}


@pytest.mark.parametrize("damping", DAMPINGS.values(), ids=DAMPINGS)
def test_varied(damping: Any) -> None:
    """Factors multiply, clearances add up; the structure itself stays, and shares its matrices."""
    structure = Structure.from_matrices(**(good() | {"damping": damping}))
    force, clearance, damping_before = (
        structure.force.copy(),
        structure.clearance.copy(),
        structure.damping,
    )
    varied_structure = structure.varied(load=2.0, damping=3.0, clearance=1e-3)
    varied_twice = varied_structure.varied(load=-0.5, damping=0.5, clearance=np.array([0.0, 1.0]))
    for copy, load, factor, added_clearance in (
        (varied_structure, 2.0, 3.0, [1e-3, 1e-3]),
        (varied_twice, -1.0, 1.5, [1e-3, 1.001]),
    ):
        assert copy.body is structure.body and copy.mass is structure.mass
        np.testing.assert_array_equal(copy.force, load * force)
        np.testing.assert_allclose(copy.clearance, clearance + added_clearance, rtol=1e-14)
        assert copy.damping_multiplier == factor
        if isinstance(damping, ModalDamping):
            assert copy.damping.modes == damping.modes
            ratio = factor * np.asarray(damping.ratio)
            np.testing.assert_allclose(copy.damping.ratio, ratio, rtol=1e-14)
        elif isinstance(damping, RayleighDamping):
            assert copy.damping == damping.scaled(factor)
        elif damping is None:
            assert copy.damping is None
        else:
            np.testing.assert_allclose(dense(copy.damping), factor * damping, rtol=1e-14)
    np.testing.assert_array_equal(structure.force, force)
    np.testing.assert_array_equal(structure.clearance, clearance)
    assert structure.damping is damping_before and structure.unvaried_structure is structure
    assert (
        varied_structure.unvaried_structure.damping is damping_before
        and varied_structure.unvaried_structure.force is structure.force
    )


def test_parts_of_the_load_mixed() -> None:
    """A matrix makes the new mean, cosine and sine part of the old ones."""
    structure = Structure.from_matrices(**good())
    mean, cosine, sine = structure.force
    matrix = np.array([[0.0, 1.0, 0.0], [2.0, 0.0, 0.0], [0.0, 3.0, 4.0]])
    exact_force = np.array([cosine, 2.0 * mean, 3.0 * cosine + 4.0 * sine])
    np.testing.assert_allclose(structure.varied(load=matrix).force, exact_force, rtol=1e-14)
    twice = structure.varied(load=2.0).varied(load=matrix)
    np.testing.assert_allclose(twice.force, 2.0 * exact_force, rtol=1e-14)


def test_varied_reduction_speaks_of_the_varied_plate(paper_scene: Scene) -> None:
    """Its whole structure and its reference are varied with it."""
    plate = build_structure(paper_scene)
    reduced_structure = reduce_structure(plate, modes=5)
    varied_model = reduced_structure.varied(load=2.0, damping=3.0, clearance=1e-6)
    assert isinstance(varied_model, ReducedStructure) and varied_model.reference is not None
    for copy, source in (
        (varied_model, reduced_structure),
        (varied_model.reference, reduced_structure.reference),
        (varied_model.whole, plate),
    ):
        assert source is not None and copy.body is source.body
        np.testing.assert_array_equal(copy.force, 2.0 * source.force)
        np.testing.assert_array_equal(copy.clearance, source.clearance + 1e-6)
        assert copy.damping == ModalDamping(3.0 * 0.001)
    assert reduced_structure.whole is plate


def test_a_reduction_is_in_one_setting(paper_scene: Scene) -> None:
    """Another dof is watched of its whole structure, too, whatever varies then; and of a structure
    without a load the same as with one."""
    reduced_structure = reduce_structure(build_structure(paper_scene), modes=5)
    dof = reduced_structure.watched_dof + 1
    watching_model, units = (
        reduced_structure.watching(dof).varied(load=0.0, damping=2.0),
        np.eye(reduced_structure.n_dofs),
    )
    assert watching_model.whole.watched_dof == watching_model.watched_dof == dof
    np.testing.assert_array_equal(
        watching_model.values_at(units, [None]), watching_model.values_at(units, [dof])
    )
    assert (
        reduced_structure.varied(load=0.0).watched_dof == reduced_structure.watched_dof == dof - 1
    )
    assert (
        watching_model.body is reduced_structure.body
        and watching_model.whole.body is reduced_structure.whole.body
    )
    half = watching_model.damped(ModalDamping(0.01))
    assert half.damping == ModalDamping(0.01) and half.watched_dof == dof


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("load", np.nan),
        ("load", "much"),
        ("load", np.ones(3)),
        ("load", np.full((3, 3), np.inf)),
        ("damping", -1.0),
        ("damping", np.inf),
        ("damping", [1.0]),
        ("clearance", np.nan),
        ("clearance", np.zeros(PAIRS + 1)),
    ],
)
def test_varied_refuses(key: str, value: Any) -> None:
    """What is not finite, of another shape, or a negative damping."""
    catch_error(lambda: Structure.from_matrices(**good()).varied(**{key: value}), key)


def test_printed_in_one_line(paper_scene: Scene) -> None:
    """Sizes and damping."""
    plate = build_structure(paper_scene)
    assert repr(plate) == "Structure(50 dofs, 1 pair, modal damping 0.1 %)"
    reduced_structure = reduce_structure(plate, modes=5)
    assert repr(reduced_structure.varied(damping=2.0)) == (
        "ReducedStructure(7 coordinates of 50 dofs, 1 pair, modal damping 0.2 %)"
    )
    bare = plate.tied(1.0).damped(ModalDamping([0.01, 0.02], 2))
    assert repr(bare) == "Structure(50 dofs, 0 pairs, modal damping 1 to 2 % of 2 modes)"
    assert repr(plate.damped(None)) == "Structure(50 dofs, 1 pair, no damping)"
    structure = Structure.from_matrices(**good())
    assert repr(structure) == repr(structure.varied(damping=0.5))
    assert repr(structure) == "Structure(5 dofs, 2 pairs, damping matrix)"
