"""The compiled kernel against the same equations in NumPy, also with checks of its addresses; when
which pairs are closed, for contact that couples them, as the kernel finds it.

Between two events the set A of closed pairs stays, and with it lambda_A = (D_AA)^-1 s_A and the
openings of the others, D lambda - s (:mod:`fenics_crack.model.contact`). An event is the first root
of one of these: a force that vanishes opens its pair, an opening that vanishes closes it. There the
stiffness S_A = (D_AA)^-1, with zeros outside A, changes by a part of rank one, gain v v^T.

The kernel finds them (``kernel/intervals.c``) on the cells of a grid, 16 and more to the shortest
wave. It carries one set through the period: an event or a cell without one costs some n_pairs^2.
"""

from __future__ import annotations

import os
import pathlib
import subprocess
import sys
import weakref
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import islice, pairwise
from typing import Any

import numpy as np
import pytest
import scipy.optimize
from helpers import ROOT, catch_error, chain, oscillator, random_stiffness, relative, two_masses
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from switching import switching_instants
from test_inside_balance import grazing_gaps, random_gaps

import fenics_crack as fc
from fenics_crack import Continuation
from fenics_crack.balance import contact_system
from fenics_crack.balance.contact_integrals import (
    CoupledIntegrals,
    ExactIntegrals,
    multiply_compliance_and_force,
    multiply_compliance_and_tangent,
)
from fenics_crack.balance.contact_system import CompiledEquations
from fenics_crack.curves.balance_equations import EQUATIONS_CLASS_BY_PARAMETER, BalanceEquations
from fenics_crack.kernel import Struct, attach_destructor, kernel, pointer, require_shape
from fenics_crack.model.contact import ActiveSetSolver, solve_complementarity
from fenics_crack.numerics.equations import ROUNDING, Linearisation, System
from fenics_crack.numerics.fourier import evaluate_series, sample_period, to_complex
from fenics_crack.numerics.newton import (
    PathPoint,
    point_on_path,
    solve_at_parameter,
    solve_in_plane,
    tangent_of,
    try_step,
)
from fenics_crack.numerics.path import EndReason, Fold, Path, PathOptions, Target

OTHERS = [
    ROOT / "tests" / name
    for name in (
        "model/test_inside_model.py",
        "motion/test_contact_flow.py", "motion/test_inside_friction.py",
        "numerics/test_paths.py", "time/test_compiled_marches.py",
    )
]  # fmt: skip
"""Other files whose tests are run with it."""

WITH_CHECKS = """
import importlib.util, sys, pytest
name = "fenics_crack.kernel._kernel"
spec = importlib.util.spec_from_file_location(name, sys.argv[1])
sys.modules[name] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(sys.modules[name])
which = "not nightly and not mpi"
sys.exit(pytest.main(["-q", "-x", "-n", "0", "-p", "no:cacheprovider", "-m", which, *sys.argv[2:]]))
"""


NO_FORCES = -2
"""What the kernel returns then."""


@dataclass(frozen=True)
class Intervals:
    """Sets of closed pairs over a period.

    Attributes
    ----------
    theta : (m,) [rad]
        Where each interval begins, the first at 0; ascending.
    first : (n_pairs,) bool
        Pairs closed in the first interval.
    pair : (m - 1,) int
        Which pair opens or closes at the end of each.
    stiffness : (n_pairs, n_pairs) [N/m]
        S of the first interval.
    vectors, gains : (m - 1, n_pairs) and (m - 1,) [N/m]
        v and gain: how S changes at the end of each.
    """

    theta: np.ndarray
    first: np.ndarray
    pair: np.ndarray
    stiffness: np.ndarray
    vectors: np.ndarray
    gains: np.ndarray

    @cached_property
    def closed(self) -> np.ndarray:
        """Pairs closed in each interval: (m, n_pairs) bool."""
        has_changed = np.zeros((len(self.theta), len(self.first)), dtype=bool)
        has_changed[0] = self.first
        has_changed[np.arange(1, len(self.theta)), self.pair] = True
        return np.logical_xor.accumulate(has_changed, axis=0)

    def rests(self, highest: int) -> np.ndarray:
        """Means over the period of exp(i m theta) from where each interval begins to the period's
        end: (m, highest + 1)."""
        order = np.arange(highest + 1)
        integrals = 1.0 - np.exp(1j * np.multiply.outer(self.theta, order))
        integrals[:, 0] = 2.0 * np.pi - self.theta
        integrals[:, 1:] /= 1j * order[1:]
        return integrals / (2.0 * np.pi)


