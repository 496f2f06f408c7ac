"""Response curves of harmonic balance: points that solve the truncated equations."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np

from fenics_crack.balance.assessment import Assessment
from fenics_crack.balance.compliance import ModalCompliance
from fenics_crack.balance.contact_system import ContactPoint
from fenics_crack.balance.problem import Problem
from fenics_crack.balance.solution import PeriodicSolution, solution_of
from fenics_crack.basics.tables import TURN
from fenics_crack.curves.curve import PARTS, ResponseCurve
from fenics_crack.curves.family import FAMILIES, Family
from fenics_crack.model.contact import coefficient_of
from fenics_crack.model.modal import all_modes
from fenics_crack.motion.motions import Record
from fenics_crack.numerics.fourier import waves_of

FOLLOWED = "fold", "branch_point"
"""Kinds of bifurcations that a curve has before its stability is assessed."""


@dataclass(frozen=True, repr=False, kw_only=True)
class HarmonicCurve(ResponseCurve):
    """Solutions of harmonic balance along a curve.

    Attributes
    ----------
    structure, contact, parameter, values, omega, iterations, complete, status, subharmonic, branch
        As of any :class:`ResponseCurve`.
    unknowns : (n, 2H+1, n_pairs) [m]
        Unknowns: gap coefficients, or those of the slow gap s = g + R_inf lambda where
        pairs are seen through R_inf; with friction (n, 2H+1, 2 n_pairs), tangential gaps behind
        the normal ones.
    samples : int or None
        As given when it was followed.
    multipliers : (n,) complex or None
        With ``stability=True``, as of any :class:`ResponseCurve`; nan where no exact orbit is the
        point's own (:func:`judge_curve`).
    undecided : (n,) bool or None
        Where the stability is left open (:func:`judge_curve`), for a :meth:`reason`; None: not
        assessed.
    static_above : float or None
        With a residual flexibility R_inf, the same for all points: the frequency [rad/s] above
        which modes are quasi-static (:class:`fenics_crack.Problem`); else None.
    """

    unknowns: np.ndarray
    samples: int | None
    static_above: float | None = None
    undecided: np.ndarray | None = None

    FOUND = "unknowns"

    @property
    def harmonics(self) -> int:
        """H."""
        return self.unknowns.shape[1] // 2

    @property
    def method(self) -> str:
        return f"H = {self.harmonics}"

    @cached_property
    def problem(self) -> Problem:
        return Problem(
            self._structure, float(self.omega[0]), self.contact, self.harmonics,
            self.samples, self.subharmonic, self.static_above,
        )  # fmt: skip

    @cached_property
    def gap_coefficients(self) -> np.ndarray:
        count = self.structure.n_pairs
        if self.static_above is None:
            return self.unknowns[..., :count]
        return np.array([at.gap[:, :count] for at in self._linearised()])

    def solution(self, index: int, *, search: bool = True) -> PeriodicSolution:
        problem = self.problem_of(index)
        at = problem.system(problem.compliance()).linearise(self.unknowns[index])
        return solution_of(problem, at, status="point of a curve", search=search)

    def assessment(self, index: int) -> Assessment:
        """Return the assessment of a point by the exact flow; no error is estimated."""
        problem = self.problem_of(index)
        at = problem.system(problem.compliance()).linearise(self.unknowns[index])
        return Assessment(problem.wave(at))

    def reason(self, index: int) -> str:
        """Why the stability is undecided at a point, as :func:`fenics_crack.floquet` says of the
        point's solution by itself; "" where it is decided."""
        if not self._open[index]:
            return ""
        if self._open.all():
            return "no exact orbit is accepted for any point of the curve"
        return self.assessment(index).reason or "its largest multiplier is 1 to rounding"

    def unjudged(self) -> HarmonicCurve:
        """As it was followed: without verdicts, and without what was found with them."""
        special = tuple(one for one in self.bifurcations if one.kind in FOLLOWED)
        return replace(self, bifurcations=special, multipliers=None, undecided=None)

    @cached_property
    def equations(self) -> Family:
        """The truncated equations along the parameter: from its value at the first point to the one
        farthest from there."""
        farthest = int(np.argmax(np.abs(self.values - self.values[0])))
        ends = float(self.values[0]), float(self.values[farthest])
        return FAMILIES[self.parameter](self.problem, *ends)

    def _linearised(self) -> Iterator[ContactPoint]:
        """The equations at all points."""
        if self.parameter == "resonance":  # at a frequency of its own each
            for index, unknown in enumerate(self.unknowns):
                problem = self.problem_of(index)
                yield problem.system(problem.compliance()).linearise(unknown)
            return
        for value, unknown in zip(self.values.tolist(), self.unknowns, strict=True):
            yield self.equations.system(value).linearise(unknown)

    def records(self, rows: np.ndarray) -> Iterator[Record]:
        friction, moved = coefficient_of(self.contact), None
        if self.static_above is not None:
            moved = rows @ all_modes(self.problem.seen).moved_at_once(self.static_above)
        periods = TURN * self.subharmonic / self.omega
        for index, point in enumerate(self._linearised()):
            assert isinstance(point.system.compliance, ModalCompliance)
            waves = point.system.compliance.seen_through(rows, point.force)
            at = partial(_in_period, point, waves, moved)
            yield Record(
                float(self.omega[index]), self.subharmonic, PARTS * periods[index], waves,
                *at(PARTS),
                structure=partial(self._structure_of, index),
                cracks=self.structure.pairs.cracks,
                friction=friction,
                at=at if friction is None else None,
            )  # fmt: skip


def _in_period(
    at: ContactPoint, waves: np.ndarray, moved: np.ndarray | None, parts: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Motion, gaps and contact forces at parts of the period, by the coefficients of the motion
    and its quasi-static answers to the forces."""
    values = waves_of(waves, TURN * parts)
    motion, (gap, force) = values @ waves, at.system.in_time(values @ at.unknown)
    if moved is not None:
        # The quasi-static part follows the forces as they are, with their kinks.
        motion -= (force - values @ at.force) @ moved.T
    return motion, gap, force
