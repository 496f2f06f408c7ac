"""Modes with tied lips: closed forms, the uncracked plate, springs in the limit, two ranks."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from helpers import catch_error, chain, chain_stiffness, dense, oscillator
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack.model.modes import find_bonded_mode_indices

HALF = 6
"""Masses on each side of the middle of a chain."""


def held_chain() -> tuple[np.ndarray, np.ndarray]:
    """K of 13 unit masses between unit springs, and B of one pair that stops the middle one."""
    gap = np.zeros(2 * HALF + 1)
    gap[HALF] = 1.0
    return chain_stiffness(np.ones(2 * HALF + 2)), gap


def half_chain() -> np.ndarray:
    """omega_j = 2 sin(j pi / (2 (p + 1))) of p unit masses between unit springs and walls."""
    return 2.0 * np.sin(np.arange(1, HALF + 1) * np.pi / (2.0 * (HALF + 1)))


# --- closed forms ---------------------------------------------------------------------------------
@pytest.mark.parametrize("count", [1, 2, 5, 12])
def test_chain_held_in_the_middle(count: int) -> None:
    """Two equal chains, so each of their frequencies twice; the clearance does not matter."""
    stiffness, gap = held_chain()
    structure = fc.Structure.from_matrices(np.eye(13), stiffness, gap=gap, clearance=0.3)
    modes = fc.solve_modes(structure, count, lips="tied")
    np.testing.assert_allclose(modes.omega, np.repeat(half_chain(), 2)[:count], rtol=1e-10)
    np.testing.assert_allclose(modes.shapes[HALF], 0.0, atol=1e-12)
    np.testing.assert_allclose(modes.shapes.T @ modes.shapes, np.eye(count), atol=1e-10)


def test_two_masses_become_one() -> None:
    """m x'' + k x = 0 on either side of the pair: w^2 = (k_1 + k_2) / (m_1 + m_2) tied."""
    structure = fc.Structure.from_matrices(
        np.diag([2.0, 3.0]), np.diag([5.0, 7.0]), gap=[1.0, -1.0]
    )
    modes = fc.solve_modes(structure, 1, lips="tied")
    assert modes.omega[0] == pytest.approx(np.sqrt(12.0 / 5.0), rel=1e-14)
    np.testing.assert_allclose(modes.shapes, np.full((2, 1), 5.0**-0.5), rtol=1e-14)


def test_ties_that_repeat_each_other() -> None:
    """A pair given twice, and its half, tie no more than the pair does."""
    stiffness, gap = held_chain()
    repeated_rows = np.column_stack([gap, gap, 0.5 * gap])
    structure = fc.Structure.from_matrices(np.eye(13), stiffness, gap=repeated_rows)
    omega = fc.solve_modes(structure, 12, lips="tied").omega
    np.testing.assert_allclose(omega, np.repeat(half_chain(), 2), rtol=1e-10)


def test_ties_hold_a_floating_part() -> None:
    """Two masses that nothing holds: a tie to the ground holds one, and a spring then the other."""
    free_stiffness = np.array([[1.0, -1.0], [-1.0, 1.0]])
    half_clamped_structure = fc.Structure.from_matrices(np.eye(2), free_stiffness, gap=[1.0, 0.0])
    assert fc.solve_modes(half_clamped_structure, 1, lips="tied").omega[0] == pytest.approx(
        1.0, rel=1e-12
    )
    joined_structure = fc.Structure.from_matrices(np.eye(2), free_stiffness, gap=[1.0, -1.0])
    assert fc.solve_modes(joined_structure, 1, lips="tied").omega[0] == pytest.approx(0.0, abs=1e-7)


@pytest.mark.parametrize("unconstrained", [False, True])
def test_null_space_of_the_pairs(unconstrained: bool) -> None:
    """The eigenvalues of K on an orthonormal basis of B^T u = 0, by LAPACK."""
    structure = chain(n=10, pairs=3, unconstrained=unconstrained)
    space = scipy.linalg.null_space(structure.gap.T.toarray())
    matrices = (space.T @ dense(part) @ space for part in (structure.stiffness, structure.mass))
    squares = scipy.linalg.eigvalsh(*matrices)
    modes = fc.solve_modes(structure, 7, lips="tied")
    np.testing.assert_allclose(modes.omega**2, squares, rtol=1e-9, atol=1e-9)


def test_without_pairs_tied_is_open() -> None:
    """Nothing to tie."""
    structure = fc.Structure.from_matrices(np.eye(13), held_chain()[0], gap=None)
    bonded_omega, open_omega = (
        fc.solve_modes(structure, 3, lips=lips).omega for lips in ("tied", "open")
    )
    np.testing.assert_array_equal(bonded_omega, open_omega)


# --- plates ---------------------------------------------------------------------------------------
def test_plate_tied_in_both_directions_is_uncracked(paper_scene: fc.Scene) -> None:
    """Lips that can neither part nor slide are those of the plate without a crack on the same mesh;
    lips that slide are softer, and springs of 1e13 N/m nearly reach them."""
    plate = fc.build_structure(paper_scene)
    normal = plate.gap.toarray()
    nodes = plate.nodes
    sliding_rows = np.zeros_like(normal)
    for sign in (1.0, -1.0):
        (dof,) = np.flatnonzero(normal == sign)
        ((node, component),) = np.argwhere(nodes.dofs == dof)
        assert component == 1
        sliding_rows[nodes.dofs[node, 0]] = sign
    glued_plate = fc.Structure.from_matrices(
        dense(plate.mass), dense(plate.stiffness), gap=np.hstack([normal, sliding_rows])
    )
    full_structure = fc.build_structure(paper_scene.replace({"crack": None, "contact": None}))
    uncracked_omega = fc.solve_modes(full_structure, 6).omega
    np.testing.assert_allclose(
        fc.solve_modes(glued_plate, 6, lips="tied").omega, uncracked_omega, rtol=1e-10
    )
    bonded_modes = fc.solve_modes(plate, 6, lips="tied")
    assert np.all(fc.solve_modes(plate, 6).omega < bonded_modes.omega)
    assert np.all(bonded_modes.omega < uncracked_omega)
    np.testing.assert_allclose(plate.apply_bt(bonded_modes.shapes.T), 0.0, atol=1e-12)
    np.testing.assert_allclose(
        fc.solve_modes(plate.tied(1e13), 6).omega, bonded_modes.omega, rtol=1e-5
    )


@pytest.mark.parametrize(("method", "error"), [("massless", 1e-4), ("free_interface", 1e-6)])
def test_reduced_plate(breathing_plate: fc.Structure, method: str, error: float) -> None:
    """20 modes know the first tied frequency; their pairs are at rest relative to each other."""
    exact = fc.solve_modes(breathing_plate, 3, lips="tied").omega
    reduced_structure = fc.reduce_structure(breathing_plate, modes=20, method=method)
    modes = fc.solve_modes(reduced_structure, 3, lips="tied")
    np.testing.assert_allclose(modes.omega[0], exact[0], rtol=error)
    np.testing.assert_allclose(modes.omega, exact, rtol=1e-3)
    np.testing.assert_allclose(reduced_structure.apply_bt(modes.shapes.T), 0.0, atol=1e-12)


@pytest.mark.parametrize("modes", [4, 10, 13])
def test_massless_with_ties_that_repeat_each_other(modes: int) -> None:
    """A pair given twice, its half, and the sum of two pairs tie no more than the two pairs do."""
    stiffness, middle = held_chain()
    relative = np.eye(13)[:, 3] - np.eye(13)[:, 4]
    independent = np.column_stack([middle, relative])
    dependent = np.column_stack([middle, relative, middle, 0.5 * middle, middle + relative])
    omega = []
    for gap in (independent, dependent):
        full_structure = fc.Structure.from_matrices(np.eye(13), stiffness, gap=gap)
        reduced_structure = fc.reduce_structure(
            full_structure, modes=modes, method="massless", reference=False
        )
        omega.append(fc.solve_modes(reduced_structure, 2, lips="tied").omega)
    exact = fc.solve_modes(full_structure, 2, lips="tied").omega
    np.testing.assert_allclose(omega[1], omega[0], rtol=1e-9)
    np.testing.assert_allclose(omega[1], exact, rtol=1e-9 if modes == 13 else 0.05)


def test_massless_oscillator_held_by_its_pair() -> None:
    """Its only motion is held: no frequency is left."""
    reduced_structure = fc.reduce_structure(
        oscillator(), modes=1, method="massless", reference=False
    )
    catch_error(lambda: fc.solve_modes(reduced_structure, 1, lips="tied"), "count", 1, names="= 0$")


# --- two ranks, bad input -------------------------------------------------------------------------
def tied_modes(scene: fc.Scene, comm: MPI.Comm) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies with tied lips, and the closing of the pairs in their shapes."""
    plate = fc.build_structure(scene, comm)
    modes = fc.solve_modes(plate, 4, lips="tied")
    return modes.omega, plate.apply_bt(modes.shapes.T)


