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
from fenics_crack.balance.bordered import Tangent, solve_in_plane
from fenics_crack.balance.orbits import OrbitPoint
from fenics_crack.model.complementarity import solve_complementarity
from fenics_crack.model.exact_flow import KEPT, EventFlow
from fenics_crack.model.flow import ExponentialFlow
from fenics_crack.stability.shooting import ExactOrbits
from fenics_crack.time import central_differences, implicit
from fenics_crack.time.march import March, Scheme, march

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
    """Two periods against steps with PETSc's matrices in the coordinates of the structure."""
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
    same(*(march(asked, made(asked)) for made in makers), 2e-12)  # type: ignore[misc]


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 9), st.integers(0, 4), DAMPINGS, st.booleans(), SEEDS)
def test_implicit_scheme(dofs: int, pairs: int, damping: str, rigid: bool, seed: int) -> None:
    """The same."""
    rng = np.random.default_rng(seed)
    pairs = min(pairs, dofs)
    structure = random_structure(rng, dofs, pairs, damping)
    law: Any = fc.UnilateralConstraint() if rigid else fc.UnilateralPenalty(20.0)
    start = 0.3 * rng.normal(size=(2, dofs))
    asked = March(structure, 1.1, law, 2, 40, initial=(start[0], start[1]))
    radius = rng.uniform(0.0, 1.0)
    makers: tuple[Any, ...] = (implicit._ModalAlpha, implicit._GeneralisedAlpha)
    schemes: list[Scheme] = [made(asked, radius) for made in makers]
    same(*(march(asked, scheme) for scheme in schemes), 2e-12)  # type: ignore[misc]


# --- exponential steps ----------------------------------------------------------------------------


def by_exponentials(flow: ExponentialFlow, start: np.ndarray, steps: int) -> tuple[np.ndarray, ...]:
    """States, forces and the product of the tangents, by matrices of the whole flow."""
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

    def stiffness(matrix: np.ndarray, force: np.ndarray) -> np.ndarray:
        inverse, closed = np.zeros_like(matrix), np.ix_(force > 0.0, force > 0.0)
        inverse[closed] = np.linalg.inv(matrix[closed])
        return inverse

    now = start - flow.steady[0]
    force = solve_complementarity(static, rows @ now + flow.linear_gap[0])
    states, forces, product = [start], [force], np.eye(2 * count)
    for step in range(1, steps + 1):
        product = moved @ product - pushed @ (stiffness(static, force) @ (rows @ product))
        now = moved @ now - pushed @ force
        phase = step % flow.steps
        force = solve_complementarity(compliance, rows @ now + flow.linear_gap[phase])
        now = now - pushed @ force
        product -= pushed @ (stiffness(compliance, force) @ (rows @ product))
        states.append(now + flow.steady[phase])
        forces.append(force)
    return np.array(states), np.array(forces), product


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 9), st.integers(0, 4), DAMPINGS, st.sampled_from([7, 60]), SEEDS)
def test_exponential_steps(dofs: int, pairs: int, damping: str, steps: int, seed: int) -> None:
    """States, forces and tangents of two periods, mass at the lips and a residual compliance."""
    rng = np.random.default_rng(seed)
    structure = random_structure(
        rng, dofs, min(pairs, dofs), damping if damping != "none" else "modal"
    )
    above = 2.0 if seed % 2 else None
    flow = ExponentialFlow(structure, 1.1, fc.UnilateralPenalty(20.0), steps, static_above=above)
    start = 0.3 * rng.normal(size=2 * len(flow.modes.squares))
    found = flow.advance(start, 2)
    states, forces, product = by_exponentials(flow, start, 2 * steps)
    assert np.abs(found.states - states).max() <= 1e-12 * scale_of(states) * steps
    assert np.abs(found.forces - forces).max(initial=0.0) <= 1e-11 * scale_of(forces)
    assert np.array_equal(found.closed, forces > 0.0)
    assert np.abs(found.monodromy() - product).max() <= 1e-11 * scale_of(product)


# --- exact flow -----------------------------------------------------------------------------------


def first_root(row: np.ndarray, matrix: np.ndarray, state: np.ndarray, step: float) -> float:
    """Of row exp(matrix t) state in a step."""

    def gap(t: float) -> float:
        return float(row @ (scipy.linalg.expm(t * matrix) @ state))

    return float(scipy.optimize.brentq(gap, 0.0, step, xtol=1e-15))


