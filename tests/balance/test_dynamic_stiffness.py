"""Dynamic stiffness inverted, against dense complex matrices and modal sums."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import scipy.linalg
from helpers import chain, dense, dense_matrices, relative
from mpi4py import MPI

import fenics_crack as fc
from fenics_crack import (
    ConvergenceError,
    InputError,
    ModalDamping,
    RayleighDamping,
    Scene,
    Structure,
    build_structure,
    solve_modes,
)
from fenics_crack.balance.compliance import DEFLATION_BAND, DynamicStiffness, dynamic_compliance
from fenics_crack.basics.ranks import gather_rows
from fenics_crack.model.modes import damped_modes, times

N, PAIRS = 12, 3


def with_frequencies(omega: np.ndarray, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Mass and stiffness, full, with given natural frequencies."""
    n = len(omega)
    shapes = np.eye(n) + 0.3 / np.sqrt(n) * np.random.default_rng(seed).standard_normal((n, n))
    inverse = np.linalg.inv(shapes)
    mass, stiffness = inverse.T @ inverse, inverse.T @ np.diag(omega**2) @ inverse
    return (mass + mass.T) / 2.0, (stiffness + stiffness.T) / 2.0


def random_structure(damping: Any = None, seed: int = 0) -> Structure:
    """A structure of N dofs with natural frequencies from 1 to 30 rad/s."""
    rng = np.random.default_rng(seed)
    omega = np.sort(rng.uniform(1.0, 30.0, N))
    gap = rng.standard_normal((N, PAIRS))
    return Structure.from_matrices(*with_frequencies(omega, seed), gap, damping=damping)


def dense_stiffness(structure: Structure, omega: float) -> np.ndarray:
    """Z = K - omega^2 M + i omega C, from dense matrices."""
    mass, damping, stiffness = dense_matrices(structure)
    return stiffness - omega**2 * mass + 1j * omega * damping


def applied(structure: Structure, omega: float, amplitude: np.ndarray) -> np.ndarray:
    """Z u of amplitudes (m, n_local), from the distributed matrices (collective)."""

    def product(matrix: Any) -> np.ndarray:
        return (times(matrix, amplitude.real.T) + 1j * times(matrix, amplitude.imag.T)).T

    found = product(structure.stiffness) - omega**2 * product(structure.mass)
    if structure.damping_matrix is not None:
        found += 1j * omega * product(structure.damping_matrix)
    if (modes := damped_modes(structure)) is not None:
        modal = structure.sum_over_ranks(amplitude @ modes.mass_shapes)
        found += 1j * omega * (modal * modes.rate) @ modes.mass_shapes.T
    return found


def modal_sum(structure: Structure, omega: float, rigid: int = 0) -> np.ndarray:
    """Z^-1 where all modes are damped: sum of phi phi^T / (omega_j^2 - omega^2 + ...).

    Nothing cancels in it, and nothing in it is nearly singular, however close omega is to omega_j.
    The first so many modes are rigid: their frequency is 0.
    """
    squares, shapes = scipy.linalg.eigh(dense(structure.stiffness), dense(structure.mass))
    squares[:rigid] = 0.0
    assert isinstance(structure.damping, ModalDamping) and structure.damping.modes is None
    rate = 2.0 * np.asarray(structure.damping.ratio) * np.sqrt(squares)
    return (shapes / (squares - omega**2 + 1j * omega * rate)) @ shapes.T


def relative_error(found: np.ndarray, expected: np.ndarray) -> float:
    """Largest difference, relative to the largest entry."""
    return float(np.abs(found - expected).max() / np.abs(expected).max())


RNG = np.random.default_rng(7)
DAMPINGS = {
    "none": None,
    "all modes": ModalDamping(0.02),
    "all modes, a ratio each": ModalDamping(RNG.uniform(0.0, 0.1, N).tolist()),
    "four modes": ModalDamping(0.02, 4),
    "four modes, a ratio each": ModalDamping([0.01, 0.0, 0.03, 0.1], 4),
    "Rayleigh": RayleighDamping(0.3, 0.002),
    "symmetric matrix": np.eye(N) + 0.1,
    "any matrix": RNG.standard_normal((N, N)),
}


