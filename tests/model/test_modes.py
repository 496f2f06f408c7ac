"""Natural modes, and that they are computed once for all that is varied of a structure."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sparse
from helpers import DEMOS, catch_error, chain_stiffness, dense, log_slope
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack import (
    ModalDamping,
    Scene,
    Structure,
    build_structure,
    find_crack_length,
    reduce_structure,
    solve_modes,
)


def random_matrices(n: int, rigid: int = 0, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Random mass, and stiffness with a null space of some dimension."""
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((n, n))
    mass = root @ root.T / n + np.eye(n)
    root = rng.standard_normal((n, n - rigid)) * 10.0 ** rng.uniform(-1.0, 1.0, n - rigid)
    return mass, root @ root.T


def plate(columns: int, rows: int, **changes: Any) -> Scene:
    """An uncracked unit square, E = rho = 1, on a grid; some keys changed."""
    scene = Scene.from_mapping(
        {
            "geometry": {"width": 1.0, "height": 1.0, "thickness": 1.0},
            "material": {"young": 1.0, "poisson": 0.3, "density": 1.0},
            "damping": {"ratio": 0.001},
            "excitation": {"omega": 1.0, "point": [0.0, 1.0]},
            "mesh": {"layout": "grid", "columns": columns, "rows": rows},
        }
    )
    return scene.replace(changes)


# --- against dense linear algebra -----------------------------------------------------------------
@pytest.mark.parametrize("seed", range(3))
def test_all_modes_of_random_matrices(seed: int) -> None:
    """K phi = omega^2 M phi, shapes M-orthonormal, frequencies those of LAPACK."""
    n = 30
    mass, stiffness = random_matrices(n, seed=seed)
    modes = solve_modes(Structure.from_matrices(mass, stiffness, gap=None), n)
    squares = scipy.linalg.eigvalsh(stiffness, mass)
    # LAPACK and SLEPc each know omega^2 to rounding of the largest.
    np.testing.assert_allclose(modes.omega**2, squares, rtol=1e-10, atol=1e-12 * squares[-1])
    residual = stiffness @ modes.shapes - mass @ modes.shapes * modes.omega**2
    assert np.abs(residual).max() < 1e-11 * np.abs(stiffness).max()
    np.testing.assert_allclose(modes.shapes.T @ mass @ modes.shapes, np.eye(n), atol=1e-12)


@pytest.mark.parametrize("count", [1, 2, 7, 29])
def test_lowest_modes_are_the_first_of_all(count: int) -> None:
    """Few modes are the lowest ones, with the same signs as when all are computed."""
    mass, stiffness = random_matrices(30)
    structure = Structure.from_matrices(mass, stiffness, gap=None)
    lowest_modes, all_modes = solve_modes(structure, count), solve_modes(structure, 30)
    np.testing.assert_allclose(lowest_modes.omega, all_modes.omega[:count], rtol=1e-8)
    np.testing.assert_allclose(lowest_modes.shapes, all_modes.shapes[:, :count], atol=1e-6)


@pytest.mark.parametrize("rigid", [1, 3])
def test_rigid_body_modes(rigid: int) -> None:
    """A structure that can move freely has modes of frequency zero, and the others are exact."""
    mass, stiffness = random_matrices(30, rigid)
    modes = solve_modes(Structure.from_matrices(mass, stiffness, gap=None), 8)
    squares = scipy.linalg.eigvalsh(stiffness, mass)
    assert modes.omega[rigid - 1] < 1e-5 * modes.omega[rigid]  # the root of rounding
    np.testing.assert_allclose(modes.omega[rigid:] ** 2, squares[rigid:8], rtol=1e-8)
    np.testing.assert_allclose(modes.shapes.T @ mass @ modes.shapes, np.eye(8), atol=1e-12)
    assert np.abs(stiffness @ modes.shapes[:, :rigid]).max() < 1e-9 * np.abs(stiffness).max()


