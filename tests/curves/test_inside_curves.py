"""Parts of curves that the public face does not show: paths of exact orbits against closed forms
and a flow that shares no code with them, the linear flow of smooth laws, what is interrupted."""

from __future__ import annotations

import io
import re
from collections.abc import Callable
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.linalg
import scipy.special
from helpers import (
    OMEGA_0,
    Cubic,
    catch_error,
    chain,
    dense_matrices,
    oscillator,
    relative,
    two_masses,
    wrap,
)
from mpi4py import MPI
from reference_flow import ReferenceFlow
from rotating import cracked
from scipy.integrate import solve_ivp
from test_coupled_curves import SPAN, folds, steel

import fenics_crack as fc
from fenics_crack import continue_frequency
from fenics_crack.basics.errors import INTERRUPTED_CURVE_STATUS
from fenics_crack.curves import continuation
from fenics_crack.curves.balance_equations import BalanceEquations
from fenics_crack.curves.branch import find_branch_start_point
from fenics_crack.curves.continuation import Continuation
from fenics_crack.curves.orbit_events import (
    MIN_REJECTABLE_TO_LONGEST_STEP,
    MultiplierStepControl,
    changes_of_multiplier_counts,
    leading_multipliers_and_counts,
)
from fenics_crack.curves.orbits import OrbitEquations
from fenics_crack.curves.stability import monodromy_of_linear_flow
from fenics_crack.model.modal import all_modes
from fenics_crack.motion.flow import exact_flow_or_error
from fenics_crack.motion.orbit import PeriodicOrbit, find_orbit
from fenics_crack.motion.search import series_states_at_period_parts
from fenics_crack.numerics.newton import point_on_path
from fenics_crack.numerics.path import Path, PathOptions, Target

LAW = fc.UnilateralPenalty(100.0)
EXACT = {
    "period_doubling": (0.7387830254, 0.7555861594),
    "fold": (0.7556273526, 0.6534401345),
    "neimark_sacker": (0.6186068743,),
}
"""Two masses and a stop, from 0.6 to 0.9 rad/s: where the equations of 21 to 121 harmonics lead
to."""
RANGES = {
    "omega": (1.1, 1.6),
    "load": (0.5, 2.0),
    "stiffness": (0.3, 3.0),
    "damping": (0.0, 2.0),
    "clearance": (-0.2, 0.3),
}


def orbit_at(problem: fc.Problem) -> PeriodicOrbit:
    """An orbit near the harmonic-balance solution of a problem."""
    flow, law = exact_flow_or_error(problem.structure, problem.contact), problem.contact
    for harmonics in (10, 40):
        wave = fc.solve_harmonic_balance(
            problem.structure, problem.omega, law, harmonics=harmonics, throw=False
        )
        state = series_states_at_period_parts(flow, wave.displacement_coefficients, wave.omega)[0]
        orbit = find_orbit(flow, problem.omega, state)
        if orbit is not None and orbit.residual < 1e-6:
            return orbit
    raise AssertionError("no orbit")


def followed(
    problem: fc.Problem, parameter: str, start: float, end: float, step: float = 0.05
) -> Continuation:
    """The curve from its start on."""
    start_orbit = orbit_at(OrbitEquations(problem, parameter, start, end).problem_at(start))
    path = Continuation(
        problem,
        parameter,
        start,
        end,
        exact=True,
        initial=start_orbit,
        longest_step=step,
        most_points=3000,
    )
    path.run()
    return path


def special(path: Continuation) -> list[fc.Bifurcation]:
    """All bifurcations."""
    curve = path.curve
    assert curve.exact
    return list(curve.bifurcations)


def states(path: Continuation) -> np.ndarray:
    """Of all points."""
    curve = path.curve
    assert curve.exact
    return curve.points


@pytest.fixture(scope="module")
def stop() -> Continuation:
    """Two masses and a stop."""
    return followed(fc.Problem(two_masses(), 0.6, LAW), "omega", 0.6, 0.9)


# --- the equations --------------------------------------------------------------------------------


@pytest.mark.parametrize("parameter", RANGES)
@pytest.mark.parametrize("damping", ["modal", "matrix"])
def test_derivatives(parameter: str, damping: str) -> None:
    """dF/dx and dF/dp against central differences, through openings and closings."""
    problem = fc.Problem(chain(damping), 1.3, fc.UnilateralPenalty(5.0))
    family = OrbitEquations(problem, parameter, *RANGES[parameter])
    unknown, place, step = np.random.default_rng(1).normal(size=family.shape), 0.37, 1e-5
    point = family.linearise(unknown, place)
    assert point.n_events > 2
    assert point.residual == pytest.approx(
        family.advance_unknown(unknown, place) - unknown, abs=1e-11
    )

    def difference(dx: np.ndarray, dp: float) -> np.ndarray:
        upper_residual, lower_residual = (
            family.linearise(unknown + side * step * dx, place + side * step * dp).residual
            for side in (1.0, -1.0)
        )
        return (upper_residual - lower_residual) / (2.0 * step)

    rate = difference(np.zeros_like(unknown), 1.0)
    assert point.by_parameter == pytest.approx(rate, abs=1e-6 * np.abs(rate).max())
    way = np.random.default_rng(2).normal(size=family.shape)
    assert point.jacobian @ way == pytest.approx(difference(way, 0.0), abs=1e-6)