def contact_intervals(gap: np.ndarray, contact: ActiveSetSolver) -> Intervals:
    """The intervals of waves s with coefficients (2H+1, n_pairs).

    Raises ConvergenceError where an instant has no forces.
    """
    columns, pairs = len(gap), len(contact.compliance_matrix)
    gap = require_shape(gap, 2 * (columns // 2) + 1, pairs)
    count = kernel.interval_cells(columns // 2, pairs)
    closed_at_start, stiffness = np.empty(pairs, dtype=bool), np.empty((pairs, pairs))
    table = Struct(
        "pivot_table", pairs=pairs, compliance=contact.compliance_matrix,
        table=np.empty((pairs, pairs)),
        closed=np.empty(pairs, dtype=bool), work=np.empty(4 * pairs),
    )  # fmt: skip
    waves, places = _waves(columns // 2, count, pairs), count + 8 * pairs
    while True:
        theta, pair = np.zeros(places + 1), np.empty(places, dtype=np.intc)
        vectors, gains = np.empty((places, pairs)), np.empty(places)
        request = Struct(
            "breathing_pairs", contact=table, cells=count, max_events=places, n_waves=columns,
            gaps=gap, waves=waves, first_set=closed_at_start, stiffness=stiffness, theta=theta[1:],
            tolerance=ROUNDING * float(np.abs(gap).sum(axis=0).max(initial=0.0)),
            event_pairs=pair, vectors=vectors, gains=gains,
            work=np.empty(kernel.interval_work_size(pairs, columns // 2, count)),
        )  # fmt: skip
        n_events = kernel.find_intervals(request.address)
        if n_events >= 0:
            return Intervals(
                theta[: n_events + 1],
                closed_at_start,
                pair[:n_events],
                stiffness,
                vectors[:n_events],
                gains[:n_events],
            )
        if n_events == NO_FORCES:
            raise fc.ConvergenceError("contact: no forces were found at an instant of the period")
        places *= 2


@lru_cache(maxsize=16)
def _waves(harmonics: int, count: int, pairs: int) -> Any:
    """What the kernel finds gaps with at equally spaced phases."""
    return attach_destructor(kernel.new_waves(harmonics, count, pairs), kernel.free_waves)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 25), st.integers(0, 2**32 - 1), st.booleans())
def test_complementarity(pairs: int, seed: int, guessed: bool) -> None:
    """0 <= f, D f - g >= 0, f (D f - g) = 0 hold to rounding: there is one such f."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(pairs, pairs + 2))
    matrix, gap = root @ root.T + 1e-3 * np.eye(pairs), random.normal(size=pairs)
    force = solve_complementarity(matrix, gap, random.random(pairs) < 0.5 if guessed else None)
    opening = matrix @ force - gap
    assert force.min() >= 0.0
    assert opening.min() >= -1e-9 * np.abs(gap).max()
    assert np.abs(force * opening).max() <= 1e-9 * np.abs(gap).max() * max(1.0, force.max())


TWO = ActiveSetSolver(np.eye(2))
BEHIND = CoupledIntegrals(fc.UnilateralPenalty(1.0), 1, residual_compliance=np.eye(2))
SYSTEM = CompiledEquations(None, np.ones(2), np.zeros((3, 2)), np.zeros((2, 2, 2), complex))
WRONG = {
    "complementarity, a matrix too small": lambda: solve_complementarity(np.eye(2), np.ones(3)),
    "complementarity, a guess too short": lambda: solve_complementarity(
        np.eye(3), np.ones(3), np.ones(2, bool)
    ),
    "complementarity, gaps in rows": lambda: solve_complementarity(np.eye(3), np.ones((3, 2))),
    "contact integrals, too few rows": lambda: ExactIntegrals(fc.UnilateralPenalty(1.0), 3).force(
        np.ones((5, 2))
    ),
    "intervals, an even number of rows": lambda: contact_intervals(np.ones((4, 2)), TWO),
    "intervals, other pairs": lambda: contact_intervals(np.ones((3, 5)), TWO),
    "coupled forces, other harmonics": lambda: BEHIND.linearise(np.ones((5, 2))),
    "coupled forces, another change": lambda: (
        BEHIND.linearise(np.ones((3, 2))).force_change(np.ones(6))
    ),
    "sets, a compliance not square": lambda: ActiveSetSolver(np.ones((3, 2))),
    "sets, other pairs": lambda: TWO.solve(np.ones((4, 3))),
    "sets, a guess too short": lambda: TWO.solve(np.ones((4, 2)), np.ones((3, 2), bool)),
    "inverses, other pairs": lambda: TWO.invert_compliance_on_sets(np.ones((4, 3), bool)),
    "responses, other pairs": lambda: multiply_compliance_and_force(
        np.ones((2, 3, 3)), np.ones((3, 2))
    ),
    "responses, an even number of rows": lambda: multiply_compliance_and_force(
        np.ones((3, 2, 2)), np.ones((4, 2))
    ),
    "columns, an even number of rows": lambda: multiply_compliance_and_tangent(
        np.ones((3, 2, 2)), np.ones((2, 4, 5))
    ),
    "system, fewer stiffnesses": lambda: CompiledEquations(
        None, np.ones(1), np.zeros((3, 2)), np.zeros((2, 2, 2), complex)
    ),
    "system, another point": lambda: SYSTEM.linearise(np.ones((5, 2)), 1.0),
    "system, another right side": lambda: SYSTEM.linearise(np.ones((3, 2)), 1.0).solve(np.ones(4)),
    "numbers with gaps": lambda: pointer(np.ones((4, 4))[:, 1]),
    "doubles of the other order of bytes": lambda: pointer(np.ones(3, ">f8")),
    "long whole numbers": lambda: pointer(np.ones(3, np.int64)),
    "another shape": lambda: require_shape(np.ones((3, 2)), 3, 3),
}  # fmt: skip


@pytest.mark.parametrize("call", WRONG.values(), ids=WRONG.keys())
def test_wrong_shapes_are_refused(call: Callable[[], object]) -> None:
    """Nothing is read beyond an array; also where Python leaves out what is asserted (-O)."""
    catch_error(call, names=r"instead of|contiguous", kind=ValueError)


def test_wrong_kinds_are_refused() -> None:
    """By a function, and as a member."""
    doubles = pointer(np.ones(3))
    catch_error(
        lambda: kernel.respond(1, 1, doubles, pointer(np.ones(3, np.intc)), doubles),
        names="same type",
        kind=TypeError,
    )
    catch_error(
        lambda: Struct("flow_track", lengths=np.ones(3, bool)), names="same type", kind=TypeError
    )


def test_shapes_that_fit_are_not_copied() -> None:
    """But where the kind or the order is another."""
    array = np.ones((3, 2))
    assert require_shape(array, 3, 2) is array
    assert require_shape(array.T, 2, 3).flags.c_contiguous
    assert require_shape(array, 3, 2, kind=complex).dtype == complex


# --- when which pairs are closed ------------------------------------------------------------------


def coupled_sets(pairs: int, seed: int = 1) -> ActiveSetSolver:
    """Of a random compliance that couples all pairs."""
    return ActiveSetSolver(np.linalg.inv(random_stiffness(np.random.default_rng(seed), pairs)))


def closed_at(intervals: Intervals, theta: np.ndarray) -> np.ndarray:
    """The sets of the intervals at phases: (n, n_pairs)."""
    place = np.searchsorted(intervals.theta, theta, side="right") - 1
    return intervals.closed[place]


def means_of(intervals: Intervals, highest: int) -> np.ndarray:
    """Means of exp(i m theta) over each interval: (m, highest + 1)."""
    rests = intervals.rests(highest)
    return rests - np.vstack([rests[1:], 0.0 * rests[:1]])


def closed_for(intervals: Intervals, pair: int = 0) -> float:
    """How long a pair is closed [rad]."""
    lengths = np.diff(np.append(intervals.theta, 2.0 * np.pi))
    return float(lengths[intervals.closed[:, pair]].sum())


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("pairs", "harmonics"), [(1, 6), (2, 9), (5, 5), (24, 4)])
def test_sets_are_those_of_every_instant(pairs: int, harmonics: int, seed: int) -> None:
    """At 4000 random phases, but within 1e-6 of an event; every one of these is a root."""
    contact, gap = coupled_sets(pairs, seed), random_gaps(harmonics, pairs, seed)
    intervals = contact_intervals(gap, contact)
    assert intervals.theta[0] == 0.0 and np.all(np.diff(intervals.theta) >= 0.0)
    theta = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, 4000)
    distance = np.abs(theta[:, None] - intervals.theta).min(axis=1)
    theta = theta[distance > 1e-6]
    _, expected_sets = contact.solve(evaluate_series(gap, 1.0, theta))
    assert np.array_equal(closed_at(intervals, theta), expected_sets)
    assert len(intervals.theta) > pairs
    # The forces on both sides of an event are the same: they vanish, or begin, there.
    values = evaluate_series(gap, 1.0, intervals.theta[1:])
    forces_before, forces_after = (
        np.einsum("npq,nq->np", contact.invert_compliance_on_sets(sets), values)
        for sets in (intervals.closed[:-1], intervals.closed[1:])
    )
    max_force = np.abs(contact.solve(evaluate_series(gap, 1.0, theta))[0]).max()
    assert np.abs(forces_before - forces_after).max() < 1e-9 * max_force


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 40), st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_stiffness_follows_from_its_changes(pairs: int, harmonics: int, seed: int) -> None:
    """Event after event the inverse of NumPy on the closed pairs, zero outside, to 1e-12."""
    random = np.random.default_rng(seed)
    gap = random.normal(size=(2 * harmonics + 1, pairs))
    compliance = np.linalg.inv(random_stiffness(random, pairs))
    intervals = contact_intervals(gap, ActiveSetSolver(compliance))
    stiffness = intervals.stiffness.copy()
    changes = zip(intervals.gains, intervals.vectors, strict=True)
    for closed_pairs, change in zip(intervals.closed, [*changes, None], strict=True):
        expected_stiffness = np.zeros((pairs, pairs))
        closed_block = np.ix_(closed_pairs, closed_pairs)
        expected_stiffness[closed_block] = np.linalg.inv(compliance[closed_block])
        assert np.abs(stiffness - expected_stiffness).max() <= 1e-12 * max(
            1.0, np.abs(expected_stiffness).max()
        )
        if change is not None:
            stiffness += change[0] * np.outer(change[1], change[1])


@pytest.mark.parametrize("stiffness", [1e4, 1e6])
def test_a_compliance_close_to_singular(stiffness: float) -> None:
    """Neighbours that hardly differ, condition numbers of 2e5 and 2e7: rounding is left behind."""
    place = np.linspace(0.0, 3.0, 40)
    compliance = np.exp(-((place[:, None] - place) ** 2)) + np.eye(40) / stiffness
    gap = random_gaps(6, 40, 1)
    intervals = contact_intervals(gap, ActiveSetSolver(compliance))
    theta = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, 200)
    values = evaluate_series(gap, 1.0, theta)
    for value, closed_pairs in zip(values, closed_at(intervals, theta), strict=True):
        force = np.zeros(40)
        force[closed_pairs] = np.linalg.solve(
            compliance[np.ix_(closed_pairs, closed_pairs)], value[closed_pairs]
        )
        assert np.all(force >= 0.0) and np.all((compliance @ force - value)[~closed_pairs] > -1e-9)
    last_stiffness = (
        intervals.stiffness + (intervals.vectors.T * intervals.gains) @ intervals.vectors
    )
    assert np.abs(last_stiffness - intervals.stiffness).max() < 1e-9 * np.abs(last_stiffness).max()


def test_events_of_one_pair_are_its_zeros() -> None:
    """The instants of the search for pairs that nothing couples."""
    for seed in range(5):
        gap = random_gaps(8, 1, seed)
        intervals = contact_intervals(gap, ActiveSetSolver(np.full((1, 1), 0.3)))
        expected_theta = np.sort(np.mod(switching_instants(to_complex(gap)).theta, 2.0 * np.pi))
        assert np.allclose(intervals.theta[1:], expected_theta, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("depth", [1e-3, 1e-5, 1e-7, 1e-9])
def test_contact_that_comes_and_goes_in_a_cell(depth: float) -> None:
    """A peak that high above zero: 2 (2 d / |g''|)^1/2 long; so high below: no contact; and the
    same upside down."""
    gaps = grazing_gaps(np.full(20, depth))
    phase = np.linspace(0.0, 2.0 * np.pi, 1 << 16, endpoint=False)
    for gap in gaps.T[:, :, None]:
        wave = evaluate_series(gap, 1.0, phase)[:, 0]
        top = int(np.argmax(wave))
        width = phase[1] - phase[0]
        bend = (wave[top - 1] - 2.0 * wave[top] + wave[(top + 1) % len(wave)]) / width**2
        expected_duration = 2.0 * np.sqrt(2.0 * depth / -bend)
        contact = ActiveSetSolver(np.eye(1))
        contact_duration = closed_for(contact_intervals(gap, contact))
        assert contact_duration == pytest.approx(
            expected_duration, rel=0.2 if depth > 1e-4 else 0.02
        )
        mirrored_intervals = contact_intervals(-gap, contact)
        assert 2.0 * np.pi - closed_for(mirrored_intervals) == pytest.approx(
            contact_duration, rel=1e-4
        )
        gap[0] -= 2.0 * depth
        assert closed_for(contact_intervals(gap, contact)) == 0.0


def test_pairs_that_open_and_close_together() -> None:
    """Equal waves on equal pairs, in pairs that differ by rounding: their events coincide."""
    single_gap = random_gaps(6, 1, 3)
    compliance = 2.0 * np.eye(4) + 0.5
    together = ActiveSetSolver(np.array([[compliance.sum(axis=1)[0]]]))
    single_intervals = contact_intervals(single_gap, together)
    for noise in (0.0, 1e-16, 1e-13):
        gap = np.tile(single_gap, 4) * (1.0 + noise * np.arange(4))
        intervals = contact_intervals(gap, ActiveSetSolver(compliance))
        for pair in range(4):
            assert closed_for(intervals, pair) == pytest.approx(
                closed_for(single_intervals), abs=1e-9
            )
        theta = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, 500)
        theta = theta[np.abs(theta[:, None] - single_intervals.theta).min(axis=1) > 1e-6]
        assert np.array_equal(
            closed_at(intervals, theta), np.tile(closed_at(single_intervals, theta), 4)
        )


@pytest.mark.parametrize("harmonics", [1, 3, 8])
@pytest.mark.parametrize("wave", ["sine", "cosine", "both"])
def test_events_at_the_ends_of_cells(wave: str, harmonics: int) -> None:
    """Zeros on the grid: half of the period closed, in pairs that are each other's opposite too."""
    gap = np.zeros((2 * harmonics + 1, 2))
    row = {"sine": [2, 2], "cosine": [1, 1], "both": [1, 2]}[wave]
    gap[row[0], 0], gap[row[1], 1] = 1.0, -1.0
    contact = ActiveSetSolver(np.diag([1.0, 3.0]))
    for sign in (1.0, -1.0):
        intervals = contact_intervals(sign * gap, contact)
        assert closed_for(intervals, 0) == pytest.approx(np.pi, abs=1e-12)
        assert closed_for(intervals, 1) == pytest.approx(np.pi, abs=1e-12)
        theta = np.linspace(0.1, 6.2, 37)
        expected_sets = evaluate_series(sign * gap, 1.0, theta) > 0.0
        assert np.array_equal(closed_at(intervals, theta), expected_sets)


def test_always_open_and_always_closed() -> None:
    """No event: one set for all of the period."""
    gap = random_gaps(4, 3)
    for mean, is_closed in ((-100.0, False), (100.0, True)):
        gap[0] = mean
        compliance = np.eye(3) + 0.1
        intervals = contact_intervals(gap, ActiveSetSolver(compliance))
        assert len(intervals.theta) == 1 and np.all(intervals.closed == is_closed)
        assert np.allclose(means_of(intervals, 8), np.eye(9)[0], rtol=0.0, atol=1e-14)


def test_means_by_quadrature() -> None:
    """QUADPACK between the events, for each interval and each multiple of the phase."""
    contact, gap = coupled_sets(3), random_gaps(3, 3, 2)
    intervals = contact_intervals(gap, contact)
    means, ends = means_of(intervals, 6), np.append(intervals.theta, 2.0 * np.pi)
    assert means[:, 0].real.sum() == pytest.approx(1.0)
    for row in range(len(intervals.theta)):
        for order in (0, 1, 5, 6):
            parts = 0j
            for unit, wave in ((1.0, np.cos), (1j, np.sin)):
                parts += (
                    unit * quad(lambda t, w=wave, m=order: w(m * t), ends[row], ends[row + 1])[0]
                )
            assert means[row, order] == pytest.approx(parts / (2.0 * np.pi), abs=1e-10)


# --- addresses ------------------------------------------------------------------------------------


@pytest.mark.nightly
def test_with_checks_of_addresses(tmp_path: pathlib.Path) -> None:
    """The tests above with a kernel that ends the process where it reads outside its arrays."""
    build = ROOT / "fenics_crack" / "kernel" / "build.py"
    subprocess.run([sys.executable, build, "--sanitize", tmp_path], check=True)
    library = subprocess.run(
        ["gcc", "-print-file-name=libasan.so"], check=True, capture_output=True, text=True
    ).stdout.strip()
    environment = {"LD_PRELOAD": library, "ASAN_OPTIONS": "detect_leaks=0"}
    process = subprocess.run(
        [sys.executable, "-c", WITH_CHECKS, tmp_path / "_kernel.abi3.so", __file__, *OTHERS],
        cwd=ROOT, env=os.environ | environment, capture_output=True, text=True,
    )  # fmt: skip
    assert process.returncode == 0, process.stdout[-3000:] + process.stderr[-3000:]


# --- equations and paths --------------------------------------------------------------------------


SEEDS = st.integers(0, 2**32 - 1)
RANGES = {
    "omega": (1.3, 0.9),
    "load": (1.0, 3.0),
    "stiffness": (1.0, 50.0),
    "damping": (1.0, 0.1),
    "clearance": (-0.3, 0.5),
}


class Plain:
    """A family, or another system, whose equations are left to Python."""

    def __init__(self, family: System) -> None:
        self._family = family
        self.n_time_means = getattr(family, "n_time_means", 0)

    def linearise(self, unknown: np.ndarray, parameter: float) -> Linearisation:
        """As the family."""
        return self._family.linearise(unknown, parameter)


def random_gap(random: np.random.Generator, harmonics: int, pairs: int) -> np.ndarray:
    """Coefficients that fall like 1 / k."""
    gap = random.normal(size=(2 * harmonics + 1, pairs))
    gap[1:] /= np.repeat(np.arange(1, harmonics + 1), 2)[:, None]
    return gap


def integrals_by_scan(gap: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """T and b of one gap (2H+1,) with k = 1, between the zeros that a scan shows, by the integrals
    of products of waves; and the smallest slope at a zero."""
    harmonics, cells = len(gap) // 2, 4096
    values = sample_period(gap[:, None], cells)[:, 0]
    width = 2.0 * np.pi / cells
    changes = np.flatnonzero((values > 0.0) != (np.roll(values, -1) > 0.0))

    def wave(theta: float) -> float:
        return float(evaluate_series(gap, 1.0, np.array([theta]))[0])

    zeros = [
        scipy.optimize.brentq(wave, i * width, (i + 1) * width, xtol=1e-15, rtol=1e-15)
        for i in changes
    ]
    order = np.arange(harmonics + 1)
    slopes = [
        abs((1j * order * to_complex(gap) * np.exp(1j * order * z)).sum().real) for z in zeros
    ]
    # Means of exp(i m theta), m = -2H to 2H, over the closed intervals.
    power = np.arange(-2 * harmonics, 2 * harmonics + 1)
    means = np.zeros(len(power), dtype=complex)
    ends = np.array([0.0, *zeros, 2.0 * np.pi])
    for left, right in pairwise(ends):
        if wave(0.5 * (left + right)) > 0.0:
            integral = np.where(power == 0, right - left, 0.0).astype(complex)
            is_nonzero = power != 0
            rate = 1j * power[is_nonzero]
            integral[is_nonzero] = (np.exp(rate * right) - np.exp(rate * left)) / rate
            means += integral / (2.0 * np.pi)
    # Columns 1, cos, sin, ... in exp(i m theta), m = -H to H.
    basis = np.zeros((len(gap), 2 * harmonics + 1), dtype=complex)
    basis[0, harmonics] = 1.0
    for k in range(1, harmonics + 1):
        basis[2 * k - 1, harmonics + k] = basis[2 * k - 1, harmonics - k] = 0.5
        basis[2 * k, harmonics + k], basis[2 * k, harmonics - k] = -0.5j, 0.5j
    sums = np.add.outer(np.arange(-harmonics, harmonics + 1), np.arange(-harmonics, harmonics + 1))
    tangent = (basis @ means[sums + 2 * harmonics] @ basis.T).real
    tangent[1:] *= 2.0
    return tangent, tangent @ gap, min(slopes, default=np.inf)


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 12), st.integers(1, 3), SEEDS)
def test_contact_integrals(harmonics: int, pairs: int, seed: int) -> None:
    """Forces and tangents of random gaps."""
    random = np.random.default_rng(seed)
    gap, stiffness = random_gap(random, harmonics, pairs), random.uniform(0.1, 10.0, pairs)
    point = ExactIntegrals(fc.UnilateralPenalty(stiffness), harmonics).linearise(gap)
    for pair, k in enumerate(stiffness):
        expected_tangent, expected_force, slope = integrals_by_scan(gap[:, pair])
        assume(slope > 1e-3)
        assert np.allclose(
            point.tangent[pair], k * expected_tangent, rtol=0.0, atol=1e-12 * k / min(slope, 1.0)
        )
        assert np.allclose(point.force[:, pair], k * expected_force, rtol=0.0, atol=1e-11 * k)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 6), st.integers(1, 4), st.integers(1, 9), SEEDS)
def test_respond_to_columns(harmonics: int, pairs: int, columns: int, seed: int) -> None:
    """R T, column by column: a - i b answered by R_k (a - i b)."""
    random = np.random.default_rng(seed)
    rows = 2 * harmonics + 1
    matrices = random.normal(size=(2, harmonics + 1, pairs, pairs))
    matrices = (
        matrices[0]
        + 1j * np.where(np.arange(harmonics + 1) > 0, 1, 0)[:, None, None] * (matrices[1])
    )
    tangent = random.normal(size=(pairs, rows, columns))
    response = multiply_compliance_and_tangent(matrices, tangent).reshape(
        rows, pairs, columns, pairs
    )
    for pair in range(pairs):
        column_response = np.einsum("kp,kc->kpc", matrices[:, :, pair], to_complex(tangent[pair]))
        assert np.allclose(response[0, :, :, pair], column_response[0].real, rtol=0.0, atol=1e-12)
        assert np.allclose(
            response[1::2, :, :, pair], column_response[1:].real, rtol=0.0, atol=1e-12
        )
        assert np.allclose(
            response[2::2, :, :, pair], -column_response[1:].imag, rtol=0.0, atol=1e-12
        )


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(list(RANGES)),
    st.sampled_from(["modal", "rayleigh", "few modes", "matrix"]),
    st.integers(1, 8),
    st.integers(1, 3),
    SEEDS,
)
def test_equations_at_a_point(
    name: str, damping: str, harmonics: int, pairs: int, seed: int
) -> None:
    """F, dF/dp, J^-1 r and the sign of det J of random chains, in every family."""
    random = np.random.default_rng(seed)
    law = fc.UnilateralPenalty(random.uniform(0.5, 20.0, pairs))
    structure = chain(damping, pairs=pairs, seed=seed % 1000)
    family = EQUATIONS_CLASS_BY_PARAMETER[name](
        fc.Problem(structure, 0.83, law, harmonics), *RANGES[name]
    )
    kernel = family.compiled_equations
    if damping == "matrix" and name in ("omega", "damping"):
        assert kernel is None  # it couples modes
        return
    assert isinstance(kernel, CompiledEquations)
    gap, residual = random_gap(random, harmonics, pairs), random.normal(size=family.shape)
    parameter = float(random.uniform(-0.2, 1.2))
    python_point, kernel_point = family.linearise(gap, parameter), kernel.linearise(gap, parameter)
    singular_numbers = np.linalg.svd(python_point.jacobian, compute_uv=False)
    base_tolerance = 1e-12 * max(1.0, float(singular_numbers[0]))
    for kernel_array, python_array, tolerance in (
        (kernel_point.residual, python_point.residual, base_tolerance),
        (kernel_point.by_parameter, python_point.by_parameter, base_tolerance),
        (
            kernel_point.solve(residual),
            python_point.solve(residual),
            base_tolerance / singular_numbers[-1] ** 2,
        ),
    ):
        assert np.allclose(
            kernel_array,
            python_array,
            rtol=1e-12,
            atol=10.0 * tolerance * np.abs(python_array).max(),
        )
    assert kernel_point.sign == python_point.sign