# --- against dense matrices -----------------------------------------------------------------------
@pytest.mark.drawn(10)
@pytest.mark.parametrize("omega", [0.0, 0.5, 7.77, 20.0, 300.0])
@pytest.mark.parametrize("damping", DAMPINGS.values(), ids=DAMPINGS)
def test_against_dense_matrices(damping: Any, omega: float) -> None:
    """Z u, Z^-1 f and B^T Z^-1 B are those of the dense matrix, for real and complex amplitudes."""
    for seed in range(3):
        structure = random_structure(damping, seed)
        matrix = dense_stiffness(structure, omega)
        gap = structure.gap.toarray()
        rng = np.random.default_rng(seed)
        real = rng.standard_normal((4, N))
        with DynamicStiffness(structure, omega) as stiffness:
            for rows in (real, real + 1j * rng.standard_normal((4, N)), real[:1]):
                assert relative_error(applied(structure, omega, rows), rows @ matrix.T) < 1e-12
                expected = np.linalg.solve(matrix, rows.T).T
                assert relative_error(stiffness.solve(rows), expected) < 1e-10
            expected = gap.T @ np.linalg.solve(matrix, gap)
            assert relative_error(stiffness.compliance(), expected) < 1e-10


@pytest.mark.parametrize("damping", [None, ModalDamping(0.001), ModalDamping(0.001, 10)])
@pytest.mark.parametrize("omega", [0.0, 1000.0, 2000.0, 10000.0])
def test_paper_plate_against_dense_matrices(
    paper_structure: Structure, damping: ModalDamping | None, omega: float
) -> None:
    """The same on the paper's plate, sparse, with its load and between its resonances."""
    structure = paper_structure.damped(damping)
    matrix = dense_stiffness(structure, omega)
    gap = structure.gap.toarray()
    with DynamicStiffness(structure, omega) as stiffness:
        found = stiffness.solve(structure.force)
        assert relative_error(found, np.linalg.solve(matrix, structure.force.T).T) < 1e-10
        assert relative_error(applied(structure, omega, found), found @ matrix.T) < 1e-12
        expected = gap.T @ np.linalg.solve(matrix, gap)
        assert relative_error(stiffness.compliance(), expected) < 1e-10


@pytest.mark.parametrize("damping", DAMPINGS.values(), ids=DAMPINGS)
def test_symmetry_of_the_compliance(damping: Any) -> None:
    """Reciprocity: R = R^T, but for a damping matrix that is not symmetric itself."""
    with DynamicStiffness(random_structure(damping), 7.77) as stiffness:
        compliance = stiffness.compliance()
    asymmetry = relative_error(compliance, compliance.T)
    if isinstance(damping, np.ndarray) and not np.array_equal(damping, damping.T):
        assert asymmetry > 1e-3
    else:
        assert asymmetry < 1e-10


def test_dissipation() -> None:
    """Damping takes energy out: the imaginary part of f^T Z^-1 f is negative for every f."""
    for damping in (ModalDamping(0.02), np.eye(N)):
        with DynamicStiffness(random_structure(damping), 7.77) as stiffness:
            work = stiffness.compliance().imag
        assert np.linalg.eigvalsh((work + work.T) / 2.0).max() < 0.0


# --- at and near natural frequencies --------------------------------------------------------------
OFFSETS = [
    0.0, 1e-15, -1e-15, 1e-12, 1e-8, -1e-8, 1e-5, 9e-4, 1.1e-3, -1.1e-3, 0.49 * DEFLATION_BAND,
    0.51 * DEFLATION_BAND, -0.51 * DEFLATION_BAND, 0.1,
]  # fmt: skip


