"""Stability of periodic solutions: Floquet multipliers, and a verdict.

The multipliers mu are those of the exact orbit next to a solution, which is stable where they lie
within the unit circle (:mod:`fenics_crack.motion.orbit`); :func:`shoot` finds that orbit by itself.
It is the orbit that the solution's error was found by (:mod:`fenics_crack.balance.judgement`),
which says whether it is the solution's own.

Laws that are not linear in contact have no exact flow. Their verdict is that of the root of Hill's
determinant (:mod:`fenics_crack.stability.waves`) next to the leading multiplier of the linear flow
along the wave, if the wave's error is small.

Source: Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004,
chapter 7.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.judgement import BELIEVED, UNKNOWN, Judgement
from fenics_crack.balance.solution import PeriodicSolution, Stability
from fenics_crack.errors import ConvergenceError, InputError, check_count
from fenics_crack.model.contact import ContactLaw, check_law, is_rigid
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import exact_flow
from fenics_crack.motion.orbit import FORMED, KNOWN, PeriodicOrbit, eigenvalues, find_orbit
from fenics_crack.motion.shooting import LATER, FlowOrbits, in_the_long_run, orbit_next_to
from fenics_crack.stability.waves import hill_root, monodromy
from fenics_crack.time.march import initial_state

__all__ = [
    "PeriodicOrbit", "Stability", "floquet", "leaves", "orbits_near", "shoot", "stability_of",
]  # fmt: skip

FOLLOWED = 30
"""Periods that a motion is followed."""


def leaves(
    orbits: FlowOrbits, motion: np.ndarray, orbit: np.ndarray, parameter: float = 1.0
) -> bool:
    """Whether a motion, given by its x at phase zero, leaves a stable orbit given like that: it is
    much farther away within some periods than at first, or in the end, where it is not there to a
    millionth, or as well as the orbit is known, than a small disturbance would be."""
    there = orbits.linearise(orbit, parameter)
    monodromy, linear = there.monodromy, motion - orbit
    known = np.linalg.norm(np.linalg.solve(np.eye(len(orbit)) - monodromy, there.residual))
    away, expected = [np.linalg.norm(linear)], [np.linalg.norm(linear)]
    try:
        for _ in range(FOLLOWED):
            motion, linear = orbits.moved(motion, parameter), monodromy @ linear
            away.append(np.linalg.norm(motion - orbit))
            expected.append(np.linalg.norm(linear))
            if away[-1] > BELIEVED * max(expected[0], expected[-1]):
                return True
    except ConvergenceError:  # pairs chatter without end
        return True
    return bool(max(away[-LATER:]) > BELIEVED * max(*expected[-LATER:], KNOWN * expected[0], known))


def orbits_near(
    structure: Structure, contact: ContactLaw, solution: PeriodicSolution
) -> FlowOrbits:
    """Orbits of the exact flow."""
    flow = exact_flow(structure, contact)
    state = flow.state(*initial_state(structure, solution))
    return FlowOrbits(flow, solution.omega, state, solution.subharmonic)


def shoot(
    structure: Structure,
    solution: PeriodicSolution,
    contact: ContactLaw | None = None,
    *,
    settle: int = 0,
    tolerance: float = 1e-10,
) -> PeriodicOrbit:
    """Refine a harmonic-balance solution to a periodic orbit in time: z(T) = z(0).

    Newton's method on the exact flow at the solution's frequency, damped where its steps would
    grow.

    Parameters
    ----------
    structure, contact
        Default of the law: the solution's.
    solution : PeriodicSolution
        Where the orbit is sought.
    settle : int
        Follow the flow for so many periods of the response first: towards what attracts it.
    tolerance : float
        ``|z(T) - z(0)| / |z(0)|`` that is accepted.

    Returns
    -------
    PeriodicOrbit
        With its multipliers, gap and contact force.

    Raises
    ------
    InputError
        As :func:`integrate_events`.
    ConvergenceError
        No orbit nearby was found.

    Examples
    --------
    >>> orbit = fc.shoot(structure, solution)
    >>> distance = orbit.multipliers
    """
    law = contact if contact is not None else solution.contact
    assert law is not None
    check_count("settle", settle, 0)
    orbits = orbits_near(structure, law, solution)
    judged = replace(solution, structure=structure, contact=law).judged
    found = None if settle else judged.orbit
    if found is None:
        start = orbits.state(orbits.followed(settle))
        found = orbit_next_to(orbits.flow, solution.omega, start, solution.subharmonic)
    if found is not None and found.residual > tolerance:  # its last step was short, but M is large
        again = find_orbit(found.flow, found.omega, found.state, subharmonic=found.subharmonic)
        found = again or found
    if found is None or not found.residual <= tolerance:
        closest = "" if found is None else f"; closest {found.residual:.1e}"
        raise ConvergenceError(f"shooting: no periodic orbit near the solution{closest}")
    return found


def floquet(
    structure: Structure,
    solution: PeriodicSolution,
    contact: ContactLaw | None = None,
    *,
    refine: bool = True,
) -> Stability:
    """Floquet multipliers of a solution, and whether it is stable.

    The multipliers mu are the eigenvalues of the monodromy matrix dz(T)/dz(0), z being displacement
    and velocity and T the period of the response: a small disturbance becomes mu times as large in
    a period. Stable: ``|mu| < 1`` for all.

    Parameters
    ----------
    structure : Structure
        The solution's; at most 600 dofs, else reduce it before solving.
    solution : PeriodicSolution
        The orbit.
    contact : ContactLaw, optional
        Its law; default: the solution's own.
    refine : bool
        Judge by the multipliers of the exact orbit next to the solution. Else those of the linear
        flow along its wave are returned, which judge nothing: "undecided".

    Returns
    -------
    Stability
        The multipliers, largest first, the verdict, and the reason where it is open: with what the
        exact motion that begins with the solution does in the long run, where no orbit is its own.

    Raises
    ------
    InputError
        The structure is too large, or the law is a constraint of lips with mass.

    Notes
    -----
    Sources: Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004,
    chapter 7; Lazarus and Thomas, Comptes Rendus Mecanique 338 (2010) 510-517.

    Examples
    --------
    >>> stability = fc.floquet(structure, solution)
    >>> verdict, reason = stability.verdict, stability.reason
    """
    if contact is None:
        contact = solution.contact
    check_law(structure, contact, rigid=True)
    assert contact is not None
    if solution.structure.n_dofs != structure.n_dofs:
        raise InputError("solution", f"{solution.structure.n_dofs} dofs", "of this structure")
    judged = replace(solution, structure=structure, contact=contact).judged
    if judged.flow is None:
        if is_rigid(contact) or not is_small(structure):
            exact_flow(structure, contact)  # says what is missing
        return _by_hill(structure, solution, contact)
    if not refine:
        return _along_the_wave(judged, "the multipliers of a wave, without its orbit")
    found = stability_of(judged)
    told = judged.accepted or judged.too_slow or judged.flow.size > FORMED
    if found.verdict == "undecided" and not told:
        return replace(found, reason=f"{found.reason}; {_from_it(judged)}")
    return found


def _from_it(judged: Judgement) -> str:
    """What the exact motion that begins with a solution does."""
    flow, wave = judged.flow, judged.wave
    assert flow is not None
    orbit, does = in_the_long_run(flow, wave.omega, judged.states[0], wave.subharmonic)
    away = "" if orbit is None else f" {100.0 * judged.to(orbit):.2g}% away"
    return f"the exact motion that begins with it {does}{away}"


def stability_of(judged: Judgement) -> Stability:
    """Stability of a solution by the orbit next to it."""
    orbit = judged.orbit
    if orbit is None:
        return _along_the_wave(judged, judged.reason)
    verdict, reason, largest = "undecided", judged.reason, abs(orbit.multipliers[0])
    if not reason and abs(largest - 1.0) <= KNOWN:
        reason = "its largest multiplier is 1 to rounding: a bifurcation, or no damping"
    if not reason and largest < 1.0 and not judged.of_orbit:
        assert judged.decisive is not None
        if _left(orbit, judged.decisive):
            reason = "the exact motion that begins with it leaves its orbit; take more harmonics"
    if not reason:
        verdict = "stable" if largest < 1.0 else "unstable"
    return Stability(orbit.multipliers, verdict, KNOWN, True, judged.distance, reason)


def _left(orbit: PeriodicOrbit, judged: Judgement) -> bool:
    """Whether the exact motion that begins with a wave leaves the stable orbit next to it, as that
    of pairs with mass, which bounce, may."""
    if judged.wave.structure.light_lips or judged.distance <= KNOWN:
        return False
    orbits = FlowOrbits(orbit.flow, orbit.omega, orbit.state, orbit.subharmonic)
    return leaves(orbits, orbits.unknown(judged.states[0]), orbits.start)


def _along_the_wave(judged: Judgement, reason: str) -> Stability:
    """Without an orbit: the multipliers of the flow along the wave, and why they do not judge."""
    assert judged.flow is not None
    values = np.full(judged.flow.size, np.nan + 0j)
    if judged.predicted is not None:
        values = eigenvalues(judged.predicted.monodromy)
    return Stability(values, "undecided", np.nan, reason=reason)


def _by_hill(structure: Structure, solution: PeriodicSolution, contact: ContactLaw) -> Stability:
    """By the root of Hill's determinant next to the leading multiplier of the flow along the wave;
    how far these are apart is the uncertainty."""
    gap, above = solution.slow_gap_coefficients, solution.static_above
    try:
        values = eigenvalues(monodromy(structure, contact, gap, solution.base_omega, above))
    except ConvergenceError as error:
        unknown = np.full(2 * len(all_modes(structure).squares), np.nan + 0j)
        return Stability(unknown, "undecided", np.nan, reason=str(error))
    root = abs(hill_root(structure, solution, contact, values[0]))
    off = float(abs(root - abs(values[0])))
    verdict, reason = "stable" if root < 1.0 else "unstable", ""
    if not np.isfinite(off):
        reason = "Hill's determinant has no root next to the wave's multiplier"
    elif abs(root - 1.0) <= max(KNOWN, off):
        reason = "its largest multiplier is 1 within its uncertainty"
    elif solution.report.truncation >= UNKNOWN:
        reason = "the solution's error is not known"
    elif solution.report.truncation > LARGE_ERROR:
        left_out = solution.report.truncation
        reason = f"the harmonics left out change it by {left_out:.0%}; take more"
    if reason:
        verdict = "undecided"
    return Stability(values, verdict, off, reason=reason)
