"""The exact flow against one that shares no code with it, its periodic orbits, predicted errors."""

from __future__ import annotations

import re
from functools import partial

import numpy as np
import pytest
import scipy.linalg
from helpers import (
    DAMPINGS,
    Cubic,
    catch_error,
    chain,
    oscillator,
    period_two_orbit,
    relative,
    two_masses,
)
from hypothesis import given, settings
from hypothesis import strategies as st
from reference_flow import ReferenceFlow, size_of_motion

import fenics_crack as fc
from fenics_crack import PeriodicOrbit
from fenics_crack.kernel import kernel, pointer
from fenics_crack.motion import flow as flow_module
from fenics_crack.motion.attractors import find_attractor
from fenics_crack.motion.flow import (
    Budget,
    BudgetError,
    ContactFlow,
    IntegratedMotion,
    Track,
    exact_flow_or_none,
)
from fenics_crack.motion.orbit import (
    OrbitPrediction,
    find_orbit,
    predict_motion,
    predict_orbit_by_newton_step,
)
from fenics_crack.motion.search import SearchOptions, search_orbit, series_states_at_period_parts
from fenics_crack.motion.shooting import FlowOrbitEquations
from fenics_crack.numerics.fourier import evaluate_series, fourier_basis, fourier_coefficients

RIGID = fc.UnilateralConstraint()


def known(structure: fc.Structure, contact: object) -> ContactFlow:
    """The flow, which there is."""
    flow = exact_flow_or_none(structure, contact)
    assert flow is not None
    return flow


def reference_of(
    structure: fc.Structure, contact: object, flow: ContactFlow
) -> tuple[ReferenceFlow, np.ndarray]:
    """Return a flow that shares no code, and the matrix from a flow's states to its states."""
    reference, shapes = ReferenceFlow(structure, contact), flow.modal_model.shapes
    units = (np.split(unit, 2) for unit in np.eye(flow.state_size))
    return reference, np.column_stack(
        [reference.state(shapes @ shape, shapes @ rate) for shape, rate in units]
    )