def check_near_resonance(structure: Structure, mode: int, offset: float) -> None:
    """Z^-1 f and B^T Z^-1 B within 1e-8 where omega is relatively ``offset`` off a resonance."""
    omega = float(solve_modes(structure, mode + 1).omega[mode]) * (1.0 + offset)
    inverse = modal_sum(structure, omega)
    rng = np.random.default_rng(mode)
    gap = structure.gap.toarray()
    force = rng.standard_normal((2, structure.n_dofs)) + 1j * rng.standard_normal(structure.n_dofs)
    with DynamicStiffness(structure, omega) as stiffness:
        assert relative_error(stiffness.solve(force), force @ inverse.T) < 1e-8
        assert relative_error(stiffness.compliance(), gap.T @ inverse @ gap) < 1e-8


@pytest.mark.drawn(10)
@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("ratio", [0.1, 0.001])
def test_near_a_resonance(ratio: float, offset: float) -> None:
    """Nothing is lost to cancellation, at a resonance or close to it."""
    for mode in (0, 5, N - 1):
        check_near_resonance(random_structure(ModalDamping(ratio)), mode, offset)


@pytest.mark.drawn(10)
@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("ratio", [0.1, 0.001])
def test_paper_plate_near_a_resonance(
    paper_structure: Structure, ratio: float, offset: float
) -> None:
    """The same on the paper's plate, at its first, second and tenth frequency."""
    for mode in (0, 1, 9):
        check_near_resonance(paper_structure.damped(ModalDamping(ratio)), mode, offset)


@pytest.mark.drawn(10)
@pytest.mark.parametrize("offset", OFFSETS)
@pytest.mark.parametrize("split", [0.0, 1e-12, 1e-7, 1e-3])
def test_near_several_resonances_at_once(split: float, offset: float) -> None:
    """A double frequency, and frequencies that nearly coincide, three of them."""
    omega = np.linspace(1.0, 20.0, N)
    omega[3:6] = omega[4] * np.array([1.0 - split, 1.0, 1.0 + split])
    gap = np.random.default_rng(0).standard_normal((N, PAIRS))
    structure = Structure.from_matrices(*with_frequencies(omega), gap, damping=ModalDamping(0.01))
    for mode in (3, 5):
        check_near_resonance(structure, mode, offset)


def test_near_resonances_with_different_damping() -> None:
    """Neighbours within the band keep the damping ratio of each."""
    omega = np.linspace(1.0, 20.0, N)
    omega[4] = omega[3] * (1.0 + 1e-4)
    ratios = np.linspace(0.001, 0.1, N)
    structure = Structure.from_matrices(
        *with_frequencies(omega), np.eye(N)[:, :PAIRS], damping=ModalDamping(ratios)
    )
    for offset in OFFSETS:
        check_near_resonance(structure, 3, offset)


@pytest.mark.parametrize("offset", OFFSETS)
def test_near_a_resonance_of_the_damped_modes_alone(offset: float) -> None:
    """With few damped modes: LAPACK's solution of the dense system, which damping keeps regular."""
    structure = random_structure(ModalDamping([0.05, 0.02, 0.03, 0.1], 4))
    omega = float(solve_modes(structure, 2).omega[1]) * (1.0 + offset)
    matrix = dense_stiffness(structure, omega)
    force = np.random.default_rng(1).standard_normal((3, N))
    with DynamicStiffness(structure, omega) as stiffness:
        expected = np.linalg.solve(matrix, force.T).T
        assert relative_error(stiffness.solve(force), expected) < 1e-8


def test_deflated_undamped_mode() -> None:
    """Close to an undamped resonance the response is phi phi^T f / (omega_j^2 - omega^2)."""
    omega = np.arange(1.0, N + 1.0)
    ratios = np.where(omega == 3.0, 0.0, 0.01)
    structure = Structure.from_matrices(
        np.eye(N), np.diag(omega**2), np.ones(N), damping=ModalDamping(ratios)
    )
    near = 3.0 * (1.0 + 2.0**-20)
    with DynamicStiffness(structure, near) as stiffness:
        found = stiffness.solve(np.eye(N))
    denominators = omega**2 - near**2 + 2j * ratios * omega * near
    denominators[2] = (3.0 - near) * (3.0 + near)
    np.testing.assert_allclose(found, np.diag(1.0 / denominators), rtol=1e-8, atol=1e-9)