@pytest.mark.parametrize(("stiffness", "harmonics"), [(1.0, 3), (1.0, 10), (10.0, 6), (100.0, 5)])
def test_path_of_the_oscillator(stiffness: float, harmonics: int) -> None:
    """Compiled equations take the steps that those in Python take."""
    law = fc.UnilateralPenalty(stiffness)
    family = EQUATIONS_CLASS_BY_PARAMETER["omega"](
        fc.Problem(oscillator(0.02, 0.1), 2.0, law, harmonics), 2.0, 0.3
    )
    start = fc.solve_harmonic_balance(oscillator(0.02, 0.1), 2.0, law, harmonics=harmonics)
    options = PathOptions(0.01, max_step=0.1, min_step=1e-10, min_cosine=0.85)
    assert_same_path(family, start.gap_coefficients, options, 150)


@pytest.mark.parametrize("name", list(RANGES))
def test_path_of_a_chain(name: str) -> None:
    """With three pairs, in every family, by steps that are too long for some points."""
    structure, law = chain(), fc.UnilateralPenalty(np.array([3.0, 8.0, 20.0]))
    family = EQUATIONS_CLASS_BY_PARAMETER[name](fc.Problem(structure, 0.83, law, 4), *RANGES[name])
    start_problem = family.problem_at(family.start)
    start = fc.solve_harmonic_balance(
        start_problem.structure,
        start_problem.omega,
        start_problem.contact,
        harmonics=4,
        residual_tolerance=1e-12,
    )
    options = PathOptions(0.01, max_step=0.5, min_step=1e-10)
    assert_same_path(family, start.gap_coefficients, options, 40)