@pytest.mark.drawn(3)
@pytest.mark.parametrize("parameter", RANGES)
def test_end_is_the_orbit_found_there(parameter: str) -> None:
    """By the problem varied as a whole, and Newton's method on its own flow."""
    problem = fc.Problem(chain(), 1.3, fc.UnilateralPenalty(5.0))
    path = followed(problem, parameter, *RANGES[parameter], 0.1)
    assert path.complete and path.progress_fraction() == 1.0
    family = OrbitEquations(problem, parameter, *RANGES[parameter])
    last_point, end_problem, state = (
        path.points[-1],
        family.problem_at(RANGES[parameter][1]),
        states(path)[-1],
    )
    assert (
        last_point.value == pytest.approx(RANGES[parameter][1])
        and last_point.omega == end_problem.omega
    )
    orbit = find_orbit(
        exact_flow_or_error(end_problem.structure, end_problem.contact),
        end_problem.omega,
        1.001 * state,
    )
    assert state == pytest.approx(orbit.state, abs=1e-7 * np.abs(orbit.state).max())
    assert np.abs(last_point.multipliers) == pytest.approx(np.abs(orbit.multipliers[:8]), abs=1e-7)


def test_over_the_speed_of_a_rotor() -> None:
    """Orbits in the modes of each speed; the derivative against a wider difference."""
    full_structure = fc.build_structure(cracked(600.0, -250.0), MPI.COMM_SELF)
    rotor = fc.run_up_structure(full_structure, 560.0, 640.0, 4).at_speed(600.0)
    problem = fc.Problem(rotor, 12 * 600.0, fc.UnilateralConstraint())
    family = OrbitEquations(problem, "speed", 560.0, 640.0)
    orbit = orbit_at(family.problem_at(600.0))
    assert orbit.n_events > 0 and family.omega(620.0) == pytest.approx(12 * 620.0)
    unknown = family.unknown(orbit.state, 600.0)
    assert family.unscaled_solution(unknown, 600.0) == pytest.approx(orbit.state, abs=1e-12)
    size = np.abs(unknown).max()
    point, step = family.linearise(unknown, 0.5), 1e-5
    assert point.residual == pytest.approx(0.0, abs=1e-9 * size)
    upper_residual, lower_residual = (
        family.linearise(unknown, 0.5 + dp).residual for dp in (step, -step)
    )
    rate = (upper_residual - lower_residual) / (2.0 * step)
    assert point.by_parameter == pytest.approx(rate, abs=1e-4 * np.abs(rate).max())


def test_twice_the_load_and_clearance_is_twice_the_motion() -> None:
    """A clearance that grows from c to 2 c is a load that falls from 1 to 1/2, times two."""
    problem = fc.Problem(oscillator(clearance=0.5), 1.2, fc.UnilateralPenalty(1.0))
    closer, wider = (
        followed(problem, *path_range)
        for path_range in (("load", 1.0, 0.5), ("clearance", 0.0, 0.5))
    )
    assert states(wider)[-1] == pytest.approx(2.0 * states(closer)[-1], abs=1e-8)
    end_multipliers = [path.points[-1].multipliers for path in (closer, wider)]
    assert end_multipliers[1] == pytest.approx(end_multipliers[0], abs=1e-8)


def test_without_contact() -> None:
    """A stop too far away: linear response and multipliers exp(-c T / 2 +- i w T) all along."""
    problem = fc.Problem(oscillator(clearance=50.0), 0.5, fc.UnilateralPenalty(1.0))
    path = followed(problem, "omega", 0.5, 2.0)
    assert path.complete and not special(path)
    for point, state in zip(path.points, states(path), strict=True):
        omega, period = point.omega, 2.0 * np.pi / point.omega
        wave = 1.0 / (1.0 - omega**2 + 0.1j * omega)
        assert np.abs(state) == pytest.approx(
            np.abs([wave.real, -omega * wave.imag]), rel=1e-7, abs=1e-8
        )
        turn = np.exp((-0.05 + 1j * np.sqrt(1.0 - 0.05**2)) * period)
        assert np.sort_complex(point.multipliers) == pytest.approx(
            np.sort_complex([turn, turn.conjugate()]), abs=1e-8
        )


def test_paths_keep_what_the_kernel_records(stop: Continuation) -> None:
    """M of each point is that of the equations there."""
    family = OrbitEquations(fc.Problem(two_masses(), 0.6, LAW), "omega", 0.6, 0.9)
    start = point_on_path(family, stop.points[0].unknown, 0.0)
    recorded_controls: list[np.ndarray] = []

    class Watched(MultiplierStepControl):
        def mark_rejected_steps(self, points: Any, first_index: int = 0) -> np.ndarray:
            recorded_controls.append(points.step_control_values[-1])
            return np.zeros(len(points) - 1 - first_index, dtype=bool)

    path = Path(family, start, PathOptions(0.05, 0.05), [Target(0.3)], Watched(0.05))
    for stretch in path:
        point = family.linearise(stretch.unknowns[-1], float(stretch.parameters[-1]))
        assert stretch.step_control_values[-1] == pytest.approx(
            leading_multipliers_and_counts(np.linalg.eigvals(point.monodromy[None]))[0], abs=1e-7
        )
    assert path.terminal_event is not None and len(recorded_controls) > 2


