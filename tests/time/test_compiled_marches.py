"""Exponential steps and marches in the kernel against NumPy; their energy and steady motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from helpers import DAMPINGS, catch_error, chain, dense_matrices, relative
from hypothesis import given, settings
from hypothesis import strategies as st

import fenics_crack as fc
from fenics_crack.model.contact import solve_complementarity
from fenics_crack.model.modal import all_modes
from fenics_crack.time import central_differences
from fenics_crack.time.flows import ExponentialFlow
from fenics_crack.time.march import MarchRequest, march

SEEDS = st.integers(0, 2**32 - 1)
KINDS = st.sampled_from(["none", "Rayleigh", "modal", "matrix"])


def random_structure(rng: np.random.Generator, dofs: int, pairs: int, damping: str) -> fc.Structure:
    """Full matrices, natural frequencies from about 0.5 to 3 rad/s, pairs that overlap, a load with
    a mean, and a motion of about 1 m."""
    root, basis = rng.normal(size=(dofs, dofs)), rng.normal(size=(dofs, dofs))
    mass = root @ root.T / dofs + np.eye(dofs)
    shapes = scipy.linalg.eigh(basis @ basis.T, mass)[1]
    mass_shapes = mass @ shapes
    stiffness = (mass_shapes * rng.uniform(0.25, 9.0, dofs)) @ mass_shapes.T
    root = rng.normal(size=(dofs, dofs))
    rule: Any = {
        "none": None,
        "Rayleigh": fc.RayleighDamping(0.05, 0.02),
        "modal": fc.ModalDamping(tuple(rng.uniform(0.01, 0.1, dofs))),
        "matrix": 0.05 * (root @ root.T),
    }[damping]
    return fc.Structure.from_matrices(
        mass, 0.5 * (stiffness + stiffness.T), gap=rng.normal(size=(dofs, pairs)),
        force_mean=0.3 * rng.normal(size=dofs), force_cos=rng.normal(size=dofs),
        force_sin=rng.normal(size=dofs), clearance=rng.uniform(0.0, 0.2, pairs), damping=rule,
    )  # fmt: skip


def scale_of(array: np.ndarray) -> float:
    """Largest number."""
    return float(np.abs(array).max(initial=1e-300))


def same(history: fc.TimeHistory, expected_history: fc.TimeHistory, tolerance: float) -> None:
    """Gaps, forces, motion, state and energy."""
    pairs = [
        (history.gap, expected_history.gap),
        (history.contact_force, expected_history.contact_force),
    ]
    pairs += [
        (history.recorded, expected_history.recorded),
        *zip(history.final_state, expected_history.final_state, strict=True),
    ]
    motion = scale_of(expected_history.recorded)
    for signal, expected_signal in pairs:
        size = max(scale_of(expected_signal), 1e-3 * motion)
        assert np.abs(signal - expected_signal).max(initial=0.0) <= tolerance * size
    assert history.created_energy == pytest.approx(
        expected_history.created_energy, abs=100.0 * tolerance
    )


# --- schemes of steps -----------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 9), st.integers(0, 4), KINDS, st.booleans(), SEEDS)
def test_central_differences(dofs: int, pairs: int, damping: str, rigid: bool, seed: int) -> None:
    """Two periods against steps with PETSc's matrices in the coordinates of the structure. Rounding
    of thousands of steps grows where pairs close, most without damping."""
    rng = np.random.default_rng(seed)
    pairs = min(pairs, dofs)
    structure = random_structure(rng, dofs, pairs, damping)
    law: Any = fc.UnilateralConstraint() if rigid else fc.UnilateralPenalty(20.0)
    steps = int(1.5 * fc.stable_steps_per_period(structure, 1.1, law))
    start = 0.3 * rng.normal(size=(2, dofs))
    march_options = MarchRequest(structure, 1.1, law, 2, steps, initial=(start[0], start[1]))
    makers: tuple[Any, ...] = (
        central_differences._ModalDifferences, central_differences._CentralDifferences
    )  # fmt: skip
    same(*(march(march_options, make_march(march_options)) for make_march in makers), 1e-10)  # type: ignore[misc]


# --- exponential steps ----------------------------------------------------------------------------


def by_exponentials(flow: ExponentialFlow, start: np.ndarray, steps: int) -> tuple[np.ndarray, ...]:
    """States and forces, by matrices of the whole flow."""
    modes = flow.modal_model
    count, pairs = modes.gaps_by_mode.shape
    damping = np.diag(modes.damping) if modes.damping.ndim == 1 else modes.damping
    system_matrix = np.zeros((2 * count + pairs,) * 2)
    system_matrix[:count, count : 2 * count] = np.eye(count)
    system_matrix[count : 2 * count, :count] = -np.diag(modes.squares)
    system_matrix[count : 2 * count, count : 2 * count] = -damping
    system_matrix[count : 2 * count, 2 * count :] = modes.gaps_by_mode
    exponential = scipy.linalg.expm(flow.step_size * system_matrix)
    state_transition, force_transition = (
        exponential[: 2 * count, : 2 * count],
        0.5 * exponential[: 2 * count, 2 * count :],
    )
    rows = flow.state_to_gap_matrix
    static_compliance = flow.residual_flexibility + np.diag(flow.contact_spring_compliance)
    compliance = static_compliance + rows @ force_transition

    state = start - flow.steady_states[0]
    force = solve_complementarity(static_compliance, rows @ state + flow.linear_gap[0])
    states, forces = [start], [force]
    for step in range(1, steps + 1):
        state = state_transition @ state - force_transition @ force
        phase = step % flow.steps_per_period
        force = solve_complementarity(compliance, rows @ state + flow.linear_gap[phase])
        state = state - force_transition @ force
        states.append(state + flow.steady_states[phase])
        forces.append(force)
    return np.array(states), np.array(forces)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 9), st.integers(0, 4), KINDS, st.sampled_from([7, 60]), SEEDS)
def test_exponential_steps(dofs: int, pairs: int, damping: str, steps: int, seed: int) -> None:
    """States and forces of two periods, mass at the lips."""
    rng = np.random.default_rng(seed)
    structure = random_structure(
        rng, dofs, min(pairs, dofs), damping if damping != "none" else "modal"
    )
    flow = ExponentialFlow(structure, 1.1, fc.UnilateralPenalty(20.0), steps)
    start = 0.3 * rng.normal(size=2 * len(flow.modal_model.squares))
    march = flow.advance(start, 2)
    states, forces = by_exponentials(flow, start, 2 * steps)
    assert np.abs(march.states - states).max() <= 1e-12 * scale_of(states) * steps
    assert np.abs(march.contact_forces_at_instants - forces).max(initial=0.0) <= 1e-11 * scale_of(
        forces
    )
    assert np.array_equal(march.is_closed, forces > 0.0)


# --- the flow by exponential steps ----------------------------------------------------------------


RIGID, PENALTY = fc.UnilateralConstraint(), fc.UnilateralPenalty(4.0)


def massless(damping: str = "modal", modes: int = 4, **options: Any) -> fc.Structure:
    """A chain of ten masses and three pairs, by some modes and the static rest."""
    return fc.reduce_structure(chain(damping, **options), modes=modes, method="massless")


# --- steps ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", DAMPINGS)
def test_product_of_multipliers_without_contact(damping: str) -> None:
    """exp(-T tr C), whatever the step (Liouville), for the damping of dense matrices."""
    structure = chain(damping).varied(clearance=1e3)
    mass, matrix, _ = dense_matrices(structure)
    determinant = np.exp(-2.0 * np.pi / 0.8 * np.trace(np.linalg.solve(mass, matrix)))
    for steps in (5, 64):
        flow = ExponentialFlow(structure, 0.8, PENALTY, steps)
        start, units = flow.steady_states[0], np.eye(len(flow.steady_states[0]))
        monodromy = [flow.advance(start + unit).states[-1] - start for unit in units]
        assert np.linalg.det(monodromy) == pytest.approx(determinant, rel=1e-9)


@pytest.mark.parametrize("case", ["rigid", "penalty", "stiff mass"])
def test_no_step_is_too_long(
    case: str, wide_plate: fc.Structure, paper_structure: fc.Structure
) -> None:
    """About a preload that keeps a set of pairs closed throughout, energy never grows from one step
    to the next, at 4 to 4096 steps a period."""
    structure, law = {
        "rigid": (fc.reduce_structure(wide_plate, modes=20, method="massless"), RIGID),
        "penalty": (fc.reduce_structure(wide_plate, modes=60, method="massless"), PENALTY),
        "stiff mass": (paper_structure, fc.UnilateralPenalty(1e11)),
    }[case]
    for count in {1, structure.n_pairs}:
        is_closed = np.arange(structure.n_pairs) < count
        flow = ExponentialFlow(structure, 2000.0, law, 4)
        squares, pairs = flow.modal_model.squares, flow.modal_model.gaps_by_mode
        compliance = flow.residual_flexibility + np.diag(flow.contact_spring_compliance)
        rest = -(pairs @ is_closed) / squares  # under unit forces of the closed pairs
        rest_clearance = (
            rest @ pairs - compliance @ is_closed + 1e9 * np.abs(rest @ pairs).max() * ~is_closed
        )
        pressed_structure = structure.varied(
            load=0.0, clearance=rest_clearance - structure.clearance
        )
        contact_stiffness = (
            pairs[:, is_closed]
            @ np.linalg.inv(compliance[np.ix_(is_closed, is_closed)])
            @ pairs[:, is_closed].T
        )
        min_compliance = np.linalg.eigvalsh(compliance[np.ix_(is_closed, is_closed)])[0]
        start = np.random.default_rng(2).normal(size=(2, len(squares)))
        start[0] /= np.sqrt(np.linalg.eigvalsh(np.diag(squares) + contact_stiffness)[-1])
        start *= np.sqrt(0.1 * min_compliance) / np.linalg.norm(
            start
        )  # no force falls by more than a half
        for steps in (4, 16, 32, 64, 128, 256, 512, 4096):
            march = ExponentialFlow(pressed_structure, 2000.0, law, steps).advance(
                np.concatenate([rest + start[0], start[1]])
            )
            assert np.all(march.is_closed == is_closed)
            shape, rate = np.split(march.states, 2, axis=1)
            deviation = shape - rest
            energy = (rate**2).sum(axis=1) + (
                deviation * (squares * deviation + deviation @ contact_stiffness)
            ).sum(axis=1)
            assert np.diff(energy).max() < 1e-9 * energy[0]


# --- steady motion --------------------------------------------------------------------------------


def test_gap_is_that_of_the_coordinates() -> None:
    """B^T u - g0 with contact, and g <= 0 without penetration, zero where there is a force."""
    structure = massless()
    flow = ExponentialFlow(structure, 0.8, RIGID, 50)
    steps = flow.advance(flow.steady_states[0], 3)
    motion = flow.displacement_from_phase_zero(
        steps.states[:-1], steps.contact_forces_at_instants[:-1]
    )
    assert relative(structure.apply_bt(motion) - structure.clearance, steps.gaps[:-1]) < 1e-10
    size = np.abs(steps.gaps[:-1]).max()
    assert steps.gaps[:-1].max() < 1e-12 * size and steps.contact_forces_at_instants.min() >= 0.0
    assert np.array_equal(steps.contact_forces_at_instants > 0.0, steps.is_closed)
    assert np.abs(steps.gaps[:-1][steps.is_closed[:-1]]).max() < 1e-12 * size
    assert 0.05 < steps.is_closed.mean() < 0.95


# --- arguments ------------------------------------------------------------------------------------


def test_what_cannot_be_marched() -> None:
    """A law that is not piecewise linear, many dofs, and a constraint of lips with mass."""
    smooth_law = fc.SmoothedPenalty(1.0, 1.0)
    catch_error(lambda: ExponentialFlow(massless(), 0.8, smooth_law, 8), "contact", smooth_law)
    catch_error(lambda: ExponentialFlow(chain(), 0.8, RIGID, 8), "structure", names="massless")
    catch_error(
        lambda: ExponentialFlow(chain("none", 700), 0.8, PENALTY, 8), "structure", "700 dofs"
    )
    resonant = chain("none")
    catch_error(
        lambda: ExponentialFlow(resonant, float(all_modes(resonant).squares[2] ** 0.5), PENALTY, 8),
        names="resonance",
        kind=fc.ConvergenceError,
    )