def followed(
    system: System, start: np.ndarray, options: PathOptions, count: int
) -> list[PathPoint]:
    """So many points of the path from p = 0 on."""
    return list(islice(Path(system, point_on_path(system, start, 0.0), options).points(), count))


def assert_same_path(
    family: BalanceEquations, start: np.ndarray, options: PathOptions, count: int
) -> None:
    """Followed both ways."""
    ways = [followed(system, start, options, count) for system in (family, Plain(family))]
    n_compared = 0
    for kernel_point, python_point in zip(*ways, strict=False):
        if python_point.chord_length_from_previous < 1e-4:  # at a sharp corner rounding counts
            break
        n_compared += 1
        size = np.abs(python_point.unknown).max()
        assert kernel_point.parameter == pytest.approx(python_point.parameter, abs=1e-9)
        assert np.allclose(kernel_point.unknown, python_point.unknown, rtol=0.0, atol=1e-8 * size)
        assert np.allclose(
            kernel_point.tangent.x, python_point.tangent.x, rtol=0.0, atol=1e-6 * size
        )
        assert kernel_point.tangent.p == pytest.approx(python_point.tangent.p, abs=1e-6)
        assert kernel_point.tangent.unknowns_weight == pytest.approx(
            python_point.tangent.unknowns_weight, rel=1e-8
        )
        assert kernel_point.chord_length_from_previous == pytest.approx(
            python_point.chord_length_from_previous, rel=1e-6
        )
        assert (
            abs(kernel_point.iterations - python_point.iterations) <= 1
        )  # rounding may decide over the last one
        assert kernel_point.crosses_branch == python_point.crosses_branch
    assert n_compared > 10


