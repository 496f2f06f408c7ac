"""Stability of periodic solutions: Floquet multipliers, and a verdict.

The multipliers mu are those of the exact orbit next to a solution, which is stable where they lie
within the unit circle (:mod:`fenics_crack.motion.orbit`); :func:`shoot` finds that orbit alone.
:mod:`fenics_crack.balance.assessment` decides whether it is accepted for the solution.

Where no orbit is found, the exact motion that begins with the solution is followed: "irregular"
if a small disturbance of it grows (:func:`fenics_crack.motion.attractors.find_irregular_motion`).

Laws that are not linear in contact have no exact flow. Their multipliers are those of the linear
flow along the solution, which decide if its error is small; they are as uncertain as they differ
along the solution with twice the harmonics.

**The linear flow.** Small disturbances z = (q, q') of a solution with gap s(t) follow, in modal
coordinates,

    q'' + C q' + (W^2 + P kappa(t) P^T) q = 0,      kappa = d lambda / ds along s(t).

A step of length h is half a kick, q' -= h/2 P kappa P^T q, a drift of the structure without
contact, which is exact, and half a kick with the stiffness there. The error of the product M_N of N
steps in a period has even powers of h alone, so that that of (4 M_2N - M_N) / 3 is of fourth order.
N is doubled until this hardly changes, or is large.

Sources: Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004,
chapter 7; Strang, SIAM Journal on Numerical Analysis 5 (1968) 506; Hairer, Lubich and Wanner,
Geometric Numerical Integration, 2006, section II.4.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fenics_crack.balance.assessment import Assessment, with_twice_the_harmonics
from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.more_modes import UNKNOWN
from fenics_crack.balance.solution import PeriodicSolution, Stability
from fenics_crack.basics.errors import ConvergenceError, InputError, check_count
from fenics_crack.basics.tables import percent
from fenics_crack.model.contact import (
    ContactLaw,
    check_law,
    check_slope,
    is_unilateral,
    smooth_forces,
)
from fenics_crack.model.modal import CACHE_SIZE, AllModes, all_modes, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.motion.attractors import Attractor, find_attractor
from fenics_crack.motion.flow import exact_flow
from fenics_crack.motion.orbit import (
    MAX_MODES_FOR_MONODROMY,
    MULTIPLIER_TOLERANCE,
    PeriodicOrbit,
    eigenvalues,
    find_orbit,
    is_same_orbit,
)
from fenics_crack.motion.search import SearchOptions, find_by_homotopy
from fenics_crack.motion.shooting import FlowOrbits
from fenics_crack.numerics.fourier import sample_period
from fenics_crack.numerics.newton import motion_size


def monodromy(
    structure: Structure,
    contact: ContactLaw,
    gap: np.ndarray,
    base_omega: float,
    static_above: float | None = None,
) -> np.ndarray:
    """M over one period of a solution, from phase zero: (2 n_modes, 2 n_modes); of a small
    structure.

    ``gap`` are the coefficients of the solution, (2H+1, n_pairs) [m], of the slow gap where modes
    beyond ``static_above`` [rad/s] are quasi-static. Raises ConvergenceError where M is not found,
    InputError where the law's tangent is not the slope of its force along the solution.
    """
    modes = all_modes(structure).below(static_above)
    seen = sample_period(gap, 4 * len(gap))
    if modes.residual is not None:
        seen = seen - smooth_forces(contact, modes.residual, seen)[0] @ modes.residual
    check_slope(contact, seen)
    size = np.repeat([np.sqrt(np.abs(modes.squares).max()) or 1.0, 1.0], len(modes.squares))
    count = 1 << (4 * len(gap)).bit_length()
    coarse = found = _product(modes, contact, gap, base_omega, count)
    change = whole = np.inf
    while count < 2**13 and not change <= MULTIPLIER_TOLERANCE * whole < np.inf:
        count *= 2
        fine = _product(modes, contact, gap, base_omega, count)
        before, found, coarse = found, fine + (fine - coarse) / 3.0, fine
        parts = (size[:, None] * one / size for one in (found - before, found))
        change, whole = (float(np.linalg.norm(part)) for part in parts)
    if not np.all(np.isfinite(found)):
        raise ConvergenceError("linear flow: its steps cannot resolve the disturbances")
    return found


def _product(
    modes: AllModes, contact: ContactLaw, gap: np.ndarray, base_omega: float, count: int
) -> np.ndarray:
    """M of so many steps, a power of two: of stretches of the period at once, then of these one
    after the other."""
    h, n, values = 2.0 * np.pi / base_omega / count, len(modes.squares), sample_period(gap, count)
    if modes.residual is None:
        kicks = h * contact.tangent(values)[:, :, None]
    else:
        kicks = h * smooth_forces(contact, modes.residual, values)[1]
    stretches = 1
    while stretches**2 < count and stretches * (2 * n) ** 2 < CACHE_SIZE:
        stretches *= 2
    along = kicks.reshape(stretches, count // stretches, *kicks.shape[1:])
    moved = modes.transition(h)[0]
    state = np.tile(np.eye(2 * n), (stretches, 1, 1))
    with np.errstate(over="ignore", invalid="ignore"):  # of too few steps
        for kick in along.swapaxes(0, 1):
            state[:, n:] -= _kicked(modes, kick, state[:, :n])
            state = _drifted(modes, moved, state)
        product = state[0]
        for one in state[1:]:
            product = one @ product
        half = np.zeros_like(product)
        half[n:, :n] = 0.5 * _kicked(modes, kicks[0], np.eye(n))
        product = product + product @ half
        return product - half @ product


def _kicked(modes: AllModes, kick: np.ndarray, moved: np.ndarray) -> np.ndarray:
    """h P kappa P^T q."""
    seen = modes.pairs.T @ moved
    return np.asarray(modes.pairs @ (kick * seen if modes.residual is None else kick @ seen))


def _drifted(modes: AllModes, moved: np.ndarray, state: np.ndarray) -> np.ndarray:
    """E z of the structure without contact, E as :meth:`AllModes.transition` gives it."""
    if modes.damping.ndim == 2:
        return np.asarray(moved @ state)
    n, e = moved.shape[1], moved[:, :, None]
    q, rate = state[:, :n], state[:, n:]
    return np.concatenate([e[0] * q + e[1] * rate, e[2] * q + e[3] * rate], axis=1)


def _assessed(
    structure: Structure, solution: PeriodicSolution, contact: ContactLaw | None
) -> Assessment:
    """The assessment of a solution of a structure, by default with the solution's own law."""
    law = solution.contact if contact is None else contact
    check_law(structure, law, rigid=True)
    if solution.structure.n_dofs != structure.n_dofs:
        raise InputError("solution", f"{solution.structure.n_dofs} dofs", "of this structure")
    return replace(solution, structure=structure, contact=law).assessment


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
    check_count("settle", settle, 0)
    known, periods = _assessed(structure, solution, contact), solution.subharmonic
    assert known.wave.contact is not None
    flow = exact_flow(structure, known.wave.contact)
    found = None if settle else known.orbit
    if found is None:
        orbits = FlowOrbits(flow, solution.omega, known.states[0], periods)
        settled = orbits.start
        for _ in range(settle):
            settled = orbits.advance_period(settled, 1.0)
        start = orbits.state(settled)
        found = find_orbit(flow, solution.omega, start, subharmonic=periods)
        if found is None and flow.n_modes <= MAX_MODES_FOR_MONODROMY:
            found = find_by_homotopy(
                FlowOrbits(flow, solution.omega, start, periods), SearchOptions()
            )
    if found is not None and found.residual > tolerance:  # its last step was short, but M is large
        again = find_orbit(found.flow, found.omega, found.state, subharmonic=found.subharmonic)
        found = again or found
    if found is None or not found.residual <= tolerance:
        closest = "" if found is None else f"; closest {found.residual:.1e}"
        raise ConvergenceError(f"shooting: no periodic orbit near the solution{closest}")
    return found