def test_a_halved_step_keeps_the_points_before_it(stop: Continuation) -> None:
    """A path consists of the points up to each step that is too long, and of no others; the next
    steps are at most half as long, and twice that where none was too long."""
    family = OrbitEquations(fc.Problem(two_masses(), 0.6, LAW), "omega", 0.6, 0.9)
    start = point_on_path(family, stop.points[0].unknown, 0.0)
    longest_step = 0.02
    kept_points = [np.zeros(1)]
    kept_counts: list[int] = []
    step_ratios: list[float] = []

    class ShortBehind(MultiplierStepControl):
        bound = longest_step

        def mark_rejected_steps(self, points: Any, first_index: int = 0) -> np.ndarray:
            ends = points.parameters
            is_long = (np.diff(ends) > 0.003) & (ends[1:] > 0.05)
            n_kept = [*np.flatnonzero(is_long), len(is_long)][0] + 1
            new_lengths = points.chord_lengths[ends > kept_points[-1][-1]]
            step_ratios.append(new_lengths.max() / self.bound)
            self.bound = min(2.0 * self.bound, longest_step)
            if is_long.any():
                self.bound = 0.5 * points.chord_lengths[n_kept]
            kept_points.append(ends[:n_kept])
            kept_counts.append(int(n_kept) if is_long.any() else 0)
            return is_long[first_index:]

    options = PathOptions(longest_step, longest_step, max_steps=12)
    path = Path(family, start, options, [], ShortBehind(longest_step))
    parameters = [0.0, *(point.parameter for point in path.points())]
    assert len(parameters) == 13 and max(kept_counts) > 2  # halved behind points of the same call
    assert parameters == np.unique(np.concatenate(kept_points)).tolist()
    assert max(step_ratios) == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("points_before", [0, 1])
def test_a_halved_step_beside_a_crossing(points_before: int) -> None:
    """Two like oscillators, weakly coupled: other branches cross their path twice, also if a step
    is halved behind the first crossing, or before it, so that it is passed again."""
    twins = fc.Structure.from_matrices(
        np.eye(2), [[1.005, -0.005], [-0.005, 1.005]], gap=np.eye(2), force_cos=[0.1, 0.1],
        damping=0.05 * np.eye(2), clearance=1.0,
    )  # fmt: skip
    problem = fc.Problem(twins, 0.8, fc.UnilateralPenalty(1.0))
    begin = followed(problem, "omega", 0.8, 0.81).points[0].unknown
    family = OrbitEquations(problem, "omega", 0.8, 1.5)
    crossings: list[list[float]] = []

    class OnceBesideCrossing(MultiplierStepControl):
        is_done = False

        def mark_rejected_steps(self, points: Any, first_index: int = 0) -> np.ndarray:
            is_long = np.zeros(len(points) - 1, dtype=bool)
            places = np.flatnonzero(points.crosses_branch[:-1])
            if len(places) and not self.is_done:
                is_long[places[0] - points_before] = self.is_done = True
            return is_long[first_index:]

    for is_undisturbed in (True, False):
        control = OnceBesideCrossing(0.05)
        control.is_done = is_undisturbed
        path = Path(
            family, point_on_path(family, begin, 0.0), PathOptions(0.02, 0.05, max_steps=120), [],
            control,
        )  # fmt: skip
        crossings.append([point.parameter for point in path.points() if point.crosses_branch])
    assert len(crossings[0]) == len(crossings[1]) == 2
    assert crossings[1] == pytest.approx(crossings[0], abs=1e-4)  # where points lie


# --- bifurcations ---------------------------------------------------------------------------------


def test_bifurcations_of_two_masses_and_a_stop(stop: Continuation) -> None:
    """Where many harmonics lead to, each on the unit circle."""
    bifurcations = special(stop)
    assert stop.complete and stop.status == "reached the end"
    for kind, values in EXACT.items():
        same_kind = [bifurcation for bifurcation in bifurcations if bifurcation.kind == kind]
        assert [bifurcation.value for bifurcation in same_kind][: len(values)] == pytest.approx(
            values, rel=1e-8
        )
        assert len(same_kind) == len(values)


def test_bifurcations_by_the_reference_flow(stop: Continuation) -> None:
    """States are orbits of another integration, with a multiplier where it must be; but for the
    fold where the stop is only just touched: there multipliers jump."""
    bifurcations = special(stop)
    assert (
        bifurcations[-1].kind == "fold" and np.abs(bifurcations[-1].multipliers - 1.0).min() > 1e-4
    )
    flow = ReferenceFlow(two_masses(), LAW)
    for bifurcation in bifurcations[:-1]:
        shapes = bifurcation.orbit.flow.modal_model.shapes
        state = flow.state(*(shapes @ part for part in np.split(bifurcation.orbit.state, 2)))
        passage = flow.advance(state, bifurcation.value, 0.0, 2.0 * np.pi / bifurcation.value)
        assert passage.state == pytest.approx(state, abs=1e-8)
        mu = np.linalg.eigvals(passage.tangent())
        pair = np.abs(mu[mu.imag > 0.0])
        distances = {
            "fold": np.abs(mu - 1.0).min(),
            "period_doubling": np.abs(mu + 1.0).min(),
            "neimark_sacker": np.abs(pair - 1.0).min(initial=np.inf),
        }
        assert distances[bifurcation.kind] < 1e-5