@pytest.mark.parametrize("min_damping", [None, 0.05])
@pytest.mark.parametrize("bordered", [False, True])
def test_corrections(bordered: bool, min_damping: float | None) -> None:
    """From random guesses, far ones among them: found or not, the same."""
    law = fc.UnilateralPenalty(10.0)
    family = EQUATIONS_CLASS_BY_PARAMETER["omega"](fc.Problem(oscillator(), 0.9, law, 4), 0.9, 1.4)
    start = fc.solve_harmonic_balance(oscillator(), 0.9, law, harmonics=4).gap_coefficients
    plane = tangent_of(family, start, family.linearise(start, 0.0)) if bordered else None
    random, outcomes = np.random.default_rng(3), []
    for size in np.repeat([0.0, 0.01, 0.3, 3.0, 1e200], 12):
        guess = start + size * random.normal(size=start.shape)
        kernel_point, python_point = (
            solve_in_plane(
                system, guess, 0.05, plane,
                tolerance=1e-10, max_iterations=8, max_parameter_change=0.3,
                min_damping=min_damping,
            )
            for system in (family, Plain(family))
        )  # fmt: skip
        outcomes.append(kernel_point is not None)
        assert (kernel_point is None) == (python_point is None)
        if kernel_point is not None and python_point is not None:
            assert kernel_point.parameter == pytest.approx(python_point.parameter, abs=1e-9)
            assert np.allclose(kernel_point.unknown, python_point.unknown, atol=1e-8)
            assert kernel_point.iterations == python_point.iterations
    assert 12 < sum(outcomes) < 60


