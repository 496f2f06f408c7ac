"""Compiled marches against the same equations written with NumPy, on random structures."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.optimize
from hypothesis import given, settings
from hypothesis import strategies as st

import fenics_crack as fc
from fenics_crack.model.coupled import solve_complementarity
from fenics_crack.model.flow import ExponentialFlow
from fenics_crack.time import central_differences
from fenics_crack.time.march import March, march

SEEDS = st.integers(0, 2**32 - 1)
DAMPINGS = st.sampled_from(["none", "Rayleigh", "modal", "matrix"])


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
        mass, 0.5 * (stiffness + stiffness.T), rng.normal(size=(dofs, pairs)),
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
@given(st.integers(1, 9), st.integers(0, 4), DAMPINGS, st.booleans(), SEEDS)
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
    modes = flow.modes
    count, pairs = modes.pairs.shape
    damping = np.diag(modes.damping) if modes.damping.ndim == 1 else modes.damping
    whole = np.zeros((2 * count + pairs,) * 2)
    whole[:count, count : 2 * count] = np.eye(count)
    whole[count : 2 * count, :count] = -np.diag(modes.squares)
    whole[count : 2 * count, count : 2 * count] = -damping
    whole[count : 2 * count, 2 * count :] = modes.pairs
    found = scipy.linalg.expm(flow.step_size * whole)
    moved, pushed = found[: 2 * count, : 2 * count], 0.5 * found[: 2 * count, 2 * count :]
    rows, static = flow.gap_rows, flow.residual + np.diag(flow.springs)
    compliance = static + rows @ pushed

    now = start - flow.steady[0]
    force = solve_complementarity(static, rows @ now + flow.linear_gap[0])
    states, forces = [start], [force]
    for step in range(1, steps + 1):
        now = moved @ now - pushed @ force
        phase = step % flow.steps
        force = solve_complementarity(compliance, rows @ now + flow.linear_gap[phase])
        now = now - pushed @ force
        states.append(now + flow.steady[phase])
        forces.append(force)
    return np.array(states), np.array(forces)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 9), st.integers(0, 4), DAMPINGS, st.sampled_from([7, 60]), SEEDS)
def test_exponential_steps(dofs: int, pairs: int, damping: str, steps: int, seed: int) -> None:
    """States and forces of two periods, mass at the lips and a residual compliance."""
    rng = np.random.default_rng(seed)
    structure = random_structure(
        rng, dofs, min(pairs, dofs), damping if damping != "none" else "modal"
    )
    above = 2.0 if seed % 2 else None
    flow = ExponentialFlow(structure, 1.1, fc.UnilateralPenalty(20.0), steps, static_above=above)
    start = 0.3 * rng.normal(size=2 * len(flow.modes.squares))
    found = flow.advance(start, 2)
    states, forces = by_exponentials(flow, start, 2 * steps)
    assert np.abs(found.states - states).max() <= 1e-12 * scale_of(states) * steps
    assert np.abs(found.forces - forces).max(initial=0.0) <= 1e-11 * scale_of(forces)
    assert np.array_equal(found.closed, forces > 0.0)


# --- exact flow -----------------------------------------------------------------------------------