def test_one_by_one_is_the_same(stop: Continuation) -> None:
    """Iterating yields what a run records."""
    start_orbit = stop.curve.orbit(0)  # type: ignore[attr-defined]
    problem = fc.Problem(two_masses(), 0.6, LAW)
    path = Continuation(
        problem, "omega", 0.6, 0.9, exact=True, initial=start_orbit, most_points=3000
    )
    points = list(path)
    assert len(points) == len(stop.points) and path.status == stop.status
    assert [point.value for point in points] == [point.value for point in stop.points]
    bifurcations = [bifurcation for point in points for bifurcation in point.bifurcations]
    assert bifurcations == [(point.kind, point.value) for point in special(stop)]


def test_goes_on_where_it_was_stopped(stop: Continuation) -> None:
    """By too few points at first, and it says so; more are then allowed."""
    problem, half = fc.Problem(two_masses(), 0.6, LAW), len(stop.points) // 2
    start_orbit = stop.curve.orbit(0)  # type: ignore[attr-defined]
    continuation = Continuation(
        problem, "omega", 0.6, 0.9, exact=True, initial=start_orbit, most_points=half
    )
    continuation.run()
    assert not continuation.complete and f"within {half} points" in continuation.status
    part, continuation.most_points = continuation.curve, 3000
    continuation.run()
    bifurcation_values = [bifurcation.value for bifurcation in continuation.curve.bifurcations]
    exact_positions = [bifurcation.value for bifurcation in special(stop)]
    assert continuation.complete and bifurcation_values == pytest.approx(exact_positions, rel=1e-8)
    assert continuation.curve.values[: half + 1] == pytest.approx(part.values, rel=1e-12)


def test_turns_back_past_its_start(stop: Continuation) -> None:
    """Behind the first fold, where it may not turn back."""
    place = next(k for k, curve_point in enumerate(stop.points) if curve_point.value > 0.7)
    start_orbit = stop.curve.orbit(place)  # type: ignore[attr-defined]
    path = Continuation(
        fc.Problem(two_masses(), 0.7, LAW), "omega", start_orbit.omega, 0.9, exact=True,
        initial=start_orbit, most_points=500, max_turn_back_fraction=0.0,
    )  # fmt: skip
    path.run()
    assert not path.complete and path.has_returned
    assert path.status.startswith("it turned back past its start")


# --- branches of twice the period -----------------------------------------------------------------


def test_branch_of_twice_the_period(stop: Continuation) -> None:
    """From one doubling of the oscillator to the other, through orbits of period two."""
    problem = fc.Problem(oscillator(), 1.5, fc.UnilateralPenalty(1.0))
    single = followed(problem, "omega", 1.5, 3.0)
    first_point, second_point = special(single)
    assert {first_point.kind, second_point.kind} == {"period_doubling"}
    assert first_point.value < 2.0 * OMEGA_0 < second_point.value
    twofold = fc.Problem(oscillator(), 1.5, fc.UnilateralPenalty(1.0), 10, subharmonic=2)
    path = Continuation(
        twofold, "omega", 1.5, 3.0, exact=True, initial=first_point, branch_of=single.curve,
        most_points=500, max_turn_back_fraction=0.0,
    )  # fmt: skip
    path.run()
    assert path.complete and path.status == "joined the branch that it left"
    assert path.points[-1].value == pytest.approx(second_point.value, rel=1e-6)
    curve: Any = path.curve
    orbit = curve.orbit(len(curve) // 2)
    period = 2.0 * np.pi / orbit.omega
    state_after_one = orbit.flow.advance(orbit.state, orbit.omega, period).state
    state_after_two = orbit.flow.advance(state_after_one, orbit.omega, period, start=period).state
    assert state_after_two == pytest.approx(orbit.state, abs=1e-8)
    assert np.abs(state_after_one - orbit.state).max() > 0.1 * np.abs(orbit.state).max()


def test_no_branch_of_twice_the_period_from_a_fold(stop: Continuation) -> None:
    """Where no multiplier is -1 there is none."""
    problem = fc.Problem(two_masses(), 0.6, LAW, 10, subharmonic=2)
    doubled_family = OrbitEquations(problem, "omega", 0.6, 0.9)
    curve = stop.curve
    fold = curve.bifurcation("period_doubling", 0.6, 0.6, curve.points[0])
    catch_error(
        lambda: find_branch_start_point(doubled_family, fold, 0.05),
        names="the other branch",
        kind=fc.ConvergenceError,
    )


# --- steps and events -----------------------------------------------------------------------------


def row(*values: complex) -> np.ndarray:
    """What is observed where multipliers are these."""
    blocks = np.zeros((len(values) * 2,) * 2)
    size = 0
    for value in values:
        if isinstance(value, complex):
            blocks[size : size + 2, size : size + 2] = [
                [value.real, value.imag], [-value.imag, value.real]
            ]  # fmt: skip
            size += 2
        else:
            blocks[size, size] = value
            size += 1
    return leading_multipliers_and_counts(np.linalg.eigvals(blocks[None, :size, :size]))[0]


@pytest.mark.parametrize("damping", ["modal", "matrix"])
@pytest.mark.parametrize("rigid", [False, True])
def test_motions_of_all_points_are_those_of_each(damping: str, rigid: bool) -> None:
    """Computed at once over the frequency as by the compliance of each point by itself."""
    structure, law = chain(damping), fc.UnilateralPenalty(5.0)
    span = 0.9 * fc.solve_modes(structure, 1).omega[0], 1.1 * fc.solve_modes(structure, 1).omega[0]
    if rigid:
        structure = fc.reduce_structure(structure, modes=4, method="massless")
        law = fc.UnilateralConstraint()
    curve = continue_frequency(structure, *map(float, span), law, harmonics=6, throw=False)
    for place, assessment in enumerate(curve.assessments(range(len(curve)))):
        problem = curve.problem_of(place)
        linearisation = problem.system(problem.compliance_model()).linearise(curve.points[place])
        point_wave = problem.wave(linearisation)
        assert (
            assessment.wave.omega == point_wave.omega
            and assessment.wave.static_above == point_wave.static_above
        )
        for name in ("displacement", "gap", "force"):
            curve_rows, point_rows = (
                getattr(wave, name + "_coefficients") for wave in (assessment.wave, point_wave)
            )
            assert relative(curve_rows, point_rows) < 1e-12


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [
        ((0.9 + 0.1j, -0.9, 0.1), (0.9 + 0.1j, -1.1, 0.1), (0, 1, 0)),
        ((0.9 + 0.1j, 0.2), (1.2 + 0.1j, 0.2), (0, 0, 1)),
        ((1.5, 1.4, 0.1), (1.45 + 0.1j, 0.1), (0, 0, 0)),  # two reals become a pair
        ((-1.45 + 0.1j, 0.1), (-1.5, -1.4, 0.1), (0, 0, 0)),
        ((1.5, -1.4, 0.1), (1.45 + 0.1j, 0.1), (-1, -1, 1)),  # of two signs they cannot
        ((0.3, 0.2), (1.0 + 5e-7, 0.2), (0, 0, 0)),  # within 1e-6 of the circle
    ],
)
def test_what_counts_as_a_change(before: Any, after: Any, expected: tuple[int, ...]) -> None:
    """Of r, d and c."""
    assert changes_of_multiplier_counts(np.array([row(*before), row(*after)]))[0].tolist() == list(
        expected
    )