def test_undamped_resonance() -> None:
    """One error, as from Python."""
    family = EQUATIONS_CLASS_BY_PARAMETER["omega"](
        fc.Problem(oscillator(None, 0.1), 0.5, fc.UnilateralPenalty(1.0), 3), 0.5, 1.5
    )
    catch_error(
        lambda: solve_at_parameter(family, np.ones((7, 1)), 0.5, tolerance=1e-9),
        names="singular",
        kind=fc.ConvergenceError,
    )


def test_fold_and_value_between_two_points() -> None:
    """p(s) turns at t_p = 0, and takes the value asked for, on the path; the same from Python."""
    law = fc.UnilateralPenalty(1.0)
    structure = oscillator(0.02, 0.1)
    family = EQUATIONS_CLASS_BY_PARAMETER["omega"](fc.Problem(structure, 2.0, law, 10), 2.0, 0.3)
    start = fc.solve_harmonic_balance(structure, 2.0, law, harmonics=10).gap_coefficients
    points = followed(
        family, start, PathOptions(0.01, max_step=0.2, min_step=1e-10, min_cosine=0.85), 95
    )
    pairs = list(pairwise(points))
    fold_pairs = [ends for ends in pairs if ends[0].tangent.p * ends[1].tangent.p < 0.0]
    assert len(fold_pairs) == 2
    for ends in fold_pairs:
        fold = must(Fold().locate(family, ends, 1e-11))
        assert abs(fold.tangent.p) < 1e-7
        assert_same_point(fold, must(Fold().locate(Plain(family), ends, 1e-11)))
    for start_point, end_point in pairs[10:90:20]:
        target = 0.3 * start_point.parameter + 0.7 * end_point.parameter
        target_point = must(Target(target).locate(family, (start_point, end_point), 1e-11))
        assert target_point.parameter == target
        assert_same_point(
            target_point,
            must(Target(target).locate(Plain(family), (start_point, end_point), 1e-11)),
        )
        linearisation = family.linearise(target_point.unknown, target_point.parameter)
        assert np.linalg.norm(linearisation.residual) < 1e-10 * np.linalg.norm(target_point.unknown)


def assert_same_point(point: PathPoint, expected_point: PathPoint) -> None:
    """To what Newton's method leaves."""
    size = np.abs(expected_point.unknown).max()
    assert point.parameter == pytest.approx(expected_point.parameter, abs=1e-10)
    assert np.allclose(point.unknown, expected_point.unknown, rtol=0.0, atol=1e-9 * size)
    assert np.allclose(point.tangent.x, expected_point.tangent.x, rtol=0.0, atol=1e-7 * size)
    assert point.tangent.p == pytest.approx(expected_point.tangent.p, abs=1e-7)
    assert point.iterations == expected_point.iterations


@pytest.mark.parametrize("name", list(RANGES))
def test_largest_compliance(name: str) -> None:
    """Of random chains, at parameters in and out of the range."""
    structure, law = chain(pairs=3), fc.UnilateralPenalty(np.array([3.0, 8.0, 20.0]))
    family = EQUATIONS_CLASS_BY_PARAMETER[name](fc.Problem(structure, 0.83, law, 4), *RANGES[name])
    for parameter in (-0.2, 0.0, 0.4, 1.0):
        matrices = family.system(family.value(parameter)).compliance_model.matrices
        max_row_sum = np.abs(matrices).sum(axis=2).max()
        assert family.compiled_equations.max_dynamic_row_sum(parameter) == pytest.approx(
            max_row_sum, rel=1e-12
        )


def must(point: PathPoint | None) -> PathPoint:
    """A point that has been found."""
    assert point is not None
    return point


