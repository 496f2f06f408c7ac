"""The basis of the flow while pairs stay closed."""

from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from helpers import chain, chain_stiffness, oscillator, relative

import fenics_crack as fc
from fenics_crack.model.modal import all_modes, flow_matrix
from fenics_crack.stability import eigenbasis as module
from fenics_crack.stability.eigenbasis import eigenbasis, undamped_modes
from fenics_crack.stability.piecewise_flow import PiecewiseFlow


def repeated_frequencies() -> fc.Structure:
    """Three pairs of equal masses and springs, with a stop at two of them."""
    stiffness = np.kron(chain_stiffness(np.ones(4)), np.eye(2))
    gap = np.zeros((6, 2))
    gap[0, 0] = gap[3, 1] = 1.0
    return fc.Structure.from_matrices(
        np.eye(6), stiffness, gap, force_cos=np.ones(6), damping=fc.ModalDamping(0.03)
    )


def check(structure: fc.Structure, stiffness: float, closed: Any) -> None:
    """Eigenvalues and flow against LAPACK's and the exponential, to 1e-10."""
    modes = all_modes(structure)
    springs = stiffness * np.array(closed, dtype=float)
    scale = float(np.sqrt(modes.squares.max()))
    basis = eigenbasis(modes, springs, scale, undamped_modes(modes, springs))
    assert basis is not None
    matrix = flow_matrix(modes, springs, scale)
    values = basis.decay + 1j * basis.turn
    exact = np.linalg.eigvals(matrix)
    distance = np.abs(values[:, None] - exact)
    nearest = scipy.optimize.linear_sum_assignment(distance)[1]  # each once, repeated ones too
    assert np.abs(values / exact[nearest] - 1.0).max() < 1e-10
    time = 2.0 * np.pi / np.sqrt(modes.squares.min())
    moved = basis.vectors @ basis.advance(time, basis.inverse)
    assert relative(moved, scipy.linalg.expm(time * matrix)) < 1e-10


@pytest.fixture
def no_lapack(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever is found comes from undamped modes."""
    monkeypatch.setattr(module, "_by_lapack", lambda matrix: None)


@pytest.mark.usefixtures("no_lapack")
@pytest.mark.parametrize("stiffness", [1e8, 1e11])
@pytest.mark.parametrize("ratio", [0.0, 0.001, 0.03, 0.2])
def test_paper_plate(paper_scene: fc.Scene, ratio: float, stiffness: float) -> None:
    """All 50 modes, from no damping to much."""
    plate = fc.build_structure(paper_scene.replace({"damping.ratio": ratio}))
    check(plate, stiffness, [False])
    check(plate, stiffness, [True])


@pytest.mark.usefixtures("no_lapack")
@pytest.mark.parametrize("damping", ["modal", "matrix", "few modes", "none"])
def test_chain_with_three_pairs(damping: str) -> None:
    """Any damping that is symmetric, any pairs closed."""
    structure = chain(damping)
    for closed in ([0, 0, 0], [1, 0, 0], [0, 1, 1], [1, 1, 1]):
        check(structure, 7.0, closed)


@pytest.mark.usefixtures("no_lapack")
def test_repeated_frequencies() -> None:
    """Modes of one frequency are not corrected by each other."""
    for closed in ([0, 0], [1, 0], [1, 1]):
        check(repeated_frequencies(), 5.0, closed)


def test_stiff_contact_leaves_low_modes_alone() -> None:
    """They are those of pairs that are tied, not lost in the rounding of the stiffest."""
    modes = all_modes(chain("none"))
    springs = np.full(3, 1e12)
    scale = float(np.sqrt(modes.squares.max()))
    basis = eigenbasis(modes, springs, scale, undamped_modes(modes, springs))
    assert basis is not None
    tied = scipy.linalg.null_space(modes.pairs.T)
    exact = np.sqrt(np.linalg.eigvalsh((tied.T * modes.squares) @ tied))
    assert np.sort(basis.turn)[-10:][:7] == pytest.approx(exact, rel=1e-11)


def test_what_undamped_modes_do_not_lead_to(monkeypatch: pytest.MonkeyPatch) -> None:
    """Modes that do not oscillate, and damping that is not symmetric: LAPACK's eigenvectors."""
    asked, lapack = [], module._by_lapack
    monkeypatch.setattr(
        module, "_by_lapack", lambda matrix: asked.append(len(matrix)) or lapack(matrix)
    )
    gyroscopic = np.array([[0.1, 0.3], [-0.3, 0.2]])
    spinning = fc.Structure.from_matrices(
        np.eye(2), np.diag([1.0, 2.0]), np.ones(2), force_cos=np.ones(2), damping=gyroscopic
    )
    for structure in (oscillator(2.5), spinning):
        check(structure, 3.0, [False])
        check(structure, 0.1, [True])
    assert asked == [2, 2, 4, 4]


def test_varied_flow(soft_plate: fc.Structure) -> None:
    """Other damping or stiffness: as computed anew, with the undamped modes that stay."""
    law = fc.UnilateralPenalty(1e9)
    solution = fc.solve_harmonic_balance(soft_plate, 2000.0, law, harmonics=10)
    flow, gap = PiecewiseFlow(soft_plate, law), solution.gap_coefficients
    first = flow.multipliers(gap, 2000.0)
    for structure, contact in (
        (soft_plate.varied(damping=0.4), law), (soft_plate, law.scaled(3.0)),
    ):  # fmt: skip
        found = flow.varied(structure, contact).multipliers(gap, 2000.0)
        exact = PiecewiseFlow(structure, contact).multipliers(gap, 2000.0)
        assert np.abs(found) == pytest.approx(np.abs(exact), rel=1e-10)
        assert abs(np.abs(found[0]) - np.abs(first[0])) > 1e-4
    assert np.abs(flow.multipliers(gap, 2000.0)) == pytest.approx(np.abs(first), rel=1e-14)


def test_damping_takes_no_new_eigensolution(
    soft_plate: fc.Structure, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A varied flow starts from the undamped modes that are known."""
    law = fc.UnilateralPenalty(1e9)
    gap = fc.solve_harmonic_balance(soft_plate, 2000.0, law, harmonics=10).gap_coefficients
    flow = PiecewiseFlow(soft_plate, law)
    flow.leading(gap, 2000.0)
    for name in ("eig", "eigh"):
        monkeypatch.setattr(np.linalg, name, None)
    flow.varied(soft_plate.varied(damping=0.4), law).monodromy(gap, 2000.0)