@pytest.mark.parametrize(
    ("logs", "lengths", "expected"),
    [
        ((-0.5, -0.45, -0.4), (0.0, 1.0, 1.0), (False, False)),
        ((-0.5, -0.1, 0.3), (0.0, 1.0, 1.0), (True, True)),  # more than half of its distance
        (
            (-0.5, -0.5, -0.52),
            (0.0, MIN_REJECTABLE_TO_LONGEST_STEP / 2, MIN_REJECTABLE_TO_LONGEST_STEP / 2),
            (False, False),
        ),
        # Not below the shortest step.
        (
            (-0.5, -0.1, 0.3),
            (0.0, MIN_REJECTABLE_TO_LONGEST_STEP / 2, MIN_REJECTABLE_TO_LONGEST_STEP / 2),
            (False, False),
        ),
        ((-0.06, -0.08, -0.06), (0.0, 1.0, 1.0), (False, True)),  # not as it came
        ((-0.06, -0.08, -0.16), (0.0, 1.0, 2.0), (False, True)),  # by as much
    ],
)
def test_steps_that_are_halved(logs: Any, lengths: Any, expected: tuple[bool, ...]) -> None:
    """By one real multiplier; the longest step is 1."""
    control_values = np.array([row(float(np.exp(logarithm)), 1e-3) for logarithm in logs])
    records = np.array([np.diag([np.exp(logarithm), 1e-3]).ravel() for logarithm in logs])
    points: Any = SimpleNamespace(
        step_control_values=control_values, records=records, chord_lengths=np.array(lengths)
    )
    assert tuple(MultiplierStepControl(1.0).mark_rejected_steps(points)) == expected


def test_several_changes_are_parted_below_the_floor() -> None:
    """Two events in one step are halved until each is by itself."""
    control_values = np.array([row(-0.999, 0.99 + 0.1j), row(-1.001, 1.0 + 0.1j)])
    records, lengths = np.tile(np.eye(2).ravel(), (2, 1)), np.array([0.0, 1e-6])
    points: Any = SimpleNamespace(
        step_control_values=control_values, records=records, chord_lengths=lengths
    )
    assert MultiplierStepControl(1.0).mark_rejected_steps(points).tolist() == [True]


# --- the linear flow of smooth laws ---------------------------------------------------------------


def integrated(law: Any, solution: fc.PeriodicSolution) -> np.ndarray:
    """M of the modes that move by SciPy's integrator, the law evaluated at its own instants."""
    modes, residual = all_modes(solution.structure), solution.residual_compliance
    if solution.static_above is not None:
        modes = modes.with_fast_modes_quasi_static(solution.static_above)
    n, unit = len(modes.squares), np.eye(solution.structure.n_pairs)
    damping = np.diag(modes.damping) if modes.damping.ndim == 1 else modes.damping

    def rate(time: float, state: np.ndarray) -> np.ndarray:
        state_matrix = state.reshape(2 * n, 2 * n)
        slope = np.diag(law.tangent(solution.gap(np.array([time])))[0])
        if residual is not None:  # d lambda / ds of lambda = h(s - R lambda)
            slope = slope @ np.linalg.inv(unit + residual @ slope)
        push = modes.squares[:, None] * state_matrix[:n] + damping @ state_matrix[n:]
        push += modes.gaps_by_mode @ (slope @ (modes.gaps_by_mode.T @ state_matrix[:n]))
        return np.concatenate([state_matrix[n:], -push]).ravel()

    run = solve_ivp(
        rate, (0.0, solution.period), np.eye(2 * n).ravel(), "DOP853", rtol=1e-9, atol=1e-11
    )
    return run.y[:, -1].reshape(2 * n, 2 * n)