# --- refused --------------------------------------------------------------------------------------
@pytest.mark.parametrize("damping", [None, ModalDamping(0.01), np.eye(N)])
def test_free_structure(damping: Any) -> None:
    """A structure that can move as a rigid body has no static answer, and one at a frequency."""
    omega = np.append([0.0, 0.0], np.linspace(1.0, 20.0, N - 2))
    structure = Structure.from_matrices(*with_frequencies(omega), np.ones(N), damping=damping)
    with pytest.raises(ConvergenceError, match="rigid body"):
        DynamicStiffness(structure, 0.0)
    if isinstance(damping, ModalDamping):
        inverse = modal_sum(structure, 0.3, rigid=2)
    else:
        inverse = np.linalg.inv(dense_stiffness(structure, 0.3))
    with np.errstate(all="raise"), DynamicStiffness(structure, 0.3) as stiffness:
        assert relative_error(stiffness.solve(np.eye(N)), inverse.T) < 1e-6


def test_a_light_stiff_part_is_no_rigid_body() -> None:
    """A sensor of 1e-9 kg on a mass, whose own frequency is 1e8 times the mass's: the static
    answer is the spring's."""
    mass, own = 1e-9, 1e7
    stiffness = np.array([[1.0 + own, -own], [-own, own]])
    sensor = Structure.from_matrices(np.diag([1.0, mass]), stiffness, [1.0, 0.0], damping=None)
    compliance = dynamic_compliance(sensor, 0.5, 1)
    assert compliance.matrices[:, 0, 0].real == pytest.approx([1.0, 1.0 / 0.75], rel=1e-6)


@pytest.mark.parametrize("mode", [0, 4, N - 1])
def test_undamped_resonance(mode: int) -> None:
    """At a natural frequency that is exactly known, without damping, there is no answer."""
    omega = np.arange(1.0, N + 1.0)
    structure = Structure.from_matrices(np.eye(N), np.diag(omega**2), np.ones(N))
    with pytest.raises(ConvergenceError, match="undamped resonance"):
        DynamicStiffness(structure, omega[mode])


@pytest.mark.parametrize("mode", [0, 1, 9])
def test_resonance_of_an_undamped_mode(paper_structure: Structure, mode: int) -> None:
    """At the natural frequency of a mode whose ratio is 0 the frequency is refused."""
    omega = solve_modes(paper_structure, 50).omega
    ratios = np.full(50, 0.01)
    ratios[mode] = 0.0
    for damping in (ModalDamping(0.0), ModalDamping(ratios)):
        with pytest.raises(InputError, match="undamped") as caught:
            DynamicStiffness(paper_structure.damped(damping), omega[mode])
        assert caught.value.key == "omega"


@pytest.mark.parametrize("omega", [-1.0, np.nan, np.inf])
def test_frequency_that_cannot_be(omega: float) -> None:
    """A frequency is finite and not negative."""
    with pytest.raises(InputError) as caught:
        DynamicStiffness(random_structure(), omega)
    assert caught.value.key == "omega"


