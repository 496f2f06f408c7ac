"""Exponential steps and marches in the kernel against NumPy; their energy and steady motion."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from helpers import DAMPINGS, chain, dense_matrices, relative
from hypothesis import given, settings
from hypothesis import strategies as st

import fenics_crack as fc
from fenics_crack.model.contact import solve_complementarity
from fenics_crack.model.modal import all_modes
from fenics_crack.time import central_differences
from fenics_crack.time.flows import ExponentialFlow
from fenics_crack.time.march import March, march

SEEDS = st.integers(0, 2**32 - 1)
KINDS = st.sampled_from(["none", "Rayleigh", "modal", "matrix"])


def random_structure(rng: np.random.Generator, dofs: int, pairs: int, damping: str) -> fc.Structure:
    """Full matrices, natural frequencies from about 0.5 to 3 rad/s, pairs that overlap, a load with
    a mean, and a motion of about 1 m."""
    root, basis = rng.normal(size=(dofs, dofs)), rng.normal(size=(dofs, dofs))
    mass = root @ root.T / dofs + np.eye(dofs)
    shapes = scipy.linalg.eigh(basis @ basis.T, mass)[1]
    back = mass @ shapes
    stiffness = (back * rng.uniform(0.25, 9.0, dofs)) @ back.T
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


def same(one: fc.TimeHistory, other: fc.TimeHistory, allowed: float) -> None:
    """Gaps, forces, motion, state and energy."""
    pairs = [(one.gap, other.gap), (one.contact_force, other.contact_force)]
    pairs += [(one.recorded, other.recorded), *zip(one.final_state, other.final_state, strict=True)]
    motion = scale_of(other.recorded)
    for first, second in pairs:
        size = max(scale_of(second), 1e-3 * motion)
        assert np.abs(first - second).max(initial=0.0) <= allowed * size
    assert one.created_energy == pytest.approx(other.created_energy, abs=100.0 * allowed)


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
    asked = March(structure, 1.1, law, 2, steps, initial=(start[0], start[1]))
    makers: tuple[Any, ...] = (
        central_differences._ModalDifferences, central_differences._CentralDifferences
    )  # fmt: skip
    same(*(march(asked, made(asked)) for made in makers), 1e-10)  # type: ignore[misc]


# --- exponential steps ----------------------------------------------------------------------------


def by_exponentials(flow: ExponentialFlow, start: np.ndarray, steps: int) -> tuple[np.ndarray, ...]:
    """States and forces, by matrices of the whole flow."""
    modes = flow.modal_model
    count, pairs = modes.gaps_by_mode.shape
    damping = np.diag(modes.damping) if modes.damping.ndim == 1 else modes.damping
    whole = np.zeros((2 * count + pairs,) * 2)
    whole[:count, count : 2 * count] = np.eye(count)
    whole[count : 2 * count, :count] = -np.diag(modes.squares)
    whole[count : 2 * count, count : 2 * count] = -damping
    whole[count : 2 * count, 2 * count :] = modes.gaps_by_mode
    found = scipy.linalg.expm(flow.step_size * whole)
    moved, pushed = found[: 2 * count, : 2 * count], 0.5 * found[: 2 * count, 2 * count :]
    rows, static = flow.gap_rows, flow.residual_flexibility + np.diag(flow.softness)
    compliance = static + rows @ pushed

    now = start - flow.steady_states[0]
    force = solve_complementarity(static, rows @ now + flow.linear_gap[0])
    states, forces = [start], [force]
    for step in range(1, steps + 1):
        now = moved @ now - pushed @ force
        phase = step % flow.steps_per_period
        force = solve_complementarity(compliance, rows @ now + flow.linear_gap[phase])
        now = now - pushed @ force
        states.append(now + flow.steady_states[phase])
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
    found = flow.advance(start, 2)
    states, forces = by_exponentials(flow, start, 2 * steps)
    assert np.abs(found.states - states).max() <= 1e-12 * scale_of(states) * steps
    assert np.abs(found.forces - forces).max(initial=0.0) <= 1e-11 * scale_of(forces)
    assert np.array_equal(found.is_closed, forces > 0.0)


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
    expected = np.exp(-2.0 * np.pi / 0.8 * np.trace(np.linalg.solve(mass, matrix)))
    for steps in (5, 64):
        flow = ExponentialFlow(structure, 0.8, PENALTY, steps)
        start, units = flow.steady_states[0], np.eye(len(flow.steady_states[0]))
        found = [flow.advance(start + unit).states[-1] - start for unit in units]
        assert np.linalg.det(found) == pytest.approx(expected, rel=1e-9)


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
        closed = np.arange(structure.n_pairs) < count
        flow = ExponentialFlow(structure, 2000.0, law, 4)
        squares, pairs = flow.modal_model.squares, flow.modal_model.gaps_by_mode
        soft = flow.residual_flexibility + np.diag(flow.softness)
        rest = -(pairs @ closed) / squares  # under unit forces of the closed pairs
        pressed = rest @ pairs - soft @ closed + 1e9 * np.abs(rest @ pairs).max() * ~closed
        held = structure.varied(load=0.0, clearance=pressed - structure.clearance)
        stiff = pairs[:, closed] @ np.linalg.inv(soft[np.ix_(closed, closed)]) @ pairs[:, closed].T
        least = np.linalg.eigvalsh(soft[np.ix_(closed, closed)])[0]
        start = np.random.default_rng(2).normal(size=(2, len(squares)))
        start[0] /= np.sqrt(np.linalg.eigvalsh(np.diag(squares) + stiff)[-1])
        start *= np.sqrt(0.1 * least) / np.linalg.norm(start)  # no force falls by more than a half
        for steps in (4, 16, 32, 64, 128, 256, 512, 4096):
            march = ExponentialFlow(held, 2000.0, law, steps).advance(
                np.concatenate([rest + start[0], start[1]])
            )
            assert np.all(march.is_closed == closed)
            shape, rate = np.split(march.states, 2, axis=1)
            moved = shape - rest
            energy = (rate**2).sum(axis=1) + (moved * (squares * moved + moved @ stiff)).sum(axis=1)
            assert np.diff(energy).max() < 1e-9 * energy[0]


# --- steady motion --------------------------------------------------------------------------------


def test_gap_is_that_of_the_coordinates() -> None:
    """B^T u - g0 with contact, and g <= 0 without penetration, zero where there is a force."""
    structure = massless()
    flow = ExponentialFlow(structure, 0.8, RIGID, 50)
    steps = flow.advance(flow.steady_states[0], 3)
    motion = flow.displacement_from_phase_zero(steps.states[:-1], steps.forces[:-1])
    assert relative(structure.apply_bt(motion) - structure.clearance, steps.gaps[:-1]) < 1e-10
    size = np.abs(steps.gaps[:-1]).max()
    assert steps.gaps[:-1].max() < 1e-12 * size and steps.forces.min() >= 0.0
    assert np.array_equal(steps.forces > 0.0, steps.is_closed)
    assert np.abs(steps.gaps[:-1][steps.is_closed[:-1]]).max() < 1e-12 * size
    assert 0.05 < steps.is_closed.mean() < 0.95


# --- arguments ------------------------------------------------------------------------------------


def test_what_cannot_be_marched() -> None:
    """A law that is not piecewise linear, many dofs, and a constraint of lips with mass."""
    for call, words in (
        (lambda: ExponentialFlow(massless(), 0.8, fc.SmoothedPenalty(1.0, 1.0), 8), "contact"),
        (lambda: ExponentialFlow(chain(), 0.8, RIGID, 8), "massless"),
        (lambda: ExponentialFlow(chain("none", 700), 0.8, PENALTY, 8), "700 dofs"),
    ):
        with pytest.raises(fc.InputError, match=words):
            call()
    resonant = chain("none")
    with pytest.raises(fc.ConvergenceError, match="resonance"):
        ExponentialFlow(resonant, float(all_modes(resonant).squares[2] ** 0.5), PENALTY, 8)