def test_folds_of_a_stiff_curve() -> None:
    """kc = 100, long steps: at every fold that is reported the path turns."""
    law = fc.UnilateralPenalty(100.0)
    continuation = Continuation(
        fc.Problem(oscillator(0.02, 0.1), 2.0, law, 10), "omega", 2.0, 0.3, longest_step=0.2
    )
    for _ in continuation:
        pass
    family = EQUATIONS_CLASS_BY_PARAMETER["omega"](
        fc.Problem(oscillator(0.02, 0.1), 2.0, law, 10), 2.0, 0.3
    )
    folds = continuation.curve.bifurcations
    assert len(folds) == 16
    for fold in folds:
        parameter, unknown = family.parameter(fold.value), fold.single_point_curve.points[0]
        tangent = tangent_of(family, unknown, family.linearise(unknown, parameter))
        start = PathPoint(unknown, parameter, 0, tangent)
        sides = [must(try_step(family, start, step, 1e-11)) for step in (1e-5, 2e-5)]
        assert abs(tangent.p) < 1e-5
        # p leaves the fold with the square of the distance.
        lower_offset, upper_offset = (side.parameter - parameter for side in sides)
        assert abs(lower_offset) < 1e-3 * 1e-5 or upper_offset == pytest.approx(
            4.0 * lower_offset, rel=0.5
        )


def test_path_of_many_unknowns() -> None:
    """144 unknowns, so that solutions take products with J: points and tangents are on the path,
    and each is where equations in Python, whose J is factored at every iteration, have one."""
    structure, law = chain(pairs=3), fc.UnilateralPenalty(np.array([3.0, 8.0, 20.0]))
    family = EQUATIONS_CLASS_BY_PARAMETER["omega"](fc.Problem(structure, 1.4, law, 24), 1.4, 0.5)
    start = fc.solve_harmonic_balance(
        structure, 1.4, law, harmonics=24, residual_tolerance=1e-12
    ).gap_coefficients
    options = PathOptions(0.01, max_step=0.05, rtol=1e-9, min_cosine=0.85)
    ways = [followed(system, start, options, 100) for system in (family, Plain(family))]
    for point, expected_point in zip(*ways, strict=True):
        linearisation = family.linearise(point.unknown, point.parameter)
        size, tangent = np.linalg.norm(point.unknown), point.tangent
        assert np.linalg.norm(linearisation.residual) < 2e-9 * size
        residual_along_tangent = (
            linearisation.apply(tangent.x) + tangent.p * linearisation.by_parameter
        )
        assert np.linalg.norm(residual_along_tangent) < 1e-4 * size
        assert point.parameter == pytest.approx(expected_point.parameter, abs=1e-6)
        assert np.allclose(point.unknown, expected_point.unknown, rtol=0.0, atol=1e-5 * size)
        assert tangent.cosine_to(expected_point.tangent, family) > 1.0 - 1e-6
        assert point.iterations <= expected_point.iterations + 2