def test_same_on_two_ranks(paper_scene: fc.Scene, on_ranks: Callable[..., Any]) -> None:
    """The multipliers are on the last rank."""
    scene = paper_scene.replace({"mesh.columns": 8, "mesh.rows": 10})
    parallel, serial = on_ranks(tied_modes, scene), tied_modes(scene, MPI.COMM_SELF)
    np.testing.assert_allclose(parallel[0], serial[0], rtol=1e-9)
    np.testing.assert_allclose(parallel[1], 0.0, atol=1e-12)


@pytest.mark.parametrize("lips", ["closed", "", None, 3])
def test_unknown_lips(lips: Any) -> None:
    """Open or tied, nothing else."""
    stiffness, gap = held_chain()
    catch_error(
        lambda: fc.solve_modes(
            fc.Structure.from_matrices(np.eye(13), stiffness, gap=gap), 1, lips=lips
        ),
        "lips",
        lips,
        names="'open', 'tied'",
    )


@pytest.mark.parametrize("count", [0, 13, 2.5])
def test_as_many_modes_as_are_left(count: Any) -> None:
    """Each pair takes one."""
    stiffness, gap = held_chain()
    structure = fc.Structure.from_matrices(np.eye(13), stiffness, gap=gap)
    catch_error(
        lambda: fc.solve_modes(structure, count, lips="tied"),
        "count",
        count,
        names="= 12$" if isinstance(count, int) else None,
    )