def test_free_chain() -> None:
    """n equal masses joined by n - 1 springs: omega_j = 2 sin(j pi / 2n), j = 0, 1, ..."""
    n, count = 200, 6
    stiffness = chain_stiffness(np.array([0.0, *np.ones(n - 1), 0.0]))
    modes = solve_modes(Structure.from_matrices(np.eye(n), stiffness, gap=None), count)
    exact = 2.0 * np.sin(np.arange(count) * np.pi / (2 * n))
    np.testing.assert_allclose(modes.omega[1:], exact[1:], rtol=1e-10)
    assert modes.omega[0] < 1e-4 * exact[1]
    np.testing.assert_allclose(modes.shapes[:, 0], n**-0.5, rtol=1e-8)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5, 8, 20, 60])
def test_double_frequencies_are_found_twice(count: int) -> None:
    """A ring of n masses on springs: omega_j^2 = k0 + 4 sin^2(j pi / n), all but two double."""
    n = 60
    unit = np.eye(n)
    stiffness = 2.1 * unit - np.roll(unit, 1, axis=0) - np.roll(unit, -1, axis=0)
    modes = solve_modes(Structure.from_matrices(unit, stiffness, gap=None), count)
    squares = np.sort(0.1 + 4.0 * np.sin(np.arange(n) * np.pi / n) ** 2)
    np.testing.assert_allclose(modes.omega, np.sqrt(squares[:count]), rtol=1e-10)
    np.testing.assert_allclose(modes.shapes.T @ modes.shapes, np.eye(count), atol=1e-12)


@pytest.mark.parametrize("n", [9, 10, 23])
def test_signs(n: int) -> None:
    """A chain between walls, sin(j pi i / (n+1)): the first of its largest parts is positive."""
    stiffness = chain_stiffness(np.ones(n + 1))
    modes = solve_modes(Structure.from_matrices(np.eye(n), stiffness, gap=None), n)
    places = np.arange(1, n + 1)
    exact = np.sin(np.outer(places, places) * np.pi / (n + 1))
    is_large = np.abs(exact) > (1.0 - 1e-9) * np.abs(exact).max(axis=0)
    exact *= np.sign(exact[is_large.argmax(axis=0), range(n)])
    np.testing.assert_allclose(modes.shapes, exact / np.linalg.norm(exact, axis=0), atol=1e-10)


def test_frequencies_of_twenty_equal_chains() -> None:
    """Of n masses between walls omega_j = 2 sin(j pi / (2 n + 2)), each 20 times: more than a first
    Krylov space finds."""
    chains, n, count = 20, 10, 25
    chain = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    structure = Structure.from_matrices(
        np.eye(chains * n), np.kron(np.eye(chains), chain), gap=None
    )
    omega = 2.0 * np.sin(np.arange(1, n + 1) * np.pi / (2 * n + 2))
    np.testing.assert_allclose(
        solve_modes(structure, count).omega, np.repeat(omega, chains)[:count], rtol=1e-12
    )


@pytest.mark.parametrize("n", [1, 2, 3, 10])
@pytest.mark.parametrize("free", [False, True])
def test_equal_frequencies_of_a_few_masses(n: int, free: bool) -> None:
    """All modes of equal oscillators are found, and of masses without springs."""
    stiffness = 0.0 if free else 4.0
    modes = solve_modes(Structure.from_matrices(np.eye(n), stiffness * np.eye(n), gap=None), n)
    np.testing.assert_allclose(modes.omega, np.sqrt(stiffness), rtol=1e-12)
    np.testing.assert_allclose(modes.shapes.T @ modes.shapes, np.eye(n), atol=1e-12)


def test_motions_as_a_rigid_body_have_no_frequency() -> None:
    """Of two chains that nothing holds, two; their frequency is zero, not that of rounding."""
    block = chain_stiffness(np.array([0.0, 1.0, 2.0, 0.0]))
    stiffness = 1e7 * np.block([[block, np.zeros((3, 3))], [np.zeros((3, 3)), block]])
    omega = solve_modes(Structure.from_matrices(np.eye(6), stiffness, gap=None), 6).omega
    assert list(omega[:2]) == [0.0, 0.0] and omega[2] > 1e3