def test_branch_crosses_a_path_of_many_unknowns() -> None:
    """Two like oscillators, weakly coupled: next to the folds where they move alike, branches on
    which they do not cross the path. Tangents do not show it; the next sign of det J does, and the
    points between are followed again."""
    stiffness = np.array([[1.005, -0.005], [-0.005, 1.005]])
    twins = fc.Structure.from_matrices(
        np.eye(2), stiffness, gap=np.eye(2), force_cos=np.array([0.1, 0.1]),
        damping=0.05 * np.eye(2), clearance=1.0,
    )  # fmt: skip
    law = fc.UnilateralPenalty(1.0)
    family = EQUATIONS_CLASS_BY_PARAMETER["omega"](fc.Problem(twins, 0.8, law, 25), 0.8, 1.5)
    start = fc.solve_harmonic_balance(
        twins, 0.8, law, harmonics=25, residual_tolerance=1e-12
    ).gap_coefficients
    assert start.size == 102
    options = PathOptions(0.01, max_step=0.05, min_step=1e-10, rtol=1e-9, min_cosine=0.85)
    ways = [followed(system, start, options, 100) for system in (family, Plain(family))]
    crossings = [[point.parameter for point in way if point.crosses_branch] for way in ways]
    assert len(crossings[0]) == len(crossings[1]) == 2
    assert np.allclose(*crossings, rtol=0.0, atol=1e-6)
    turns = [
        [
            point_after.parameter
            for previous_point, point_after in pairwise(way)
            if previous_point.tangent.p * point_after.tangent.p < 0
        ]
        for way in ways
    ]
    assert len(turns[0]) == len(turns[1]) == 2
    assert np.allclose(*turns, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("name", list(RANGES))
def test_derivative_by_each_parameter(name: str) -> None:
    """dF/dp against central differences, along the whole range."""
    structure, (start, end) = two_masses(), RANGES[name]
    law = fc.UnilateralPenalty(np.array([3.0]))
    family = EQUATIONS_CLASS_BY_PARAMETER[name](fc.Problem(structure, 0.9, law, 4), start, end)
    gap = np.random.default_rng(2).normal(size=(9, 1))
    for parameter in (0.0, 0.4, 1.0):
        exact = family.linearise(gap, parameter).by_parameter
        sides = [family.linearise(gap, parameter + step).residual for step in (1e-6, -1e-6)]
        slope = (sides[0] - sides[1]) / 2e-6
        assert np.allclose(slope, exact, rtol=1e-5, atol=1e-7 * np.abs(exact).max())


def test_undamped_resonance_that_the_load_leaves_alone() -> None:
    """A third harmonic meets a mode without damping and load there: a solution like any other."""
    mass, stiffness = np.eye(2), np.diag([1.0, 9.0 * 0.7**2])
    structure = fc.Structure.from_matrices(mass, stiffness, gap=[1.0, 0.1], force_cos=[0.2, 0.0])
    law = fc.UnilateralPenalty(0.5)
    solution = fc.solve_harmonic_balance(structure, 0.7, law, harmonics=5)
    assert solution.converged
    family = EQUATIONS_CLASS_BY_PARAMETER["omega"](fc.Problem(structure, 0.7, law, 5), 0.7, 1.7)
    point = solve_in_plane(family, 1.01 * solution.gap_coefficients, 0.0, None, tolerance=1e-9)
    np.testing.assert_allclose(point.unknown, solution.gap_coefficients, rtol=1e-6, atol=1e-8)


# --- behind a static compliance -------------------------------------------------------------------


LAWS = ("rigid", "penalty", "stiff")


def coupled_family(
    name: str, law: str, damping: str, harmonics: int, pairs: int, modes: int, seed: int
) -> BalanceEquations:
    """Of a random chain on lips without mass."""
    random = np.random.default_rng(seed)
    stiffness = random.uniform(0.5, 20.0, pairs) * (1e4 if law == "stiff" else 1.0)
    contact = fc.UnilateralConstraint() if law == "rigid" else fc.UnilateralPenalty(stiffness)
    full_structure = chain(damping, pairs=pairs, seed=seed % 1000)
    structure = fc.reduce_structure(full_structure, modes=modes, method="massless")
    return EQUATIONS_CLASS_BY_PARAMETER[name](
        fc.Problem(structure, 0.83, contact, harmonics), *RANGES[name]
    )


def assert_same_equations(
    kernel_point: Linearisation, python_point: Linearisation, residual: np.ndarray
) -> None:
    """F, dF/dp, J^-1 r and the sign of det J, as well as they are conditioned."""
    singular_numbers = np.linalg.svd(python_point.jacobian, compute_uv=False)
    assert relative(kernel_point.residual, python_point.residual) < 1e-10
    slope = python_point.by_parameter
    assert np.abs(kernel_point.by_parameter - slope).max() < 1e-10 * max(1e-3, np.abs(slope).max())
    condition = float(singular_numbers[0] / singular_numbers[-1])
    assert (
        relative(kernel_point.solve(residual), python_point.solve(residual))
        < 1e-13 * condition + 1e-11
    )
    assert kernel_point.sign == python_point.sign or condition > 1e10


@settings(max_examples=60, deadline=None)
@given(
    st.sampled_from(list(RANGES)),
    st.sampled_from(LAWS),
    st.sampled_from(["modal", "rayleigh"]),
    st.integers(1, 8),
    st.integers(1, 3),
    st.integers(1, 6),
    SEEDS,
)
def test_coupled_equations_at_a_point(
    name: str, law: str, damping: str, harmonics: int, pairs: int, modes: int, seed: int
) -> None:
    """Of random chains in every family: fewer modes than pairs among them, clearances of either
    sign."""
    if law == "rigid" and name == "stiffness":
        name = "omega"
    family = coupled_family(name, law, damping, harmonics, pairs, modes, seed)
    kernel, random = family.compiled_equations, np.random.default_rng(seed)
    assert isinstance(kernel, CompiledEquations)
    gap, residual = random_gap(random, harmonics, pairs), random.normal(size=family.shape)
    parameter = float(random.uniform(-0.2, 1.2))
    python_point = family.linearise(gap, parameter)
    assert_same_equations(kernel.linearise(gap, parameter), python_point, residual)


@pytest.mark.parametrize("formed", [True, False])
@pytest.mark.parametrize("name", list(RANGES))
def test_coupled_path_of_a_chain(name: str, formed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """With three pairs on lips without mass, in every family: the steps that Python's loop takes,
    to rounding where J is formed, to what products leave where it is not."""
    if not formed:
        monkeypatch.setattr(contact_system, "MAX_UNKNOWNS_WITH_JACOBIAN", 0)
    family = coupled_family(name, "penalty", "modal", 5, 3, 4, 1)
    system = family.system(family.start)
    assert system.integrals.has_coupled_pairs and system.is_matrix_free != formed
    start = solve_at_parameter(Plain(family), system.linear_gap, 0.0, tolerance=1e-12)
    tolerance, slope = (1e-11, 1e-10) if formed else (1e-6, 1e-3)
    options = PathOptions(0.01, max_step=0.2, min_step=1e-10)
    ways = [
        list(islice(Path(way, point_on_path(way, start.unknown, 0.0), options).points(), 12))
        for way in (family, Plain(family))
    ]
    for kernel_point, python_point in zip(*ways, strict=True):
        assert kernel_point.parameter == pytest.approx(python_point.parameter, abs=tolerance)
        assert np.allclose(kernel_point.unknown, python_point.unknown, rtol=0.0, atol=tolerance)
        assert np.allclose(kernel_point.tangent.x, python_point.tangent.x, rtol=0.0, atol=slope)
        assert abs(kernel_point.iterations - python_point.iterations) <= (0 if formed else 1)


@pytest.mark.parametrize("limit", [350, 0])
def test_many_unknowns(limit: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A rigid path through its folds, its solutions found by products and its sign by factors, or
    not at all: its points are solutions, and it ends where Python's ends."""
    monkeypatch.setattr(contact_system, "MAX_UNKNOWNS_WITH_JACOBIAN", limit)
    structure = fc.reduce_structure(chain("modal", pairs=3), modes=6, method="massless")
    problem = fc.Problem(structure, 0.83, fc.UnilateralConstraint(), 20)
    family = EQUATIONS_CLASS_BY_PARAMETER["omega"](problem, 0.6, 0.45)
    start_solution = fc.solve_harmonic_balance(structure, 0.6, problem.contact, harmonics=20)
    start = start_solution.gap_series_without_static_part
    ends = []
    for system in (family, Plain(family)):
        start_point = point_on_path(system, start, 0.0)
        path = Path(system, start_point, PathOptions(0.05, max_step=0.3), [Target(1.0)])
        for point in path.points():
            linearisation = family.linearise(point.unknown, point.parameter)
            assert np.linalg.norm(linearisation.residual) < 2e-8 * np.linalg.norm(point.unknown)
        assert (
            path.end_reason is EndReason.TERMINAL_EVENT_REACHED and path.last_point.parameter == 1.0
        )
        ends.append(path.last_point.unknown)
    assert relative(ends[0], ends[1]) < 1e-8


def test_equations_are_freed_with_their_points() -> None:
    """At once, without a search for cycles: the kernel's arrays of many solutions would stay."""
    family = coupled_family("omega", "rigid", "modal", 4, 3, 5, 2)
    compiled = family.compiled_equations
    linearisation = compiled.linearise(np.zeros(family.shape), 0.5)
    assert linearisation.residual.any()
    references = [weakref.ref(compiled), weakref.ref(linearisation)]
    del family, compiled, linearisation
    assert [reference() for reference in references] == [None, None]


def test_an_instant_without_forces_is_no_solution() -> None:
    """BalanceEquations that are not finite: no point, and no crash."""
    family = coupled_family("omega", "rigid", "modal", 4, 3, 5, 2)
    for bad_number in (np.nan, np.inf, 1e300):
        assert (
            solve_at_parameter(family, np.full(family.shape, bad_number), 0.5, tolerance=1e-9)
            is None
        )
    compiled = family.compiled_equations
    assert compiled is not None and compiled.linearise(np.zeros(family.shape), 0.5).residual.any()
    linearisation = compiled.linearise(
        np.full(family.shape, np.nan), 0.5
    )  # not the residual of the former
    catch_error(lambda: linearisation.residual, names="no forces", kind=fc.ConvergenceError)