def thrown(flow: ContactFlow, seed: int = 0) -> np.ndarray:
    """A random state."""
    random = np.random.default_rng(seed)
    return random.normal(size=flow.state_size) / np.concatenate(
        [np.sqrt(np.maximum(flow.modal_model.squares, 0.1)), np.ones(flow.state_size // 2)]
    )


def energy(flow: ContactFlow, motion: IntegratedMotion) -> np.ndarray:
    """Of modes, springs and static compliance at the samples."""
    samples = motion.samples
    shape, rate = np.split(samples.states, 2, axis=1)
    slow = samples.gap + samples.force @ flow.residual_flexibility
    return 0.5 * (shape**2 @ flow.modal_model.squares + (rate**2).sum(axis=1)) + 0.5 * (
        samples.force * slow
    ).sum(axis=1)


@pytest.mark.nightly
@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from([*DAMPINGS, "gyroscopic"]), st.integers(1, 3), st.integers(0, 2**31),
    st.floats(0.0, 3.0), st.booleans(),
)  # fmt: skip
def test_against_the_reference(
    damping: str, pairs: int, seed: int, hardness: float, light: bool
) -> None:
    """State, gaps, derivative and number of events over two periods, with and without mass at the
    lips, to rounding."""
    has_coupled_modes = damping in ("matrix", "gyroscopic")
    structure = chain("modal" if has_coupled_modes and light else damping, 10, pairs, seed)
    contact: object = fc.UnilateralPenalty(10.0**hardness * np.linspace(0.5, 1.0, pairs))
    if light:
        structure = fc.reduce_structure(structure, modes=4, method="massless")
        contact = contact if seed % 2 else RIGID
    flow, omega = known(structure, contact), 0.7
    state, duration = thrown(flow, seed), 4.0 * np.pi / omega
    instants = duration * np.arange(60) / 60 + 0.3
    motion = flow.advance(state, omega, duration, start=0.3, instants=instants)
    reference, turn = reference_of(structure, contact, flow)
    passage = reference.advance(turn @ state, omega, 0.3, duration, 60)
    tangent = passage.tangent() @ turn
    tangent_size = np.linalg.norm(motion.track.derivative_of_end_state)
    assert relative(turn @ motion.state, passage.state) < 1e-12 * (1.0 + tangent_size)
    assert np.abs(motion.samples.gap - passage.gap).max() < 1e-12 * (1.0 + tangent_size)
    assert relative(turn @ motion.track.derivative_of_end_state, tangent) < 1e-9 * (
        1.0 + tangent_size
    )
    assert motion.n_events == len(passage.pieces) - 1
    assert motion.samples.gap[motion.samples.is_closed].min(initial=0.0) >= 0.0
    assert motion.track.lengths.sum() == pytest.approx(duration, rel=1e-12)


def test_a_stop_far_stiffer_than_the_modes() -> None:
    """A mass that flies between blows, half a circle each: in closed form, and in pieces as long as
    the free motion takes, though the stop alone turns a thousand times as fast."""
    stop = 1e6
    structure = fc.Structure.from_matrices([[1.0]], [[1.0]], gap=[1.0], force_cos=[0.0])
    flow = known(structure, fc.UnilateralPenalty(stop))
    contact_duration, flight_duration = np.pi / np.sqrt(1.0 + stop), np.pi
    motion = flow.advance(
        np.array([0.0, -1.0]), 1.0, 5.0 * flight_duration + 4.5 * contact_duration
    )
    assert motion.n_events == 9 and motion.n_taylor_pieces < 40
    assert motion.state == pytest.approx([1.0 / np.sqrt(1.0 + stop), 0.0], abs=1e-12)


@pytest.mark.parametrize("light", [False, True])
def test_energy(light: bool) -> None:
    """Without damping and load it stays, over 20 periods."""
    structure = chain("none", 30, 5, seed=4).varied(load=0.0)
    contact: object = fc.UnilateralPenalty(500.0)
    if light:
        structure = fc.reduce_structure(structure, modes=12, method="massless")
        contact = RIGID
    flow = known(structure, contact)
    period = 2.0 * np.pi / np.sqrt(flow.modal_model.squares[0])
    instants = np.linspace(0.0, 20.0 * period, 500)
    motion = flow.advance(thrown(flow), 1.0, 20.0 * period, instants=instants)
    assert motion.n_events > 500
    energies = energy(flow, motion)
    assert np.abs(energies / energies[0] - 1.0).max() < 1e-11


@pytest.mark.parametrize("light", [False, True])
def test_derivatives(light: bool) -> None:
    """By the state and by the frequency, against differences."""
    structure, contact = chain("matrix", pairs=3, seed=2), fc.UnilateralPenalty(30.0)
    if light:
        structure, contact = fc.reduce_structure(chain(seed=2), modes=5, method="massless"), RIGID
    flow, omega, step = known(structure, contact), 0.9, 1e-6
    state, duration = thrown(flow, 3), 11.0
    track = flow.advance(state, omega, duration, start=0.4).track
    for place in (0, flow.state_size // 2, flow.state_size - 1):
        state_changes = step * np.eye(flow.state_size)[place]
        upper_motion, lower_motion = (
            flow.advance(state + h, omega, duration, start=0.4)
            for h in (state_changes, -state_changes)
        )
        slope = (upper_motion.state - lower_motion.state) / (2.0 * step)
        assert relative(track.derivative_of_end_state[:, place], slope) < 1e-7
    upper_motion, lower_motion = (
        flow.advance(state, omega + h, duration, start=0.4) for h in (step, -step)
    )
    by_omega = np.empty(flow.state_size)
    assert not kernel.flow_by_omega(flow.handle, track._struct.address, pointer(by_omega))
    assert relative(by_omega, (upper_motion.state - lower_motion.state) / (2.0 * step)) < 1e-7


def test_parts_make_the_whole() -> None:
    """Motion and derivative of a period in 32 parts, each from where the last one ends."""
    flow, omega = known(chain(), fc.UnilateralPenalty(50.0)), 0.8
    full_motion = flow.advance(thrown(flow), omega, 2.0 * np.pi / omega)
    starts = np.linspace(0.0, 2.0 * np.pi / omega, 33)[:-1]
    samples = flow.advance(thrown(flow), omega, 2.0 * np.pi / omega, instants=starts).samples
    end_states, track, ends = flow.integrate_equal_parts_of_period(
        samples.states, omega, 2.0 * np.pi / omega
    )
    assert relative(end_states[:-1], samples.states[1:]) < 1e-12
    assert relative(end_states[-1], full_motion.state) < 1e-12
    assert (
        relative(track.derivative_of_end_state, full_motion.track.derivative_of_end_state) < 1e-11
    )
    start, excess = thrown(flow, 5), np.zeros_like(end_states)
    carried_changes = track.carry_changes(start, excess, ends)
    part = flow.advance(samples.states[4], omega, starts[1], start=starts[4]).track
    assert relative(carried_changes[5], part.derivative_of_end_state @ carried_changes[4]) < 1e-12
    assert relative(carried_changes[-1], full_motion.track.derivative_of_end_state @ start) < 1e-11
    excess[-2:] = thrown(flow, 7), thrown(flow, 8)
    last_track = flow.advance(samples.states[-1], omega, starts[1], start=starts[-1]).track
    end_change = last_track.derivative_of_end_state @ excess[-2] + excess[-1]
    assert (
        relative(track.carry_changes(start, excess, ends)[-1], carried_changes[-1] + end_change)
        < 1e-11
    )


@pytest.mark.parametrize("missed", [1e-3, 1e-6, 1e-9, 1e-12, 0.0, -1e-12, -1e-6])
def test_grazing(missed: float) -> None:
    """x = -cos t meets a stop at 1 - missed for a moment: in contact with k = 3 it turns with twice
    the frequency about the point where the forces cancel."""
    flow = known(oscillator(None, force=0.0, clearance=1.0 - missed), fc.UnilateralPenalty(3.0))
    instants = np.linspace(0.0, 2.0 * np.pi, 9)
    motion = flow.advance(np.array([-1.0, 0.0]), 1.0, 2.0 * np.pi, instants=instants)
    assert motion.n_events == 2 if missed > 1e-12 else motion.n_events % 2 == 0
    depth = max(missed, 0.0)
    speed = np.sqrt(depth * (2.0 - depth))  # there; the motion then runs back in time
    phase_lag = np.arctan2(2.0 * speed, 1.0 - depth) - 2.0 * np.arcsin(speed)
    assert motion.state == pytest.approx([-np.cos(phase_lag), -np.sin(phase_lag)], abs=1e-14)


def test_equal_structures_side_by_side() -> None:
    """Every event is a double one, and nothing else changes."""
    pattern = chain(seed=6)
    mass, stiffness, gap = _matrices(pattern)
    matrices = [np.kron(np.eye(2), part) for part in (mass, stiffness, gap)]
    double_structure = fc.Structure.from_matrices(
        *matrices[:2], gap=matrices[2],
        force_cos=np.tile(pattern.force[1], 2), clearance=np.tile(pattern.clearance, 2),
    )  # fmt: skip
    single_structure = fc.Structure.from_matrices(
        mass, stiffness, gap=gap, force_cos=pattern.force[1], clearance=pattern.clearance
    )
    contact, motions = fc.UnilateralPenalty(40.0), []
    for structure in (single_structure, double_structure):
        flow = known(structure, contact)
        copies = structure.n_dofs // single_structure.n_dofs
        rest = flow.state(np.tile(np.linspace(-1, 1, 10), copies), np.zeros(structure.n_dofs))
        motions.append((flow, flow.advance(rest, 0.7, 18.0, instants=np.array([18.0]))))
    (_, single_motion), (_, double_motion) = motions
    assert (
        double_motion.n_events <= 2 * single_motion.n_events
        and len(double_motion.track.lengths) <= 3 * single_motion.n_events
    )
    single, double = (motion.samples.displacement[0] for _, motion in motions)
    assert relative(double, np.tile(single, 2)) < 1e-11


def test_almost_equal_structures() -> None:
    """Events that follow one another after 1e-10 of a period are two: the derivative is sharp, that
    of each structure by itself."""
    mass, stiffness, gap = _matrices(chain(seed=6))
    force, factors = chain(seed=6).force[1], np.diag([1.0, 1.0 + 1e-9])
    double_structure = fc.Structure.from_matrices(
        np.kron(np.eye(2), mass), np.kron(factors, stiffness),
        gap=np.kron(np.eye(2), gap), force_cos=np.tile(force, 2),
    )  # fmt: skip
    single_structures = (
        fc.Structure.from_matrices(mass, factor * stiffness, gap=gap, force_cos=force)
        for factor in factors.diagonal()
    )
    motions = []
    for structure in (double_structure, *single_structures):
        flow = known(structure, fc.UnilateralPenalty(40.0))
        rest = np.resize(np.linspace(-1, 1, 10), structure.n_dofs)
        motion = flow.advance(flow.state(rest, 0.0 * rest), 0.7, 18.0)
        to_dofs = np.kron(np.eye(2), flow.modal_model.shapes)
        motions.append(
            (
                motion.n_events,
                to_dofs @ motion.track.derivative_of_end_state @ np.linalg.inv(to_dofs),
            )
        )
    (events, tangent), *parts = motions
    assert events == sum(part[0] for part in parts) > 20
    for number, (_, single_tangent) in enumerate(parts):
        own_dofs = np.add.outer([0, 20], 10 * number + np.arange(10)).ravel()
        assert relative(tangent[np.ix_(own_dofs, own_dofs)], single_tangent) < 1e-11


def _matrices(structure: fc.Structure) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    all_dofs = range(structure.n_dofs)
    return (
        structure.mass.getValues(all_dofs, all_dofs),
        structure.stiffness.getValues(all_dofs, all_dofs), structure.gap.toarray(),
    )  # fmt: skip


@pytest.mark.parametrize("remembered", [1.0, 0.0])
def test_motions_do_not_depend_on_earlier_ones(
    remembered: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """State, track, derivative and error predicted, whatever was followed before and however many
    sets of closed pairs are kept: equal to the last bit."""
    solution = fc.solve_harmonic_balance(light_chain(3), 0.5, RIGID, harmonics=10)
    displacement = solution.displacement_coefficients

    def found(busy: bool) -> tuple[np.ndarray, ...]:
        flow = known(solution.structure, RIGID)
        for seed in range(5 * busy):
            flow.advance(thrown(flow, seed), 0.3 + 0.1 * seed, 40.0)
        motion = flow.advance(thrown(flow, 7), 0.5, 60.0)
        step = predict_orbit_by_newton_step(
            flow, 0.5, series_states_at_period_parts(flow, displacement, 0.5)
        )
        assert motion.n_events > 40 and step is not None
        return motion.state, motion.track.lengths, motion.track.derivative_of_end_state, step.states

    fresh_arrays = found(busy=False)
    monkeypatch.setattr(
        flow_module, "SETS_MEMORY_FRACTION", remembered * flow_module.SETS_MEMORY_FRACTION
    )
    for reused_array, fresh_array in zip(found(busy=True), fresh_arrays, strict=True):
        assert np.array_equal(reused_array, fresh_array)


@pytest.mark.parametrize("pairs", [1, 6, pytest.param(40, marks=pytest.mark.nightly)])
def test_answers_of_sets(pairs: int) -> None:
    """Forces and openings at instants by NumPy's solution for the closed pairs."""
    structure = fc.reduce_structure(chain("modal", 125, pairs, seed=1), modes=8, method="massless")
    flow, omega = known(structure, RIGID), 0.7
    instants = np.linspace(0.0, 30.0, 200)
    samples = flow.advance(thrown(flow), omega, 30.0, instants=instants).samples
    gaps = (
        samples.states[:, : flow.state_size // 2] @ flow.modal_model.gaps_by_mode
        + fourier_basis(omega * instants) @ flow.massless_load_gap_less_clearance
    )
    assert len(np.unique(samples.is_closed, axis=0)) > min(pairs, 10)
    for gap, is_closed, answers in zip(
        gaps, samples.is_closed, samples.forces_and_openings, strict=True
    ):
        force = np.zeros(pairs)
        force[is_closed] = np.linalg.solve(
            flow.compliance[np.ix_(is_closed, is_closed)], gap[is_closed]
        )
        opening = flow.compliance @ force - gap
        size = np.abs(gap).max() * (1.0 if is_closed.all() else max(1.0, np.abs(force).max()))
        assert np.where(is_closed, force, opening) == pytest.approx(answers, abs=1e-11 * size)


def test_rest_stays() -> None:
    """No load, and pairs that touch: nothing moves, nothing happens."""
    flow = known(oscillator(force=0.0), fc.UnilateralPenalty(1.0))
    motion = flow.advance(np.zeros(2), 1.0, 100.0)
    assert not motion.state.any() and motion.n_events == 0
    pressed_structure = chain(seed=1).varied(load=0.0, clearance=-1.0)
    flow = known(fc.reduce_structure(pressed_structure, modes=5, method="massless"), RIGID)
    force = flow.advance(np.zeros(flow.state_size), 1.0, 0.1, instants=np.zeros(1)).samples.force
    assert np.all(force > 0.0)


def test_budget() -> None:
    """A motion that takes more is given up at once."""
    flow = known(chain(), fc.UnilateralPenalty(50.0))
    for duration, budget, names, kind in (
        (1e3, Budget(max_event_intervals=20), "after 20 events", fc.ConvergenceError),
        (1e3, Budget(max_taylor_pieces=20), "too fast", BudgetError),
        (1e300, Budget(max_event_intervals=20), "too fast", BudgetError),
    ):
        catch_error(
            partial(flow.advance, thrown(flow), 0.8, duration, budget=budget),
            names=names,
            kind=kind,
        )
    catch_error(
        lambda: flow.advance(np.full(flow.state_size, np.nan), 0.8, 1e3),
        names="finite",
        kind=fc.ConvergenceError,
    )


def test_who_has_a_flow() -> None:
    """The penalty law always, rigid contact where something answers at once, smooth laws never."""
    massive_structure = chain()
    massless_structure = fc.reduce_structure(massive_structure, modes=4, method="massless")
    assert exact_flow_or_none(massive_structure, fc.UnilateralPenalty(1.0)) is not None
    assert exact_flow_or_none(massless_structure, RIGID) is not None and exact_flow_or_none(
        massless_structure, fc.UnilateralPenalty(1.0)
    )
    assert exact_flow_or_none(massive_structure, RIGID) is None
    assert exact_flow_or_none(massive_structure, Cubic(1.0)) is None
    assert exact_flow_or_none(massive_structure, fc.SmoothedPenalty(1.0, 1.0)) is None


@pytest.mark.parametrize("damping", [0.0, 0.1, 2.0, 2.0 + 1e-9, 4.0])
def test_derivative_while_all_pairs_are_open(damping: float) -> None:
    """The exponential of the flow's matrix, also with critical and more damping."""
    structure = fc.Structure.from_matrices(
        np.eye(2), np.diag([1.0, 0.0]), gap=[1.0, 0.0], force_cos=[1.0, 0.0], clearance=1e9,
        damping=damping * np.eye(2),
    )  # fmt: skip
    flow = known(structure, fc.UnilateralPenalty(1.0))
    assert flow.modal_model.damping.ndim == 1
    matrix = np.block(
        [
            [np.zeros((2, 2)), np.eye(2)],
            [-np.diag(flow.modal_model.squares), -np.diag(flow.modal_model.damping)],
        ]
    )
    tangent = flow.advance(thrown(flow), 0.3, 20.0).track.derivative_of_end_state
    assert tangent == pytest.approx(scipy.linalg.expm(20.0 * matrix), abs=1e-9)


@pytest.mark.parametrize("turn", [0.003, 0.017, 0.08])
def test_derivative_along_short_sets(turn: float) -> None:
    """The product of the exponentials of the sets, of which some last for a turn of the fastest
    motion [rad] by which they are added as kicks, with others before, between and after them."""
    flow = known(light_chain(3), RIGID)
    assert flow.modal_model.damping.ndim == 1 and flow.structure.n_pairs == 5
    sizes, turns = (0, 1, 2, 3, 5, 2, 0, 4, 1), np.array([2, 1, 1, 1.3, 0.7, 60, 1, 1, 1])
    sets = (np.arange(5) < np.array(sizes)[:, None]).astype(np.int8)
    lengths = turns * turn / flow.mode_rate_bound
    exact_tangent, pairs = np.eye(flow.state_size), flow.modal_model.gaps_by_mode
    for is_closed, length in zip(sets > 0, lengths, strict=True):
        rows = pairs[:, is_closed]
        force_slope = np.linalg.solve(flow.compliance[np.ix_(is_closed, is_closed)], rows.T)
        matrix = np.zeros((2, flow.n_modes, 2, flow.n_modes))
        matrix[0, :, 1] = np.eye(flow.n_modes)
        matrix[1, :, 0] = -np.diag(flow.modal_model.squares) - rows @ force_slope
        matrix[1, :, 1] = -np.diag(flow.modal_model.damping)
        exact_tangent = (
            scipy.linalg.expm(length * matrix.reshape(exact_tangent.shape)) @ exact_tangent
        )
    unit = np.repeat([flow.mode_rate_bound, 1.0], flow.n_modes)
    tangent = unit[:, None] * Track(flow, 1.0, 0.0, sets, lengths).derivative_of_end_state / unit
    assert np.abs(tangent - unit[:, None] * exact_tangent / unit).max() < 1e-13


# --- periodic orbits, and the error predicted of a wave -------------------------------------------


RIGID = fc.UnilateralConstraint()


def next_to(solution: fc.PeriodicSolution) -> tuple[OrbitPrediction, PeriodicOrbit]:
    """What is predicted of a solution, and the orbit next to it."""
    assessment = solution.assessment
    assert (
        assessment.orbit_prediction_by_newton_step is not None
        and assessment.nearest_orbit is not None
    )
    return assessment.orbit_prediction_by_newton_step, assessment.nearest_orbit


def distance(solution: fc.PeriodicSolution, orbit: PeriodicOrbit) -> float:
    """Of the gaps over the period, relative to what moves of B^T u."""
    time = np.arange(512) * solution.period / 512
    slow = evaluate_series(solution.gap_series_without_static_part, solution.base_omega, time)
    size = size_of_motion(slow + solution.structure.clearance)
    return float(np.linalg.norm(solution.gap(time) - orbit.gap_at(time)) / size)


def light_chain(seed: int) -> fc.Structure:
    """30 masses, 5 pairs without mass, 12 modes."""
    structure = chain("modal", 30, 5, seed).varied(load=0.5)
    return fc.reduce_structure(structure, modes=12, method="massless")


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("light", [False, True])
def test_orbit_against_the_reference(seed: int, light: bool) -> None:
    """Gap and multipliers of the orbit by a flow that shares no code; the wave's error."""
    structure: fc.Structure = light_chain(seed) if light else chain(pairs=3, seed=seed)
    contact: object = RIGID if light else fc.UnilateralPenalty(20.0)
    solution = fc.solve_harmonic_balance(structure, 0.5, contact, harmonics=20)
    prediction, orbit = next_to(solution)
    reference, turn = reference_of(structure, contact, orbit.flow)
    passage = reference.advance(turn @ orbit.state, orbit.omega, 0.0, orbit.period, 100)
    assert relative(passage.state, turn @ orbit.state) < 1e-10
    gap = orbit.gap_at(orbit.period * np.arange(100) / 100)
    assert np.abs(gap - passage.gap).max() < 1e-11 * np.ptp(gap)
    max_multiplier = np.abs(np.linalg.eigvals(passage.tangent())).max()
    assert abs(orbit.multipliers[0]) == pytest.approx(max_multiplier, rel=1e-9)
    assert orbit.n_events == len(passage.pieces) - 1 > 0
    assert 0.2 < distance(solution, orbit) / prediction.relative_gap_error < 2.0


@pytest.mark.parametrize("light", [False, True])
def test_motion_in_arcs(light: bool) -> None:
    """Its parts begin where a prediction leads; from an orbit's own states it is the orbit."""
    structure: fc.Structure = light_chain(1) if light else chain(pairs=3, seed=1)
    contact: object = RIGID if light else fc.UnilateralPenalty(20.0)
    step, orbit = next_to(fc.solve_harmonic_balance(structure, 0.5, contact, harmonics=10))
    flow, time = orbit.flow, np.linspace(0.0, 0.999 * orbit.period, 300)
    motion = predict_motion(flow, 0.5, step, 1)
    assert relative(motion.period_samples.states[::16], step.states[:, : 2 * flow.n_modes]) < 1e-9
    prediction = predict_orbit_by_newton_step(flow, 0.5, orbit.period_samples.whole_states[::16])
    assert prediction is not None and prediction.relative_gap_error < 1e-8
    one_period_motion = predict_motion(flow, 0.5, prediction, 1)
    assert (
        one_period_motion is not None
        and relative(one_period_motion.gap_at(time), orbit.gap_at(time)) < 1e-7
    )
    assert one_period_motion.face_indicators["opening"] == pytest.approx(
        orbit.face_indicators["opening"], rel=1e-7
    )


def test_twice_the_period() -> None:
    """The bilinear oscillator's orbit of two periods of the load."""
    solution = period_two_orbit(40)
    _, orbit = next_to(solution)
    assert orbit.period == pytest.approx(solution.period)
    assert distance(solution, orbit) < 1e-4
    early_gap, late_gap = orbit.gap_at(np.array([0.3, 0.3 + 0.5 * orbit.period]))
    assert abs(early_gap[0] - late_gap[0]) > 0.1
    assert orbit.gap_at(np.array([0.3 + orbit.period]))[0] == pytest.approx(early_gap)


@pytest.mark.parametrize("seed", range(3))
def test_by_products_as_by_factors(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """The same orbit and the same prediction where M is not formed; its products are M's."""
    solution = fc.solve_harmonic_balance(light_chain(seed), 0.5, RIGID, harmonics=10)
    factor_prediction, orbit = next_to(solution)
    change = np.random.default_rng(seed).normal(size=orbit.flow.state_size)
    assert relative(orbit.motion.track @ change, orbit.monodromy @ change) < 1e-12
    monkeypatch.setattr("fenics_crack.motion.orbit.MAX_MODES_FOR_MONODROMY", 0)
    prediction = predict_orbit_by_newton_step(
        orbit.flow, orbit.omega, solution.assessment.states_at_period_parts
    )
    second_orbit = find_orbit(
        orbit.flow, orbit.omega, solution.assessment.states_at_period_parts[0]
    )
    assert prediction is not None and prediction.relative_gap_error == pytest.approx(
        factor_prediction.relative_gap_error, rel=0.05
    )
    assert relative(prediction.monodromy, factor_prediction.monodromy) < 1e-10
    assert second_orbit is not None and relative(second_orbit.state, orbit.state) < 1e-7


def test_by_omega() -> None:
    """The orbit moves with the frequency as its derivative says."""
    flow, omega, step = exact_flow_or_none(light_chain(1), RIGID), 0.5, 1e-5
    orbits = [find_orbit(flow, omega + h, np.zeros(flow.state_size)) for h in (0.0, step, -step)]
    middle_orbit, upper_orbit, lower_orbit = (orbit for orbit in orbits if orbit is not None)
    system = FlowOrbitEquations(flow, omega, middle_orbit.state)
    point = system.linearise(system.start_unknown, 1.0)
    slope = -point.solve(point.by_parameter) / (system.state_factors * omega)
    assert relative(slope, (upper_orbit.state - lower_orbit.state) / (2.0 * step)) < 1e-5


def test_the_least_periods_after_which_a_motion_is_where_it_was() -> None:
    """It nearly is after two times forty of the load, and is after four: to rounding."""
    flow = known(two_masses(), fc.UnilateralPenalty(100.0))
    orbits = FlowOrbitEquations(flow, 0.614, np.zeros(flow.state_size), 40)
    attractor = find_attractor(orbits, orbits.start_unknown)
    assert attractor.description == "settles to an orbit of 160 periods of the load"
    assert attractor.orbit is not None and abs(attractor.orbit.multipliers[0]) < 0.01


@pytest.mark.parametrize("light", [False, True])
def test_coefficients(light: bool) -> None:
    """Gauss's rule between events against very many samples; without contact they are exact."""
    structure: fc.Structure = light_chain(2) if light else chain(pairs=3, seed=2)
    flow = exact_flow_or_none(structure, RIGID if light else fc.UnilateralPenalty(20.0))
    settled_state = flow.advance(np.zeros(flow.state_size), 0.6, 30 * 2.0 * np.pi / 0.6).state
    orbit = find_orbit(flow, 0.6, settled_state)
    assert orbit is not None and orbit.n_events > 0
    coefficients, time = orbit.coefficients(6), np.arange(2**15) * orbit.period / 2**15
    assert relative(coefficients.gap, fourier_coefficients(orbit.gap_at(time), 6)) < 1e-6
    assert relative(coefficients.force, fourier_coefficients(orbit.force_at(time), 6)) < 1e-6
    assert (
        relative(coefficients.displacement, fourier_coefficients(orbit.displacement_at(time), 6))
        < 1e-6
    )
    fine_coefficients = orbit.coefficients(400)
    assert relative(coefficients.displacement, fine_coefficients.displacement[:13]) < 1e-12
    assert (
        relative(orbit.gap_at(time[::64]), evaluate_series(fine_coefficients.gap, 0.6, time[::64]))
        < 1e-3
    )


def test_open_crack() -> None:
    """Without contact the orbit is the linear response, whatever the start."""
    structure = oscillator(clearance=100.0)
    orbit = find_orbit(known(structure, fc.UnilateralPenalty(1.0)), 2.0, np.array([3.0, -1.0]))
    assert orbit is not None and orbit.n_events == 0
    linear = fc.solve_linear(structure, 2.0)
    linear_rows = np.vstack([linear.displacement_coefficients, np.zeros((0, 1))])
    assert orbit.coefficients(5).displacement == pytest.approx(linear_rows, abs=1e-11)
    decay = np.exp(-0.05 * orbit.period)
    assert np.abs(orbit.multipliers) == pytest.approx([decay, decay])


def test_no_orbit_is_cheap() -> None:
    """An undamped resonance has none: given up after few periods."""
    flow = known(oscillator(None, clearance=1e6), fc.UnilateralPenalty(1.0))
    assert find_orbit(flow, 1.0, np.zeros(2)) is None


# --- the search -----------------------------------------------------------------------------------


def test_search_without_guesses(monkeypatch: pytest.MonkeyPatch) -> None:
    """From rest along the motion, also to an orbit that it passes: a mass between two hard stops;
    where there is none, how near the motion came to where it was, in periods of the load."""
    two_stop_structure = fc.Structure.from_matrices(
        [[1.0]], [[1.0]], gap=[[1.0, -1.0]], force_cos=[0.644], force_sin=[1.332],
        clearance=0.02127, damping=[[0.6113]],
    )  # fmt: skip
    search = search_orbit(known(two_stop_structure, fc.UnilateralPenalty(900.0)), 2.6445, (), 3)
    assert search.orbit is not None and not search.orbit.is_stable and search.orbit.residual < 1e-6
    assert search.outcome_text == "exact orbit by integrating the motion over many periods"
    linear_flow = known(oscillator(None, clearance=1e6), fc.UnilateralPenalty(1.0))
    monkeypatch.setattr(SearchOptions, "period_budget", 300)
    search = search_orbit(linear_flow, 1.0, (), 3)
    words = re.search(r"after (\d+) periods of the load .* after (\d+)", search.outcome_text)
    assert search.orbit is None and words is not None
    assert int(words[1]) % 3 == 0 and int(words[2]) % 3 == 0


class Layer:
    """A law of two slopes: a share of the stiffness k up to a depth, all of it beyond."""

    def __init__(self, stiffness: float, share: float, depth: float) -> None:
        self.stiffness, self.share, self.depth = stiffness, share, depth

    def force(self, gap: np.ndarray) -> np.ndarray:
        """Return k (s max(g, 0) + (1 - s) max(g - p, 0))."""
        parts = self.share * np.maximum(gap, 0.0), np.maximum(gap - self.depth, 0.0)
        return self.stiffness * (parts[0] + (1.0 - self.share) * parts[1])

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """Return its slope."""
        return self.stiffness * (self.share * (gap > 0.0) + (1.0 - self.share) * (gap > self.depth))

    def scaled(self, factor: float) -> Layer:
        """Return the law with factor * k."""
        return Layer(factor * self.stiffness, self.share, self.depth)


@pytest.mark.parametrize("omega", [0.9, pytest.param(1.4, marks=pytest.mark.nightly)])
def test_two_slopes_are_two_penalties(omega: float) -> None:
    """A pair whose force has two slopes is two rows of one gap, each with a penalty and a clearance
    of its own: the exact orbit is that of 60 harmonics of the sampled force."""
    share, depth, gap = 0.4, 0.3, np.array([1.0, -0.5])
    springs = np.array([[2.0, -1.0], [-1.0, 1.5]])

    def oscillator(gaps: np.ndarray, clearance: list[float]) -> fc.Structure:
        return fc.Structure.from_matrices(
            np.eye(2), springs, gap=gaps, clearance=clearance, force_sin=[0.0, 1.0],
            damping=fc.ModalDamping(0.03),
        )  # fmt: skip

    rows = oscillator(np.column_stack([gap, gap]), [0.1, 0.1 + depth])
    penalties = fc.UnilateralPenalty([3.0 * share, 3.0 * (1.0 - share)])
    orbit = fc.solve_harmonic_balance(rows, omega, penalties, tolerance=1e-2).orbit
    assert orbit is not None and orbit.indicators_of_dofs([1])[0].penetration > 1.2 * depth
    pair, law = oscillator(gap, [0.1]), Layer(3.0, share, depth)
    sampled_solution = fc.solve_harmonic_balance(pair, omega, law, harmonics=60, samples=8192)
    assert orbit.amplitude(1) == pytest.approx(sampled_solution.amplitude(1), rel=1e-6)
    force = sampled_solution.face_indicators["crack_force"]
    assert orbit.face_indicators["crack_force"] == pytest.approx(force, rel=1e-5)