# --- between open and tied ------------------------------------------------------------------------
def test_bilinear_frequency_of_two_springs() -> None:
    """One half of a period in each state: T = pi / w_o + pi / w_t; a stop
    leaves half of 2 pi / w_o."""
    pair = fc.Structure.from_matrices(np.diag([2.0, 3.0]), np.diag([5.0, 7.0]), gap=[1.0, -1.0])
    frequencies = fc.bilinear_frequencies(pair)
    is_open = np.sort(np.sqrt([5.0 / 2.0, 7.0 / 3.0]))
    np.testing.assert_allclose(frequencies.omega_open, is_open, rtol=1e-12)
    np.testing.assert_allclose(frequencies.omega_tied, [np.sqrt(2.4), np.inf], rtol=1e-12)
    period = np.pi / is_open + np.pi / frequencies.omega_tied
    np.testing.assert_allclose(frequencies.omega_bilinear, 2.0 * np.pi / period, rtol=1e-12)
    single_frequencies = fc.bilinear_frequencies(
        fc.Structure.from_matrices([[1.0]], [[4.0]], gap=[1.0])
    )
    np.testing.assert_allclose(single_frequencies.omega_bilinear, [4.0])
    assert fc.bilinear_frequencies(pair.varied(load=2.0)) is frequencies


def overtaking() -> fc.Structure:
    """A mass of 1 on a spring of 1 that a pair ties to one of 0.05 on a spring of 3.2, and another
    alone, of frequency 1.5: the first has 1 open and, tied, 2 = sqrt(4.2 / 1.05)."""
    mass, stiffness = np.diag([1.0, 0.05, 1.0]), np.diag([1.0, 3.2, 2.25])
    return fc.Structure.from_matrices(mass, stiffness, gap=[1.0, -1.0, 0.0])