def by_brackets(
    flow: EventFlow, law: fc.UnilateralPenalty, state: np.ndarray, duration: float
) -> tuple[np.ndarray, np.ndarray, int]:
    """State, monodromy matrix and events, by exponentials of the whole flow with its load, a fine
    grid and Brent's method."""
    modes, count, omega = flow._modes, len(flow._modes.squares), flow.omega
    damping = np.diag(modes.damping) if modes.damping.ndim == 1 else modes.damping
    size, load = 2 * count, flow.structure.force @ modes.shapes
    rows = np.hstack([flow.gap_rows, np.zeros((len(flow.gap_rows), 3))])
    rows[:, size] = -np.broadcast_to(flow.structure.clearance, len(rows))

    def system(closed: np.ndarray) -> np.ndarray:
        """Of (z, 1, cos, sin)."""
        springs = closed * float(law.stiffness)
        matrix = np.zeros((size + 3, size + 3))
        matrix[:count, count:size] = flow.scale * np.eye(count)
        stiffness = np.diag(modes.squares) + (modes.pairs * springs) @ modes.pairs.T
        matrix[count:size, :count] = -stiffness / flow.scale
        matrix[count:size, count:size] = -damping
        matrix[count:size, size:] = load.T
        matrix[count:size, size] += modes.pairs @ (springs * flow.structure.clearance)
        matrix[size + 1, size + 2], matrix[size + 2, size + 1] = -omega, omega
        return matrix

    now, left, events = np.concatenate([state, [1.0, 1.0, 0.0]]), duration, 0
    closed, product = rows @ now > 0.0, np.eye(size + 3)
    step = 2e-3
    while True:
        matrix = system(closed)
        short = scipy.linalg.expm(step * matrix)
        side, moved, reached = np.where(closed, -1.0, 1.0), now, 0.0
        outside: np.ndarray = np.zeros(len(rows), bool)
        while reached < left and not np.any(outside):
            before, moved, reached = moved, short @ moved, reached + step
            outside = side * (rows @ moved) > 0.0
        length, pair = left, -1
        for one in np.flatnonzero(outside):
            root = reached - step + first_root(rows[one], matrix, before, step)
            if root < length:
                length, pair = root, int(one)
        whole = scipy.linalg.expm(length * matrix)
        now, product, left = whole @ now, whole @ product, left - length
        if pair < 0:
            return now[:size], product[:size, :size], events
        closed[pair] = ~closed[pair]
        events += 1


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(1, 4), st.integers(0, 2), DAMPINGS, SEEDS)
def test_exact_flow(dofs: int, pairs: int, damping: str, seed: int) -> None:
    """State, monodromy matrix, number of events, and gaps at given instants."""
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, dofs, min(pairs, dofs), damping)
    law = fc.UnilateralPenalty(5.0)
    flow = EventFlow(structure, 1.1, law)
    start = 0.3 * rng.normal(size=2 * dofs)
    state, monodromy, events = by_brackets(flow, law, start, 6.0)
    found, _, derivative, counted = flow.advance(start, 0.0, 6.0)
    assert counted == events
    assert np.abs(found - state).max() <= 1e-11 * scale_of(state)
    assert np.abs(derivative() - monodromy).max() <= 1e-10 * scale_of(monodromy)
    instants = np.sort(rng.uniform(0.0, 6.0, 5))
    for instant, row in zip(
        instants, flow.advance(start, 0.0, 6.0, instants=instants)[1], strict=True
    ):
        exact = flow.gap_rows @ flow.advance(start, 0.0, instant)[0]
        assert np.abs(row - exact).max(initial=0.0) <= 1e-12 * scale_of(state)
    equal = np.arange(600) / 100.0
    gaps = flow.advance(start, 0.0, 6.0, instants=equal)[1]
    for place in (1, 100, 599):
        exact = flow.gap_rows @ flow.advance(start, 0.0, equal[place])[0]
        assert np.abs(gaps[place] - exact).max(initial=0.0) <= 1e-11 * scale_of(state)


def test_exact_flow_past_many_events() -> None:
    """One flow of several hundred events against many short ones."""
    rng = np.random.default_rng(3)
    flow = EventFlow(random_structure(rng, 2, 2, "Rayleigh"), 1.1, fc.UnilateralPenalty(5.0))
    start = 0.3 * rng.normal(size=4)
    state, _, derivative, events = flow.advance(start, 0.0, 1600.0)
    product, counted = np.eye(4), 0
    for number in range(80):
        start, _, step, some = flow.advance(start, 20.0 * number, 20.0)
        product, counted = step() @ product, counted + some
    assert counted == events > 2 * KEPT
    assert np.abs(state - start).max() <= 1e-9 * scale_of(state)
    assert np.abs(derivative() - product).max() <= 1e-6 * scale_of(product)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(1, 3), st.integers(1, 2), DAMPINGS, SEEDS)
def test_orbits_by_newton(dofs: int, pairs: int, damping: str, seed: int) -> None:
    """The compiled loop takes the steps of the one in Python: at a frequency, in a plane, and with
    little patience; then it stands at the orbit, with its monodromy matrix."""
    rng = np.random.default_rng(seed)
    structure = random_structure(rng, dofs, min(pairs, dofs), damping)
    law, omega = fc.UnilateralPenalty(5.0), float(rng.uniform(0.5, 2.0))
    near = fc.solve_harmonic_balance(structure, omega, law, harmonics=6, throw=False)
    system = ExactOrbits(structure, law, near)
    start, across = system.start, rng.normal(size=2 * dofs)
    for plane in (None, Tangent(across / np.linalg.norm(across), 0.5, 1.0)):
        for patience in (None, 1, 3):
            given = {"tolerance": 1e-10, "iterations": 8, "reach": 0.05, "patience": patience}
            one = solve_in_plane(system, start, 1.0, plane, history=[], **given)
            two = solve_in_plane(system, start, 1.0, plane, **given)
            assert (one is None) == (two is None)
            if one is None or two is None:
                continue
            assert one.iterations == two.iterations
            assert one.parameter == pytest.approx(two.parameter, rel=1e-9)
            assert np.abs(one.unknown - two.unknown).max() <= 1e-8
            assert isinstance(one.at, OrbitPoint) and isinstance(two.at, OrbitPoint)
            assert one.at.events == two.at.events
            scale = scale_of(one.at.monodromy)
            assert np.abs(one.at.monodromy - two.at.monodromy).max() <= 1e-6 * scale
            assert np.abs(two.at.residual).max() <= 1e-9