def test_a_low_frequency_beside_light_dofs_is_none_of_a_rigid_body() -> None:
    """However light other dofs are: a mass on two springs, 1e-17 of it between them."""
    springs = np.array([[2.0, -1.0], [-1.0, 1.0]])
    structure = Structure.from_matrices(np.diag([1e-17, 1.0]), springs, gap=None)
    np.testing.assert_allclose(solve_modes(structure, 1).omega, np.sqrt(0.5), rtol=1e-12)


@pytest.mark.parametrize("height", [2000.0, 9000.0])
def test_what_is_lost_in_rounding_is_said(height: float) -> None:
    """A clamped beam so many times as long as wide has a frequency, not to be found: no zero."""
    catch_error(
        lambda: solve_modes(
            build_structure(plate(1, 40, **{"geometry.height": height, "mesh.order": 2})), 1
        ),
        names="too slender",
        kind=fc.ConvergenceError,
    )


def test_a_factor_has_the_room_that_its_pivots_need() -> None:
    """K - omega^2 M whose diagonal is zero, against LAPACK: MUMPS's estimate is much too low."""
    n, rng = 200, np.random.default_rng(0)
    block = sparse.random(n, n, 4.0 / n, random_state=1) + sparse.eye(n).tocsr()[rng.permutation(n)]
    dynamic_stiffness = sparse.bmat([[None, block], [block.T, None]]).toarray()
    square = float(np.ceil(np.abs(dynamic_stiffness).sum(axis=1).max())) ** 2
    stiffness, force = dynamic_stiffness + square * np.eye(2 * n), rng.standard_normal(2 * n)
    structure = Structure.from_matrices(np.eye(2 * n), stiffness, gap=None, force_cos=force)
    amplitudes = fc.solve_linear(structure, np.sqrt(square)).displacement_coefficients[1]
    reference = scipy.linalg.solve(dynamic_stiffness, force)
    np.testing.assert_allclose(amplitudes, reference, rtol=0.0, atol=1e-8 * abs(reference).max())


MODES_OF_SOLID = """
from mpi4py import MPI
import fenics_crack as fc
modes = fc.modes(fc.Scene.load({path!r}), 6).result
if MPI.COMM_WORLD.rank == 0:
    print(*modes.omega.tolist())
"""


@pytest.mark.nightly
@pytest.mark.mpi
@pytest.mark.parametrize("ranks", [3, 4])
def test_solid_on_more_ranks(ranks: int, mpirun: Callable[..., str]) -> None:
    """As on one, however its mesh is distributed: MUMPS needed more room on some distributions."""
    path = str(DEMOS / "solid_blade.toml")
    omega = fc.modes(fc.Scene.load(path), 6, MPI.COMM_SELF).result.omega
    printed = mpirun(MODES_OF_SOLID.format(path=path), ranks).split()
    np.testing.assert_allclose([float(word) for word in printed], omega, rtol=1e-9)


@pytest.mark.parametrize("count", [0, -1, 31, 2.0, True, None, "all"])
def test_count_that_cannot_be(count: Any) -> None:
    """The number of modes is a whole number from 1 to the number of dofs."""
    catch_error(
        lambda: solve_modes(Structure.from_matrices(*random_matrices(30), gap=None), count),
        "count",
        count,
    )


# --- modal damping --------------------------------------------------------------------------------


# --- against closed forms and published values ----------------------------------------------------
def test_paper_plate(paper_structure: Structure) -> None:
    """omega_1 = 2302.9 rad/s with the crack open, 3324.7 with the pair tied by 1e11 N/m."""
    open_crack = solve_modes(paper_structure, 1).omega[0]
    bonded_omega = solve_modes(paper_structure.tied(1e11), 1).omega[0]
    assert open_crack == pytest.approx(2302.9, abs=0.5)
    assert bonded_omega == pytest.approx(3324.7, abs=0.5)