@pytest.mark.parametrize("damping", ["modal", "matrix", "overdamped"])
def test_against_an_integrator(damping: str) -> None:
    """Three pairs with clearances, and modes that do not oscillate at all."""
    structure = chain("matrix" if damping == "matrix" else "modal")
    if damping == "overdamped":
        mass, _, stiffness = dense_matrices(structure)
        structure = fc.Structure.from_matrices(
            mass, stiffness, gap=structure.gap.toarray(), force_cos=structure.force[1],
            damping=fc.ModalDamping([1.5] * 4 + [0.1] * 6), clearance=structure.clearance,
        )  # fmt: skip
    law = fc.SmoothedPenalty(np.array([3.0, 5.0, 9.0]), 4.0)
    solution = fc.solve_harmonic_balance(structure, 1.1, law, harmonics=20)
    exact = integrated(law, solution)
    matrix = monodromy_of_linear_flow(
        structure, law, solution.gap_coefficients, solution.base_omega
    )
    assert relative(matrix, exact) < 2e-6
    stability = fc.floquet(structure, solution)
    max_multiplier = np.abs(np.linalg.eigvals(exact)).max()
    assert abs(stability.multipliers[0]) == pytest.approx(max_multiplier, rel=1e-6)
    assert stability.verdict == ("stable" if max_multiplier < 1.0 else "unstable")
    assert stability.uncertainty < 1e-3


@pytest.mark.usefixtures("predicted_errors")
def test_pairs_behind_a_compliance() -> None:
    """Lips without mass: modes alone move, tied by the slopes of lambda(s)."""
    structure = fc.reduce_structure(chain("modal"), modes=4, method="massless")
    law = fc.SmoothedPenalty(20.0, 4.0)
    solution = fc.solve_harmonic_balance(structure, 1.1, law, harmonics=8)
    gap, static_above = solution.gap_series_without_static_part, solution.static_above
    matrix = monodromy_of_linear_flow(structure, law, gap, solution.base_omega, static_above)
    assert relative(matrix, integrated(law, solution)) < 2e-6
    assert fc.floquet(structure, solution).verdict != "undecided"


@dataclass(frozen=True)
class Square:
    """lambda = c g^2 / 2, whose stiffness is the gap."""

    stiffness: float = 1.0

    def force(self, gap: np.ndarray) -> np.ndarray:
        """c g^2 / 2."""
        return 0.5 * self.stiffness * gap**2

    def tangent(self, gap: np.ndarray) -> np.ndarray:
        """c g."""
        return self.stiffness * gap

    def scaled(self, factor: float) -> Square:
        """The same with another c."""
        return Square(factor * self.stiffness)


@pytest.mark.parametrize(("order", "even"), [(1, True), (2, True), (2, False), (3, False)])
def test_mathieu(order: int, even: bool) -> None:
    """x'' + (a - 2 q cos 2t) x = 0 has at the characteristic values a_r(q), b_r(q) the multiplier
    (-1)^r, twice, in a period pi."""
    q = 5.0
    characteristic = scipy.special.mathieu_a if even else scipy.special.mathieu_b
    unit = np.ones((1, 1))
    structure = fc.Structure.from_matrices(unit, characteristic(order, q) * unit, gap=unit)
    gap = np.array([[0.0], [-2.0 * q], [0.0]])
    matrix = monodromy_of_linear_flow(structure, Square(), gap, 2.0)
    assert np.trace(matrix) == pytest.approx(2.0 * (-1.0) ** order, abs=2e-5)
    assert np.linalg.det(matrix) == pytest.approx(1.0, abs=1e-5)


def test_without_pairs() -> None:
    """The multipliers of the modes, exp(-c T / 2) in size."""
    structure = fc.Structure.from_matrices(
        np.eye(2), np.diag([1.0, 2.0]), gap=np.zeros((2, 0)), force_cos=[1.0, 0.0],
        damping=0.1 * np.eye(2),
    )  # fmt: skip
    linear = fc.solve_linear(structure, 0.7, harmonics=3)
    stability = fc.floquet(structure, linear, fc.SmoothedPenalty(1.0, 1.0))
    assert stability.verdict == "stable"
    assert np.abs(stability.multipliers) == pytest.approx(np.exp(-0.05 * linear.period), rel=1e-9)


def test_many_at_once_are_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    """However many stretches of the period are advanced together."""
    structure, law = chain("matrix"), fc.SmoothedPenalty(3.0, 4.0)
    gap = fc.solve_harmonic_balance(structure, 1.1, law, harmonics=6).gap_coefficients
    single_monodromy = monodromy_of_linear_flow(structure, law, gap, 1.1)
    monkeypatch.setattr("fenics_crack.curves.stability.N_MODAL_COORDINATES_IN_CPU_CACHE", 1)
    assert relative(monodromy_of_linear_flow(structure, law, gap, 1.1), single_monodromy) < 1e-10


# --- curves ---------------------------------------------------------------------------------------


