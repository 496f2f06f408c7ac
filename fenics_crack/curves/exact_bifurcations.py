"""Bifurcations of exact orbits: where multipliers cross the unit circle, without truncation.

Harmonic balance locates a bifurcation as well as its wave is resolved: with stiff contact and few
harmonics, to some per cent. Here the branch of exact orbits is followed from there by
pseudo-arc-length, in both directions by turns, until one of its segments has a bifurcation of this
kind (:mod:`orbit_branch`).

Source: Kuznetsov, Elements of Applied Bifurcation Theory, chapter 10; Seydel, Practical
Bifurcation and Stability Analysis, chapters 4 and 7.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain, pairwise, zip_longest
from typing import Protocol

import numpy as np

from fenics_crack.balance.orbits import FlowOrbits
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.orbit_branch import (
    ALIKE,
    ITERATIONS,
    KINDS,
    STRAIGHT,
    TOLERANCE,
    Node,
    OrbitBranch,
)
from fenics_crack.errors import ConvergenceError, InputError, check_number
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.structure import Structure
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.numerics.bordered import SHORTEST, PathPoint, solve_in_plane, tangent_of
from fenics_crack.numerics.path import Path, PathOptions
from fenics_crack.stability.shooting import orbits_near

__all__ = ["refine_bifurcation"]


class _Special(Protocol):
    """What is asked of a bifurcation: as :class:`fenics_crack.curves.curve.Bifurcation`."""

    @property
    def kind(self) -> str: ...

    @property
    def solution(self) -> PeriodicSolution: ...


def refine_bifurcation(
    bifurcation: _Special,
    structure: Structure | None = None,
    contact: ContactLaw | None = None,
    *,
    reach: float = 0.05,
    longest_step: float = 0.02,
) -> tuple[float, PeriodicOrbit]:
    """Locate a bifurcation found by harmonic balance on the branch of exact orbits.

    Parameters
    ----------
    bifurcation : Bifurcation
        Of a curve; or anything with ``kind`` and ``solution``.
    structure : Structure, optional
        Default: the solution's; at most 600 dofs.
    contact : UnilateralPenalty, optional
        Default: the solution's.
    reach : float
        How far to look, relative to the frequency of the solution; at most 0.5.
    longest_step : float
        Along the branch, relative to the solution's size and frequency.

    Returns
    -------
    omega : float [rad/s]
        Load frequency of the bifurcation nearest along the branch.
    orbit : PeriodicOrbit
        The orbit there.

    Raises
    ------
    InputError
        The kind is another, or as :func:`fenics_crack.integrate_events`.
    ConvergenceError
        No exact orbit near the solution, or no bifurcation of this kind within reach of it.

    Notes
    -----
    With few harmonics a curve has special points that are not there on exact orbits, or several
    where these have one: several of them may lead to the same point, or to none.

    Examples
    --------
    >>> omega, orbit = fc.refine_bifurcation(doubling.bifurcations[0])
    """
    kind, solution = bifurcation.kind, bifurcation.solution
    if kind not in KINDS:
        raise InputError("kind", kind, "one of " + ", ".join(map(repr, KINDS)))
    check_number("reach", reach, 0.0, above=True)
    if reach > 0.5:
        raise InputError("reach", reach, "at most 0.5")
    check_number("longest_step", longest_step, 0.0, above=True)
    law = solution.contact if contact is None else contact
    assert law is not None
    orbits = orbits_near(structure or solution.structure, law, solution)
    start = _orbit_next_to(orbits)
    if start is None:
        raise ConvergenceError(
            f"refinement: no exact orbit near the solution at {solution.omega:g} rad/s"
        )
    far = reach + longest_step
    options = PathOptions(
        0.1 * longest_step, longest_step, rtol=TOLERANCE, min_cosine=STRAIGHT, at_once=1,
        span=(1.0 - far, 1.0 + far),
    )  # fmt: skip
    ways = start.tangent, start.tangent.reversed()
    sides = [_met(orbits, replace(start, tangent=way), options) for way in ways]
    for node in chain.from_iterable(chain.from_iterable(zip_longest(*sides, fillvalue=()))):
        assert node.crossing is not None
        within = abs(node.parameter - 1.0) <= reach
        if node.crossing.kind == kind and node.crossing.located and within:
            found = PathPoint(node.unknown, node.parameter, start.iterations, node.tangent)
            return node.parameter * solution.omega, orbits.orbit(found)
    raise ConvergenceError(
        f"refinement: no {kind.replace('_', ' ')} of exact orbits within "
        f"{100.0 * reach:g} % of {solution.omega:g} rad/s"
    )


def _orbit_next_to(orbits: FlowOrbits) -> PathPoint | None:
    """The orbit next to a solution's motion, across the branch; None where it is another one's."""
    try:
        ahead = tangent_of(orbits, orbits.start, orbits.linearise(orbits.start, 1.0))
        found = solve_in_plane(
            orbits, orbits.start, 1.0, ahead,
            tolerance=TOLERANCE, iterations=ITERATIONS, reach=0.5, least_damping=SHORTEST,
        )  # fmt: skip
    except ConvergenceError:  # pairs chatter without end
        return None
    if found is None or np.linalg.norm(found.unknown - orbits.start) > ALIKE:
        return None
    assert found.at is not None
    return replace(found, tangent=tangent_of(orbits, found.unknown, found.at))


def _met(orbits: FlowOrbits, start: PathPoint, options: PathOptions) -> Iterator[list[Node]]:
    """The bifurcations of each segment of the branch, from an orbit along its tangent."""
    path = Path(orbits, start, options)
    try:
        for ends in pairwise(chain([start], path.points())):
            parameters = np.array([one.parameter for one in ends])
            unknowns = np.array([one.unknown for one in ends])
            branch = OrbitBranch(orbits, parameters, unknowns.__getitem__, every=1)
            branch.locate()
            yield [one for one in branch.nodes if one.crossing is not None]
    except ConvergenceError:  # pairs chatter without end
        return
