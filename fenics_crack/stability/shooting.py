"""Exact periodic orbits by shooting: z(T) = z(0) on the exact flow."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from fenics_crack.balance.nearby import orbit_next_to
from fenics_crack.balance.orbits import FlowOrbits
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import ConvergenceError, check_count
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import exact_flow
from fenics_crack.motion.orbit import PeriodicOrbit, find_orbit
from fenics_crack.time.march import initial_state

__all__ = ["CLOSE", "PeriodicOrbit", "leaves", "orbits_near", "shoot"]

CLOSE, FOLLOWED, AWAY = 1e-3, 30, 3.0
"""Distance of a solution from its stable orbit to which the motion that begins with the solution
need not be followed; periods that it is followed else; and how many times farther away than the
linearised motion it has left its orbit, and nearer than at first come back to it."""


def leaves(
    orbits: FlowOrbits, motion: np.ndarray, orbit: np.ndarray, parameter: float = 1.0
) -> bool:
    """Whether a motion, given by its x at phase zero, leaves a stable orbit given like that: it is
    much farther away within some periods than at first, and than a small disturbance would be."""
    monodromy = orbits.linearise(orbit, parameter).monodromy
    linear = motion - orbit
    begun = float(np.linalg.norm(linear))
    try:
        for _ in range(FOLLOWED):
            motion, linear = orbits.moved(motion, parameter), monodromy @ linear
            away = float(np.linalg.norm(motion - orbit))
            if away > AWAY * max(begun, float(np.linalg.norm(linear))):
                return True
            if away < begun / AWAY:
                return False
    except ConvergenceError:  # pairs chatter without end
        return True
    return False


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
    steps_per_period: int | None = None,
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
    steps_per_period : int, optional
        Has no effect, as the flow is exact without steps; it goes with the next version.
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
    if steps_per_period is not None:
        check_count("steps_per_period", steps_per_period, 1)
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