def floquet(
    structure: Structure, solution: PeriodicSolution, contact: ContactLaw | None = None
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

    Returns
    -------
    Stability
        The multipliers, largest first, the verdict, and the reason where no orbit decides it: with
        the distance of the nearest orbit and its own stability, where one was found.

    Raises
    ------
    InputError
        The structure is too large, or the law is a constraint of crack faces with mass.

    Notes
    -----
    Source: Leine and Nijmeijer, Dynamics and Bifurcations of Non-Smooth Mechanical Systems, 2004,
    chapter 7.

    Examples
    --------
    >>> stability = fc.floquet(structure, solution)
    >>> verdict, reason = stability.verdict, stability.reason
    """
    known = _assessed(structure, solution, contact)
    law = known.wave.contact
    if known.flow is None:
        assert law is not None
        if is_unilateral(law) or not is_small(structure):
            exact_flow(structure, law)  # says what is missing
        return _by_waves(structure, solution, law)
    return stability_of(known)


def attractors(structure: Structure, solution: PeriodicSolution) -> tuple[Attractor, ...]:
    """Find the motions that are seen in place of an unstable solution, in the long run.

    They begin next to the orbit, away from it by 1 % of what moves in the direction v in which
    small disturbances grow, M v = mu v, and are followed by the exact flow. Where mu > 1 they part,
    along v and -v, and may go to two orbits, such as those above and below the unstable one of a
    resonance that leans over. Of an irregular solution it is the exact motion that begins with it.

    Parameters
    ----------
    structure : Structure
        The solution's.
    solution : PeriodicSolution
        Whose verdict by :func:`floquet` is "unstable" or "irregular".

    Returns
    -------
    tuple of Attractor
        One, or two where they differ.

    Raises
    ------
    InputError
        The verdict is another one, or there is no exact flow, or more than 120 modes.

    Notes
    -----
    Source: Nayfeh and Balachandran, Applied Nonlinear Dynamics, 1995, chapters 3 and 6.

    Examples
    --------
    >>> if fc.floquet(structure, solution).verdict == "unstable":
    ...     seen = [one.amplitudes().max() for one in fc.attractors(structure, solution)]
    """
    known = replace(solution, structure=structure).assessment
    if known.irregular_motion is not None:
        return (known.irregular_motion,)
    followed = known.flow is not None and known.flow.n_modes <= MAX_MODES_FOR_MONODROMY
    verdict = stability_of(known).verdict if followed else "no exact flow"
    orbit = known.orbit if followed else None
    if verdict != "unstable" or orbit is None:
        allowed = f"an unstable one by its exact orbit, of at most {MAX_MODES_FOR_MONODROMY} modes"
        raise InputError("solution", verdict, allowed)
    orbits = FlowOrbits(orbit.flow, orbit.omega, orbit.state, orbit.subharmonic)
    values, vectors = np.linalg.eig(orbits.scale[:, None] * orbit.monodromy / orbits.scale)
    leading = int(np.abs(values).argmax())
    mu, change = values[leading], vectors[:, leading].real
    states = orbit.sampled.whole_states
    moved = motion_size(orbits.scale * states) / np.sqrt(len(states))
    change *= 0.01 * moved / np.linalg.norm(change)
    found: list[Attractor] = []
    for start in (orbits.start + change, orbits.start - change)[: 2 if mu == abs(mu) else 1]:
        one = find_attractor(orbits, start)
        if not any(
            one.orbit and other.orbit and is_same_orbit(one.orbit, other.orbit) for other in found
        ):
            found.append(one)
    return tuple(found)


def from_rest(solution: PeriodicSolution) -> Attractor | None:
    """Follow the exact motion from rest, for as long as the search of an orbit follows one, to see
    whether it settles to another motion than a solution (collective).

    None where there is no exact flow, or more than 120 modes.
    """
    flow = solution.assessment.flow
    if flow is None or flow.n_modes > MAX_MODES_FOR_MONODROMY:
        return None
    orbits = FlowOrbits(flow, solution.omega, solution.assessment.states[0])
    return find_attractor(orbits, np.zeros(flow.size), SearchOptions().periods(flow))


def stability_of(known: Assessment) -> Stability:
    """Stability of a solution by its orbit."""
    orbit, motion = known.orbit, known.irregular_motion
    if orbit is None:
        assert known.flow is not None
        values = np.full(known.flow.size, np.nan + 0j)
        if motion is not None:
            values[0] = motion.growth
            return Stability(
                values,
                "irregular",
                np.nan,
                reason=f"no orbit was found, and the exact motion {motion.description}",
            )
        if known.prediction is not None and known.flow.n_modes <= MAX_MODES_FOR_MONODROMY:
            values = eigenvalues(known.prediction.monodromy)
        return Stability(values, "undecided", np.nan, reason=known.reason)
    reason, largest = known.reason, abs(orbit.multipliers[0])
    if not reason and abs(largest - 1.0) <= MULTIPLIER_TOLERANCE:
        reason = "its largest multiplier is 1 to rounding: a bifurcation, or no damping"
    verdict = "undecided" if reason else "stable" if largest < 1.0 else "unstable"
    return Stability(orbit.multipliers, verdict, MULTIPLIER_TOLERANCE, True, known.distance, reason)


def _by_waves(structure: Structure, solution: PeriodicSolution, contact: ContactLaw) -> Stability:
    """Assess by the multipliers of the flow along the solution; their difference from those with
    twice the harmonics is the uncertainty."""
    gap, above, off = solution.slow_gap_coefficients, solution.static_above, np.inf
    try:
        values = eigenvalues(monodromy(structure, contact, gap, solution.base_omega, above))
        wave = replace(solution, structure=structure, contact=contact)
        finer = with_twice_the_harmonics(wave) if gap.size else solution
        if finer is not None:
            slow = finer.slow_gap_coefficients
            along = monodromy(structure, contact, slow, solution.base_omega, above)
            off = float(abs(abs(eigenvalues(along)[0]) - abs(values[0])))
    except ConvergenceError as error:
        unknown = np.full(2 * len(all_modes(structure).squares), np.nan + 0j)
        return Stability(unknown, "undecided", np.nan, reason=str(error))
    largest, left_out, reason = abs(values[0]), solution.report.truncation, ""
    if left_out >= UNKNOWN or not np.isfinite(off):
        reason = "the error of the solution is unknown"
    elif left_out > LARGE_ERROR:
        reason = f"the truncated harmonics change it by {percent(left_out)}; use more"
    elif abs(largest - 1.0) <= max(MULTIPLIER_TOLERANCE, off):
        reason = "its largest multiplier is 1 within its uncertainty"
    verdict = "undecided" if reason else "stable" if largest < 1.0 else "unstable"
    return Stability(values, verdict, off, reason=reason)