def test_open_and_tied_modes_are_of_one_shape() -> None:
    """Also where the tie takes a mode past another one; of equal frequencies, whose shapes are any
    of a space, and of shapes that a tie mixes, the order is that of their numbers."""
    frequencies = fc.bilinear_frequencies(overtaking())
    np.testing.assert_allclose(frequencies.omega_open, [1.0, 1.5, 8.0], rtol=1e-9)
    np.testing.assert_allclose(frequencies.omega_tied, [2.0, 1.5, np.inf], rtol=1e-9)
    np.testing.assert_allclose(frequencies.omega_bilinear, [4.0 / 3.0, 1.5, 16.0], rtol=1e-9)
    for seed in range(4):  # two masses alike, each tied to another one; turned to be one space
        rotation = scipy.linalg.block_diag(
            *2 * [np.linalg.qr(np.random.default_rng(seed).normal(size=(2, 2)))[0]]
        )
        stiffness = rotation @ np.diag([1.0, 1.0, 4.0, 9.0]) @ rotation.T
        gap = rotation @ np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
        twins = fc.bilinear_frequencies(fc.Structure.from_matrices(np.eye(4), stiffness, gap=gap))
        np.testing.assert_allclose(twins.omega_open, [1.0, 1.0, 2.0, 3.0], rtol=1e-9)
        np.testing.assert_allclose(twins.omega_tied[:2], np.sqrt([2.5, 5.0]), rtol=1e-9)


def test_shapes_without_a_match_keep_their_order() -> None:
    """A bond that mixes three modes evenly, I - 2/3 everywhere, leaves no shape of theirs."""
    structure = fc.Structure.from_matrices(np.eye(3), np.diag([1.0, 4.0, 9.0]), gap=None)
    is_open = fc.solve_modes(structure, 3)
    mixed_shapes = is_open.shapes @ (np.eye(3) - 2.0 / 3.0)
    bonded_modes = fc.Modes(1.5 * is_open.omega, mixed_shapes, structure)
    assert find_bonded_mode_indices(is_open, bonded_modes).tolist() == [0, 1, 2]


def test_no_tie_makes_a_mode_slower() -> None:
    """A heavy mass on a light one, tied: the light one's motion that is left is nearly the second
    mode's, but slower, so that it is what the tie makes of the first one."""
    stiffness = np.array([[2.0, -1.0], [-1.0, 1.0]])
    structure = fc.Structure.from_matrices(np.diag([1.0, 10.0]), stiffness, gap=[0.0, 1.0])
    frequencies = fc.bilinear_frequencies(structure)
    assert frequencies.omega_open[1] > np.sqrt(2.0) > frequencies.omega_open[0]
    np.testing.assert_allclose(frequencies.omega_tied, [np.sqrt(2.0), np.inf], rtol=1e-9)


def test_nearest_mode() -> None:
    """Of each load frequency the mode whose bilinear frequency is nearest, and the ratios to it."""
    frequencies = fc.BilinearFrequencies(np.array([1.0, 10.0, 20.0]), np.array([3.0, 10.0, np.inf]))
    np.testing.assert_allclose(frequencies.omega_bilinear, [1.5, 10.0, 40.0])
    nearest_modes = frequencies.nearest([1.2, 9.0, 30.0])
    np.testing.assert_array_equal(nearest_modes["mode"], [1, 2, 3])
    np.testing.assert_allclose(nearest_modes["over_open"], [1.2, 0.9, 1.5])
    np.testing.assert_allclose(nearest_modes["over_tied"], [0.4, 0.9, 0.0])
    np.testing.assert_allclose(nearest_modes["over_bilinear"], [0.8, 0.9, 0.75])
    assert frequencies.nearest(1.2)["mode"] == 1
    assert "3 modes, first 1 open, 3 rad/s bonded" in repr(frequencies)
    assert frequencies.table().columns[1] == "omega_open [rad/s]"


def test_rigid_body_has_no_bilinear_frequency() -> None:
    """0 open and 0 tied: 0, without a warning; over it nothing is finite."""
    free_stiffness = np.array([[1.0, -1.0], [-1.0, 1.0]])
    frequencies = fc.bilinear_frequencies(
        fc.Structure.from_matrices(np.eye(2), free_stiffness, gap=[1.0, -1.0])
    )
    np.testing.assert_allclose(frequencies.omega_bilinear[0], 0.0, atol=1e-7)