# --- several ranks --------------------------------------------------------------------------------
def responses(scene: Scene, cases: list[Any], comm: MPI.Comm) -> list[Any]:
    """Static compliance and the load's response at the nodes by position (collective)."""
    built = build_structure(scene, comm)
    assert built.nodes is not None
    local = built.nodes.dofs - np.where(built.nodes.dofs >= 0, built.first_dof, 0)
    lip = np.append(built.gap.toarray().sum(axis=1), 0.0)[local[:, 1]]  # clamped: number -1
    places = gather_rows(comm, np.column_stack([built.nodes.points.round(9), lip.round(9)]))
    order = np.lexsort(places.T)
    found = []
    for ratio, modes, omega in cases:
        damping = None if ratio is None else ModalDamping(ratio, modes)
        damped = built.damped(damping)
        with DynamicStiffness(damped, omega) as stiffness:
            response = stiffness.solve(built.force.astype(complex))
            back = applied(damped, omega, response)
            compliance = stiffness.compliance()
        shape = gather_rows(comm, np.append(response[2], 0.0)[local])[order]
        residual = comm.allreduce(np.abs(back - built.force).max(), MPI.MAX)
        found.append({"shape": shape, "compliance": compliance, "residual": residual})
    return found


@pytest.mark.mpi
def test_two_ranks_give_the_same_responses(
    on_ranks: Callable[..., Any], paper_scene: Scene, paper_structure: Structure
) -> None:
    """Response and compliance of the paper's plate, at a resonance too, are those of one rank."""
    first, second = solve_modes(paper_structure, 2).omega
    cases = [
        (None, None, 0.0),
        (None, None, 2000.0),
        (0.001, None, 2000.0),
        (0.001, 10, 2000.0),
        (0.01, None, float(first)),
        (0.01, None, float(second) * (1.0 + 1e-4)),
    ]
    parallel = on_ranks(responses, paper_scene, cases)
    for two, one in zip(parallel, responses(paper_scene, cases, MPI.COMM_SELF), strict=True):
        for name in ("shape", "compliance"):
            assert relative_error(two[name], one[name]) < 1e-8
        assert two["residual"] < 1e-6 and one["residual"] < 1e-6  # of a load of 100 N


def compliances(kinds: list[str], comm: MPI.Comm) -> list[np.ndarray]:
    """B^T Z^-1 B with some kinds of damping (collective)."""
    found = []
    for kind in kinds:
        one = random_structure(damping := DAMPINGS[kind])
        mass, _, stiffness = dense_matrices(one)
        spread = Structure.from_matrices(mass, stiffness, one.gap, damping=damping, comm=comm)
        with DynamicStiffness(spread, 7.77) as dynamic:
            found.append(dynamic.compliance())
    return found


@pytest.mark.mpi
def test_damping_matrix_on_two_ranks(on_ranks: Callable[..., Any]) -> None:
    """Spread over two ranks, one that is not symmetric and Rayleigh's give the dense compliance."""
    kinds = ["any matrix", "Rayleigh"]
    for kind, found in zip(kinds, on_ranks(compliances, kinds), strict=True):
        structure = random_structure(DAMPINGS[kind])
        gap = structure.gap.toarray()
        expected = gap.T @ np.linalg.solve(dense_stiffness(structure, 7.77), gap)
        assert relative_error(found, expected) < 1e-10


def test_reduced_chain_that_is_not_fixed() -> None:
    """A chain that is not fixed: K is singular; compliance at w > 0, and the linear response."""
    for damping in ("matrix", "none"):
        whole = chain(damping, 60, unconstrained=True)
        elastic = fc.solve_modes(whole, 2).omega
        assert elastic[0] < 1e-4 * elastic[1]
        previous = np.inf
        for modes in (6, 12, 40):
            reduced = fc.reduce_structure(whole, modes=modes)
            errors = []
            for factor in (0.5, 1.3, 2.5):
                omega = factor * elastic[1]
                with (
                    DynamicStiffness(reduced, omega) as small,
                    DynamicStiffness(whole, omega) as large,
                ):
                    errors.append(relative(small.compliance(), large.compliance()))
            assert max(errors) < previous
            previous = max(errors)
        assert previous < 1e-5
        dofs = list(range(whole.n_dofs))
        motions = [
            fc.solve_linear(made, 1.3 * elastic[1]).coefficients_at(dofs)
            for made in (reduced, whole)
        ]
        assert relative(*motions) < 1e-3
