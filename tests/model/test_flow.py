"""The flow by exponential steps: their energy, their multipliers, its steady motion."""

from typing import Any

import numpy as np
import pytest
from helpers import DAMPINGS, chain, dense_matrices, relative

import fenics_crack as fc
from fenics_crack.model.flow import ExponentialFlow
from fenics_crack.model.modal import all_modes

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
        start, units = flow.steady[0], np.eye(len(flow.steady[0]))
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
        squares, pairs = flow.modes.squares, flow.modes.pairs
        soft = flow.residual + np.diag(flow.springs)
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
            assert np.all(march.closed == closed)
            shape, rate = np.split(march.states, 2, axis=1)
            moved = shape - rest
            energy = (rate**2).sum(axis=1) + (moved * (squares * moved + moved @ stiff)).sum(axis=1)
            assert np.diff(energy).max() < 1e-9 * energy[0]


# --- steady motion --------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", ["modal", "matrix", "none"])
@pytest.mark.parametrize("modes", [4, 10])
def test_steady_motion_is_the_linear_solution(damping: str, modes: int) -> None:
    """Gap and displacement of lips that pass through each other, at every instant."""
    structure = chain(damping).varied(clearance=1e3)  # contact is out of reach
    made = fc.reduce_structure(structure, modes=modes, method="massless")
    flow = ExponentialFlow(made, 0.8, PENALTY, 24)
    steps = flow.advance(flow.steady[0])
    time = np.arange(24) * flow.step_size
    linear = fc.solve_linear(made, 0.8)
    assert relative(steps.gap, linear.gap(time)) < 1e-9
    assert relative(steps.states[-1], steps.states[0]) < 1e-10
    motion = flow.coordinates(steps.states[:-1], steps.forces[:-1])
    assert relative(made.expand(motion), linear.displacement_field(time)) < 1e-8
    assert relative(made.apply_bt(motion) - made.clearance, steps.gap) < 1e-10


def test_gap_is_that_of_the_coordinates() -> None:
    """B^T u - g0 with contact, and g <= 0 without penetration, zero where there is a force."""
    structure = massless()
    flow = ExponentialFlow(structure, 0.8, RIGID, 50)
    steps = flow.advance(flow.steady[0], 3)
    motion = flow.coordinates(steps.states[:-1], steps.forces[:-1])
    assert relative(structure.apply_bt(motion) - structure.clearance, steps.gap) < 1e-10
    size = np.abs(steps.gap).max()
    assert steps.gap.max() < 1e-12 * size and steps.forces.min() >= 0.0
    assert np.array_equal(steps.forces > 0.0, steps.closed)
    assert np.abs(steps.gap[steps.closed[:-1]]).max() < 1e-12 * size
    assert 0.05 < steps.closed.mean() < 0.95


def test_fewer_modes() -> None:
    """Modes above a frequency answer at once, as they do in a smaller basis."""
    structure = massless(modes=6)
    above = float(all_modes(structure).squares[4] ** 0.5) * 0.999
    fewer = ExponentialFlow(structure, 0.5, RIGID, 40, static_above=above)
    small = ExponentialFlow(massless(modes=4), 0.5, RIGID, 40)
    found, expected = (flow.advance(flow.steady[0], 2).gap for flow in (fewer, small))
    assert relative(found, expected) < 1e-9


# --- arguments ------------------------------------------------------------------------------------


def test_what_cannot_be_marched() -> None:
    """A law that is not piecewise linear, many dofs, and a constraint of lips with mass."""
    with pytest.raises(fc.InputError, match="contact"):
        ExponentialFlow(massless(), 0.8, fc.SmoothedPenalty(1.0, 1.0), 8)
    with pytest.raises(fc.InputError, match="massless"):
        ExponentialFlow(chain(), 0.8, RIGID, 8)
    with pytest.raises(fc.InputError, match="700 dofs"):
        ExponentialFlow(chain("none", 700), 0.8, PENALTY, 8)
    resonant = chain("none")
    with pytest.raises(fc.ConvergenceError, match="resonance"):
        ExponentialFlow(resonant, float(all_modes(resonant).squares[2] ** 0.5), PENALTY, 8)