def test_points_of_a_duffing_curve_are_judged_as_solutions_are() -> None:
    """Up, back and up again: the middle is unstable, and verdicts change at the folds alone, where
    a multiplier passes 1."""
    structure, law = oscillator(0.05, 1.0), Cubic(0.1)
    curve = fc.continue_frequency(
        structure, 0.8, 2.6, law, harmonics=6, stability=True, longest_step=0.2
    )
    assert [bifurcation.kind for bifurcation in curve.bifurcations] == ["fold", "fold"]
    upper_fold, lower_fold = (bifurcation.value for bifurcation in curve.bifurcations)
    turns = np.flatnonzero(np.diff(np.sign(np.diff(curve.omega)))) + 1
    assert set(curve.verdicts[np.arange(turns[0] + 1, turns[1])]) == {"unstable"}
    verdicts_off_folds = np.delete(curve.verdicts, np.arange(turns[0] - 1, turns[1] + 2))
    assert set(verdicts_off_folds) == {"stable"} and lower_fold < upper_fold
    for bifurcation in curve.bifurcations:
        values = fc.floquet(structure, bifurcation.solution).multipliers
        assert np.abs(values - 1.0).min() < 1e-3
    for place in range(0, len(curve), 8):
        stability = fc.floquet(structure, curve.solution(place))
        assert curve.verdicts[place] == stability.verdict
        assert abs(curve.multipliers[place]) == pytest.approx(
            abs(stability.multipliers[0]), rel=1e-9
        )


@pytest.fixture(scope="module")
def doubling() -> fc.ResponseCurve:
    """A smoothed stop as stiff as the mass's own spring, over twice its frequency."""
    law = fc.SmoothedPenalty(1.0, 20.0)
    return fc.continue_frequency(oscillator(), 1.5, 3.0, law, harmonics=12, stability=True)


def test_period_doublings_of_a_smooth_law(doubling: fc.ResponseCurve) -> None:
    """Between two points: a multiplier is -1 by an integrator, too; verdicts change there."""
    assert [bifurcation.kind for bifurcation in doubling.bifurcations] == 2 * ["period_doubling"]
    for bifurcation in doubling.bifurcations:
        values = np.linalg.eigvals(integrated(doubling.contact, bifurcation.solution))
        assert np.abs(values + 1.0).min() < 1e-4
    first_omega, second_omega = (bifurcation.value for bifurcation in doubling.bifurcations)
    unstable = (doubling.omega > first_omega) & (doubling.omega < second_omega)
    assert np.array_equal(doubling.verdicts == "unstable", unstable)


@pytest.mark.nightly
def test_branch_of_twice_the_period_of_a_smooth_law(doubling: fc.ResponseCurve) -> None:
    """It begins where the multiplier is -1, stable where the old one is not."""
    branch = fc.follow_branch(doubling, doubling.bifurcations[0], stability=True)
    assert branch.status == "joined the branch that it left"
    assert np.mean(branch.verdicts == "stable") > 0.8
    assert branch.omega[-1] == pytest.approx(doubling.bifurcations[1].value, rel=1e-2)


def test_neimark_sacker_point_of_a_smooth_law() -> None:
    """Two masses and a rounded stop: a pair leaves the unit circle, by an integrator, too."""
    stiffness = np.array([[1.0, -1.0], [-1.0, 2.0]])
    structure = fc.Structure.from_matrices(
        np.eye(2), stiffness, gap=[1.0, 0.0], force_cos=[0.0, 0.1], clearance=1.0,
        damping=0.03 * stiffness,
    )  # fmt: skip
    law = fc.SmoothedPenalty(20.0, 30.0)
    curve = fc.continue_frequency(structure, 0.58, 0.62, law, harmonics=20, stability=True)
    neimark_sacker_points = [
        bifurcation for bifurcation in curve.bifurcations if bifurcation.kind == "neimark_sacker"
    ]
    assert neimark_sacker_points
    for bifurcation in neimark_sacker_points:
        values = np.linalg.eigvals(integrated(law, bifurcation.solution))
        pair = values[np.abs(values.imag) > 1e-3]
        assert np.abs(np.abs(pair) - 1.0).min() < 1e-4


def test_judged_again(doubling: fc.ResponseCurve) -> None:
    """The same verdicts and bifurcations, each once."""
    judged_curve = fc.judge_curve(doubling)
    assert np.array_equal(judged_curve.verdicts, doubling.verdicts)
    assert [bifurcation.value for bifurcation in judged_curve.bifurcations] == [
        bifurcation.value for bifurcation in doubling.bifurcations
    ]


def test_rigid_contact_of_pairs_with_mass_has_no_verdicts() -> None:
    """Said before anything is followed, with what to do instead."""
    structure, law = chain("modal"), fc.UnilateralConstraint()
    catch_error(
        lambda: fc.continue_frequency(structure, 1.0, 1.2, law, stability=True),
        "structure",
        names="massless",
    )


# --- what is interrupted, or lost -----------------------------------------------------------------