@pytest.mark.parametrize(("order", "rate"), [(1, 2.0), (2, 4.0)])
@pytest.mark.parametrize("cells", ["triangle", "quadrilateral"])
def test_order_of_convergence(cells: str, order: int, rate: float) -> None:
    """Axial vibration with nu = 0, u_y = sin(pi y / 2h): omega = pi/2h sqrt(E/rho), error h^2p.

    The mode is smooth, so that eigenvalues converge with twice the order of the displacement, from
    above.
    """
    sizes, errors = np.array([4, 8, 16]), []
    for rows in sizes:
        changes = {"material.poisson": 0.0, "geometry.width": 0.5}
        scene = plate(rows // 2, rows, **changes, **{"mesh.cells": cells, "mesh.order": order})
        structure = build_structure(scene)
        modes = solve_modes(structure, 6)
        dofs = structure.nodes.dofs[:, 1]
        exact = np.zeros((structure.n_dofs, 1))
        exact[dofs[dofs >= 0], 0] = np.sin(np.pi / 2 * structure.nodes.points[dofs >= 0, 1])
        axial = np.argmax(np.abs(modes.shapes.T @ dense(structure.mass) @ exact))
        errors.append(modes.omega[axial] / (np.pi / 2) - 1.0)
    assert min(errors) > 0.0
    assert log_slope(sizes, errors) == pytest.approx(-rate, abs=0.15)


@pytest.mark.parametrize("order", [1, 2])
def test_frequencies_fall_as_the_mesh_is_refined(order: int) -> None:
    """Rayleigh and Ritz: on nested meshes every frequency falls, whatever the corners do."""
    omegas = [
        solve_modes(build_structure(plate(cells, cells, **{"mesh.order": order})), 6).omega
        for cells in (2, 4, 8, 16)
    ]
    assert np.all(np.diff(omegas, axis=0) < 0.0)


# --- the crack's length from the first frequency --------------------------------------------------
@pytest.fixture(scope="module")
def breathing(paper_scene: Scene) -> Scene:
    """The paper's plate on a graded quadratic mesh, without a length of the crack."""
    mesh = {"layout": "graded", "order": 2, "size": 0.0125, "lip_elements": 6}
    changes = {f"mesh.{key}": value for key, value in mesh.items()}
    changes |= {"mesh.columns": None, "mesh.rows": None}
    return paper_scene.replace(changes | {"crack.length": None, "crack.first_omega": 2300.0})


@pytest.mark.parametrize("target", [2000.0, pytest.param(3000.0, marks=pytest.mark.nightly)])
def test_crack_length_from_the_first_frequency(breathing: Scene, target: float) -> None:
    """A plate with crack.first_omega has that first frequency, with its crack open."""
    scene = breathing.replace({"crack.first_omega": target})
    length = find_crack_length(scene, MPI.COMM_SELF)
    structure = build_structure(scene)
    assert solve_modes(structure, 1).omega[0] == pytest.approx(target, abs=0.1)
    structure_by_length = build_structure(
        scene.replace({"crack.first_omega": None, "crack.length": length})
    )
    np.testing.assert_allclose(structure.pair_points, structure_by_length.pair_points, atol=1e-12)


@pytest.mark.parametrize("target", [100.0, 5000.0])
def test_unreachable_first_frequency(breathing: Scene, target: float) -> None:
    """A frequency that no crack gives is refused; the message names those of 95 % and 1 %."""
    error = catch_error(
        lambda: find_crack_length(breathing.replace({"crack.first_omega": target}), MPI.COMM_SELF),
        "crack.first_omega",
    )
    numbers = [float(number) for number in re.findall(r"\d+\.\d+", error.allowed)]
    for number, part in zip(numbers, (0.95, 0.01), strict=True):
        scene_by_length = breathing.replace({"crack.first_omega": None, "crack.length": part * 0.1})
        assert number == pytest.approx(
            solve_modes(build_structure(scene_by_length), 1).omega[0], abs=0.06
        )
    assert not numbers[0] <= target <= numbers[1]


def test_length_without_a_frequency(paper_scene: Scene) -> None:
    """Without crack.first_omega no length can be found."""
    catch_error(lambda: find_crack_length(paper_scene, MPI.COMM_SELF), "crack.first_omega")


# --- several ranks --------------------------------------------------------------------------------


def spread_modes(comm: MPI.Comm) -> tuple[Any, ...]:
    """Rows of this rank, five frequencies, first closing, and sum of the load (collective)."""
    structure = Structure.from_matrices(
        *random_matrices(15), gap=np.ones(15), force_sin=np.arange(15.0), comm=comm
    )
    modes = solve_modes(structure, 5)
    gap_sum = structure.apply_bt(np.abs(modes.shapes.T))[0, 0]
    return structure.n_local, modes.omega, gap_sum, comm.allreduce(structure.force[2].sum())


@pytest.mark.mpi
def test_matrices_spread_over_two_ranks(on_ranks: Callable[..., Any]) -> None:
    """Matrices given whole to both ranks have the frequencies, and gaps, of one rank."""
    local, omega, gap_sum, force = on_ranks(spread_modes)
    assert local == 7
    mass, stiffness = random_matrices(15)
    squares, shapes = scipy.linalg.eigh(stiffness, mass)
    np.testing.assert_allclose(omega, np.sqrt(squares[:5]), rtol=1e-8)
    assert gap_sum == pytest.approx(np.abs(shapes[:, 0]).sum(), rel=1e-6)
    assert force == 14 * 15 / 2


# --- lips without mass ----------------------------------------------------------------------------
@pytest.mark.filterwarnings("error")
def test_modes_of_a_massless_reduction(wide_plate: Structure) -> None:
    """Those to which the plate was reduced, as the plate has them; not more."""
    reduced_structure = reduce_structure(wide_plate, modes=6, method="massless")
    reduced_modes, full_modes = solve_modes(reduced_structure, 4), solve_modes(wide_plate, 4)
    np.testing.assert_allclose(reduced_modes.omega, full_modes.omega, rtol=1e-12)
    shapes = reduced_structure.expand(reduced_modes.shapes.T).T
    np.testing.assert_allclose(
        shapes, full_modes.shapes, atol=1e-9 * np.abs(full_modes.shapes).max()
    )
    catch_error(lambda: solve_modes(reduced_structure, 7), "count", 7, names="n_modes = 6")


def test_another_damping_of_a_varied_massless_reduction(wide_plate: Structure) -> None:
    """Keeps the load and the clearance, also where a part of the load is new."""
    load = np.array([[0.0, 0.0, 0.5], [0.0, 1.0, 0.0], [0.0, 0.0, 2.0]])
    varied_plate = reduce_structure(wide_plate, modes=6, method="massless").varied(
        load=load, clearance=1e-6
    )
    redamped_plate = varied_plate.damped(ModalDamping(0.1))
    np.testing.assert_array_equal(redamped_plate.force, varied_plate.force)
    np.testing.assert_array_equal(redamped_plate.clearance, varied_plate.clearance)
    assert str(redamped_plate).endswith("modal damping 10 %)")


# --- computed once --------------------------------------------------------------------------------


@pytest.mark.parametrize("is_free", [False, True])
@pytest.mark.parametrize("counts", [(3, 7, 12), (11, 12), (5, 20, 60), (1, 2, 100)])
def test_more_modes_beside_known_ones(counts: tuple[int, ...], *, is_free: bool) -> None:
    """Modes added to those that were computed before, and up to all: frequencies as by LAPACK to
    1e-9, shapes orthonormal to 1e-9; also with a rigid-body motion."""
    size = 12 if counts[-1] == 12 else 200
    rng = np.random.default_rng(3)
    mass = np.diag(rng.uniform(1.0, 2.0, size))
    stiffness = chain_stiffness(np.ones(size + 1))
    if is_free:
        stiffness[0, 0] = stiffness[-1, -1] = 1.0
    squares = np.maximum(scipy.linalg.eigh(stiffness, mass, eigvals_only=True), 0.0)
    structure = fc.Structure.from_matrices(mass, stiffness, gap=None)
    for count in counts:
        modes = fc.solve_modes(structure, count)
        assert modes.omega**2 == pytest.approx(squares[:count], rel=1e-9, abs=1e-12)
        gram = modes.shapes.T @ mass @ modes.shapes
        assert np.abs(gram - np.eye(count)).max() < 1e-9
