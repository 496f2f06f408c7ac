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
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import ROOT, random_stiffness
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from switching import switching_instants
from test_contact_integrals import grazing_gaps, random_gaps

import fenics_crack as fc
from fenics_crack.balance.contact_integrals import (
    CoupledIntegrals,
    ExactIntegrals,
    respond,
    respond_to_columns,
)
from fenics_crack.balance.contact_system import CompiledEquations
from fenics_crack.kernel import Struct, kernel, owned, pointer, shaped
from fenics_crack.model.contact import ActiveSets, solve_complementarity
from fenics_crack.numerics.equations import ROUNDING
from fenics_crack.numerics.fourier import evaluate, to_complex

OTHERS = [
    ROOT / "tests" / name
    for name in (
        "balance/test_active_sets.py", "balance/test_compiled_paths.py",
        "motion/test_contact_flow.py", "numerics/test_paths.py", "time/test_compiled_marches.py",
    )
]  # fmt: skip
"""Other files whose tests are run with it."""

WITH_CHECKS = """
import importlib.util, sys, pytest
name = "fenics_crack.kernel._kernel"
spec = importlib.util.spec_from_file_location(name, sys.argv[1])
sys.modules[name] = importlib.util.module_from_spec(spec)
spec.loader.exec_module(sys.modules[name])
sys.exit(pytest.main(["-q", "-x", "-n", "0", "-p", "no:cacheprovider", *sys.argv[2:]]))
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
        turned = np.zeros((len(self.theta), len(self.first)), dtype=bool)
        turned[0] = self.first
        turned[np.arange(1, len(self.theta)), self.pair] = True
        return np.logical_xor.accumulate(turned, axis=0)

    def rests(self, highest: int) -> np.ndarray:
        """Means over the period of exp(i m theta) from where each interval begins to the period's
        end: (m, highest + 1)."""
        order = np.arange(highest + 1)
        found = 1.0 - np.exp(1j * np.multiply.outer(self.theta, order))
        found[:, 0] = 2.0 * np.pi - self.theta
        found[:, 1:] /= 1j * order[1:]
        return found / (2.0 * np.pi)


def contact_intervals(gap: np.ndarray, contact: ActiveSets) -> Intervals:
    """The intervals of waves s with coefficients (2H+1, n_pairs).

    Raises ConvergenceError where an instant has no forces.
    """
    columns, pairs = len(gap), len(contact.compliance)
    gap = shaped(gap, 2 * (columns // 2) + 1, pairs)
    count = kernel.interval_cells(columns // 2, pairs)
    first, stiffness = np.empty(pairs, dtype=bool), np.empty((pairs, pairs))
    table = Struct(
        "pivot_table", pairs=pairs, d=contact.compliance, table=np.empty((pairs, pairs)),
        closed=np.empty(pairs, dtype=bool), room=np.empty(4 * pairs),
    )  # fmt: skip
    waves, places = _waves(columns // 2, count, pairs), count + 8 * pairs
    while True:
        theta, pair = np.zeros(places + 1), np.empty(places, dtype=np.intc)
        vectors, gains = np.empty((places, pairs)), np.empty(places)
        known = Struct(
            "breathing", contact=table, cells=count, most=places, columns=columns, gaps=gap,
            waves=waves, allowed=ROUNDING * float(np.abs(gap).sum(axis=0).max(initial=0.0)),
            first=first, stiffness=stiffness, theta=theta[1:], pair=pair, vectors=vectors,
            gain=gains, work=np.empty(kernel.intervals_room(pairs, columns // 2, count)),
        )  # fmt: skip
        found = kernel.intervals(known.at)
        if found >= 0:
            return Intervals(
                theta[: found + 1], first, pair[:found], stiffness, vectors[:found], gains[:found]
            )
        if found == NO_FORCES:
            raise fc.ConvergenceError("contact: no forces were found at an instant of the period")
        places *= 2


@lru_cache(maxsize=16)
def _waves(harmonics: int, count: int, pairs: int) -> Any:
    """What the kernel finds gaps with at equally spaced phases."""
    return owned(kernel.new_waves(harmonics, count, pairs), kernel.free_waves)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 25), st.integers(0, 2**32 - 1), st.booleans())
def test_complementarity(pairs: int, seed: int, guessed: bool) -> None:
    """0 <= f, D f - g >= 0, f (D f - g) = 0 hold to rounding: there is one such f."""
    random = np.random.default_rng(seed)
    root = random.normal(size=(pairs, pairs + 2))
    matrix, gap = root @ root.T + 1e-3 * np.eye(pairs), random.normal(size=pairs)
    closed = random.random(pairs) < 0.5 if guessed else None
    force = solve_complementarity(matrix, gap, closed)
    opening = matrix @ force - gap
    assert force.min() >= 0.0
    assert opening.min() >= -1e-9 * np.abs(gap).max()
    assert np.abs(force * opening).max() <= 1e-9 * np.abs(gap).max() * max(1.0, force.max())


TWO = ActiveSets(np.eye(2))
BEHIND = CoupledIntegrals(fc.UnilateralPenalty(1.0), 1, residual=np.eye(2))
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
    "coupled forces, another change": lambda: BEHIND.linearise(np.ones((3, 2))).apply(np.ones(6)),
    "sets, a compliance not square": lambda: ActiveSets(np.ones((3, 2))),
    "sets, other pairs": lambda: TWO.solve(np.ones((4, 3))),
    "sets, a guess too short": lambda: TWO.solve(np.ones((4, 2)), np.ones((3, 2), bool)),
    "inverses, other pairs": lambda: TWO.stack(np.ones((4, 3), bool)),
    "responses, other pairs": lambda: respond(np.ones((2, 3, 3)), np.ones((3, 2))),
    "responses, an even number of rows": lambda: respond(np.ones((3, 2, 2)), np.ones((4, 2))),
    "columns, an even number of rows": lambda: respond_to_columns(
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
    "another shape": lambda: shaped(np.ones((3, 2)), 3, 3),
}  # fmt: skip


@pytest.mark.parametrize("call", WRONG.values(), ids=WRONG.keys())
def test_wrong_shapes_are_refused(call: Callable[[], object]) -> None:
    """Nothing is read beyond an array; also where Python leaves out what is asserted (-O)."""
    with pytest.raises(ValueError, match=r"instead of|contiguous"):
        call()


def test_wrong_kinds_are_refused() -> None:
    """By a function, and as a member."""
    ones = pointer(np.ones(3))
    with pytest.raises(TypeError, match="same type"):
        kernel.respond(1, 1, ones, pointer(np.ones(3, np.intc)), ones)
    with pytest.raises(TypeError, match="same type"):
        Struct("flow_track", lengths=np.ones(3, bool))


def test_shapes_that_fit_are_not_copied() -> None:
    """But where the kind or the order is another."""
    array = np.ones((3, 2))
    assert shaped(array, 3, 2) is array
    assert shaped(array.T, 2, 3).flags.c_contiguous
    assert shaped(array, 3, 2, kind=complex).dtype == complex


# --- when which pairs are closed ------------------------------------------------------------------


def coupled_sets(pairs: int, seed: int = 1) -> ActiveSets:
    """Of a random compliance that couples all pairs."""
    return ActiveSets(np.linalg.inv(random_stiffness(np.random.default_rng(seed), pairs)))


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
    _, expected = contact.solve(evaluate(gap, 1.0, theta))
    assert np.array_equal(closed_at(intervals, theta), expected)
    assert len(intervals.theta) > pairs
    # The forces on both sides of an event are the same: they vanish, or begin, there.
    values = evaluate(gap, 1.0, intervals.theta[1:])
    before, after = (
        np.einsum("npq,nq->np", contact.stack(sets), values)
        for sets in (intervals.closed[:-1], intervals.closed[1:])
    )
    largest = np.abs(contact.solve(evaluate(gap, 1.0, theta))[0]).max()
    assert np.abs(before - after).max() < 1e-9 * largest


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 40), st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_stiffness_follows_from_its_changes(pairs: int, harmonics: int, seed: int) -> None:
    """Event after event the inverse of NumPy on the closed pairs, zero outside, to 1e-12."""
    random = np.random.default_rng(seed)
    gap = random.normal(size=(2 * harmonics + 1, pairs))
    compliance = np.linalg.inv(random_stiffness(random, pairs))
    intervals = contact_intervals(gap, ActiveSets(compliance))
    found = intervals.stiffness.copy()
    changes = zip(intervals.gains, intervals.vectors, strict=True)
    for closed, change in zip(intervals.closed, [*changes, None], strict=True):
        expected = np.zeros((pairs, pairs))
        inside = np.ix_(closed, closed)
        expected[inside] = np.linalg.inv(compliance[inside])
        assert np.abs(found - expected).max() <= 1e-12 * max(1.0, np.abs(expected).max())
        if change is not None:
            found += change[0] * np.outer(change[1], change[1])


@pytest.mark.parametrize("stiffness", [1e4, 1e6])
def test_a_compliance_close_to_singular(stiffness: float) -> None:
    """Neighbours that hardly differ, condition numbers of 2e5 and 2e7: rounding is left behind."""
    place = np.linspace(0.0, 3.0, 40)
    compliance = np.exp(-((place[:, None] - place) ** 2)) + np.eye(40) / stiffness
    gap = random_gaps(6, 40, 1)
    intervals = contact_intervals(gap, ActiveSets(compliance))
    theta = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, 200)
    values = evaluate(gap, 1.0, theta)
    for value, closed in zip(values, closed_at(intervals, theta), strict=True):
        force = np.zeros(40)
        force[closed] = np.linalg.solve(compliance[np.ix_(closed, closed)], value[closed])
        assert np.all(force >= 0.0) and np.all((compliance @ force - value)[~closed] > -1e-9)
    last = intervals.stiffness + (intervals.vectors.T * intervals.gains) @ intervals.vectors
    assert np.abs(last - intervals.stiffness).max() < 1e-9 * np.abs(last).max()


def test_events_of_one_pair_are_its_zeros() -> None:
    """The instants of the search for pairs that nothing couples."""
    for seed in range(5):
        gap = random_gaps(8, 1, seed)
        intervals = contact_intervals(gap, ActiveSets(np.full((1, 1), 0.3)))
        switching = switching_instants(to_complex(gap))
        expected = np.sort(np.mod(switching.theta, 2.0 * np.pi))
        assert np.allclose(intervals.theta[1:], expected, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("depth", [1e-3, 1e-5, 1e-7, 1e-9])
def test_contact_that_comes_and_goes_in_a_cell(depth: float) -> None:
    """A peak that high above zero: 2 (2 d / |g''|)^1/2 long; so high below: no contact; and the
    same upside down."""
    gaps = grazing_gaps(np.full(20, depth))
    phase = np.linspace(0.0, 2.0 * np.pi, 1 << 16, endpoint=False)
    for gap in gaps.T[:, :, None]:
        wave = evaluate(gap, 1.0, phase)[:, 0]
        top = int(np.argmax(wave))
        width = phase[1] - phase[0]
        bend = (wave[top - 1] - 2.0 * wave[top] + wave[(top + 1) % len(wave)]) / width**2
        long = 2.0 * np.sqrt(2.0 * depth / -bend)
        contact = ActiveSets(np.eye(1))
        found = closed_for(contact_intervals(gap, contact))
        assert found == pytest.approx(long, rel=0.2 if depth > 1e-4 else 0.02)
        missing = contact_intervals(-gap, contact)
        assert 2.0 * np.pi - closed_for(missing) == pytest.approx(found, rel=1e-4)
        gap[0] -= 2.0 * depth
        assert closed_for(contact_intervals(gap, contact)) == 0.0


def test_pairs_that_open_and_close_together() -> None:
    """Equal waves on equal pairs, in pairs that differ by rounding: their events coincide."""
    one = random_gaps(6, 1, 3)
    compliance = 2.0 * np.eye(4) + 0.5
    together = ActiveSets(np.array([[compliance.sum(axis=1)[0]]]))
    alone = contact_intervals(one, together)
    for noise in (0.0, 1e-16, 1e-13):
        gap = np.tile(one, 4) * (1.0 + noise * np.arange(4))
        intervals = contact_intervals(gap, ActiveSets(compliance))
        for pair in range(4):
            assert closed_for(intervals, pair) == pytest.approx(closed_for(alone), abs=1e-9)
        theta = np.random.default_rng(1).uniform(0.0, 2.0 * np.pi, 500)
        theta = theta[np.abs(theta[:, None] - alone.theta).min(axis=1) > 1e-6]
        assert np.array_equal(closed_at(intervals, theta), np.tile(closed_at(alone, theta), 4))


@pytest.mark.parametrize("harmonics", [1, 3, 8])
@pytest.mark.parametrize("wave", ["sine", "cosine", "both"])
def test_events_at_the_ends_of_cells(wave: str, harmonics: int) -> None:
    """Zeros on the grid: half of the period closed, in pairs that are each other's opposite too."""
    gap = np.zeros((2 * harmonics + 1, 2))
    row = {"sine": [2, 2], "cosine": [1, 1], "both": [1, 2]}[wave]
    gap[row[0], 0], gap[row[1], 1] = 1.0, -1.0
    contact = ActiveSets(np.diag([1.0, 3.0]))
    for sign in (1.0, -1.0):
        intervals = contact_intervals(sign * gap, contact)
        assert closed_for(intervals, 0) == pytest.approx(np.pi, abs=1e-12)
        assert closed_for(intervals, 1) == pytest.approx(np.pi, abs=1e-12)
        theta = np.linspace(0.1, 6.2, 37)
        expected = evaluate(sign * gap, 1.0, theta) > 0.0
        assert np.array_equal(closed_at(intervals, theta), expected)


def test_always_open_and_always_closed() -> None:
    """No event: one set for all of the period."""
    gap = random_gaps(4, 3)
    for mean, closed in ((-100.0, False), (100.0, True)):
        gap[0] = mean
        compliance = np.eye(3) + 0.1
        intervals = contact_intervals(gap, ActiveSets(compliance))
        assert len(intervals.theta) == 1 and np.all(intervals.closed == closed)
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
def test_with_checks_of_addresses(tmp_path: Path) -> None:
    """The tests above with a kernel that ends the process where it reads outside its arrays."""
    build = ROOT / "fenics_crack" / "kernel" / "build.py"
    subprocess.run([sys.executable, build, "--sanitize", tmp_path], check=True)
    library = subprocess.run(
        ["gcc", "-print-file-name=libasan.so"], check=True, capture_output=True, text=True
    ).stdout.strip()
    known = {"LD_PRELOAD": library, "ASAN_OPTIONS": "detect_leaks=0"}
    done = subprocess.run(
        [sys.executable, "-c", WITH_CHECKS, tmp_path / "_kernel.abi3.so", __file__, *OTHERS],
        cwd=ROOT, env=os.environ | known, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