def test_interruption_keeps_what_is_done(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ctrl-C ends a curve early, but loses nothing."""
    structure, law = oscillator(0.02, 0.1), fc.UnilateralPenalty(1.0)
    calls = []

    def progress(self: fc.Continuation) -> float:
        calls.append(1)
        if len(calls) == 20:
            raise KeyboardInterrupt
        return 0.5

    monkeypatch.setattr(fc.Continuation, "progress_fraction", progress)
    curve = continue_frequency(structure, 2.0, 0.3, law, progress=True)
    assert not curve.complete and curve.status == "interrupted" and len(curve) == 20


def test_the_bar_counts_whole_per_cents(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a terminal of unknown width, too."""
    stream = io.StringIO()

    def narrow(bar: Callable[..., Any], **options: Any) -> Any:
        return bar(**options, ncols=0, file=stream, mininterval=0.0)

    wrap(monkeypatch, "tqdm.tqdm", narrow)
    law = fc.UnilateralPenalty(1.0)
    assert continue_frequency(oscillator(0.02, 0.1), 2.0, 0.3, law, progress=True).complete
    counts = re.findall(r"% (\S+)/100 ", stream.getvalue())
    assert len(counts) > 10 and counts[-1] == "100" and all(map(str.isdigit, counts))


def test_an_end_that_cannot_be_landed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """What was found until then is returned with its status, or comes with the error, judged."""
    monkeypatch.setattr("fenics_crack.numerics.path.Target.locate", lambda *_: None)
    options: dict[str, Any] = {"harmonics": 5, "stability": True}
    law = fc.UnilateralPenalty(1.0)
    curve = fc.continue_frequency(oscillator(), 1.0, 1.3, law, throw=False, **options)
    assert (
        not curve.complete
        and curve.status == "no solution was found at the very end: move the end a little"
    )
    assert len(curve) > 3 and 1.25 < curve.values.max() < 1.3
    assert set(curve.verdicts) <= {"stable", "unstable"}
    error = catch_error(
        lambda: fc.continue_frequency(oscillator(), 1.0, 1.3, law, **options),
        names=r"ended at 1\..* points: no solution was found at the very end",
        kind=fc.ConvergenceError,
    )
    assert np.array_equal(error.found.values, curve.values)


STOP = fc.UnilateralPenalty(100.0)


def test_ctrl_c_keeps_the_points(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those that were found until then."""
    record, count = Continuation._append_segment, 0

    def interrupted(path: Continuation, points: object) -> object:
        nonlocal count
        count += 1
        if count > 20:
            raise KeyboardInterrupt
        return record(path, points)

    monkeypatch.setattr(Continuation, "_append_segment", interrupted)
    curve = fc.continue_frequency(two_masses(), 0.6, 0.9, STOP, tolerance=1e-2, progress=True)
    assert curve.status == INTERRUPTED_CURVE_STATUS and len(curve) == 21 and not curve.complete


def test_begins_elsewhere(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no orbit is found at the start, by a curve from the end; or it says that there is
    none."""
    expected_curve = fc.continue_frequency(two_masses(), 0.6, 0.9, STOP, tolerance=1e-2)
    search = continuation.search_orbit_by_harmonic_balance

    def lost(problem: fc.Problem, initial: fc.PeriodicSolution | None = None) -> object:
        return search(problem, initial)._replace(orbit=None, outcome_text="lost")

    def lost_at_start(problem: fc.Problem, initial: fc.PeriodicSolution | None = None) -> object:
        return (lost if problem.omega == 0.6 else search)(problem, initial)

    monkeypatch.setattr(continuation, "search_orbit_by_harmonic_balance", lost_at_start)
    curve = fc.continue_frequency(expected_curve.structure, 0.6, 0.9, STOP, tolerance=1e-2)
    assert (
        curve.complete and curve.values[-1] == 0.9 and "a search from the end found" in curve.status
    )
    assert curve.points[0] == pytest.approx(expected_curve.points[0], rel=1e-6)
    monkeypatch.setattr(continuation, "search_orbit_by_harmonic_balance", lost)
    catch_error(
        lambda: fc.continue_frequency(expected_curve.structure, 0.6, 0.9, STOP, tolerance=1e-2),
        names=r"no exact orbit was found at 0.6 rad/s: lost",
        kind=fc.ConvergenceError,
    )


def test_without_a_matrix_the_same_curve(monkeypatch: pytest.MonkeyPatch) -> None:
    """J is not formed: the sign of its determinant is unknown, the path and its folds are not."""
    plate = fc.reduce_structure(steel("all"), modes=5, method="massless")
    curves = []
    for limit in (10_000, 10):
        monkeypatch.setattr("fenics_crack.balance.contact_system.MAX_UNKNOWNS_WITH_JACOBIAN", limit)
        curves.append(fc.continue_frequency(plate, *SPAN, fc.UnilateralConstraint(), harmonics=6))
    matrix_curve, matrix_free_curve = curves
    assert matrix_free_curve.complete and len(folds(matrix_curve)) == 2
    assert folds(matrix_free_curve) == pytest.approx(folds(matrix_curve), rel=1e-8)
    assert matrix_free_curve.amplitude(0).max() == pytest.approx(
        matrix_curve.amplitude(0).max(), rel=1e-3
    )


def test_change_over_half_a_period_is_twice_the_odd_harmonics() -> None:
    """Fourier coefficients half a period later are (-1)^k times those of before."""
    coefficients = np.random.default_rng(3).standard_normal((7, 2))
    later = coefficients * (-1.0) ** ((np.arange(7) + 1) // 2)[:, None]
    system = SimpleNamespace(shape=coefficients.shape)
    change = BalanceEquations.half_period_repetition_error(system, coefficients, 0.0)  # type: ignore[arg-type]
    assert change == pytest.approx(relative(later, coefficients), rel=1e-12)
