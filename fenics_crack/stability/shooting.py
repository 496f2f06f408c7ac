"""Exact periodic orbits by shooting: z(T) = z(0) on the exact flow."""

from __future__ import annotations

from fenics_crack.balance.nearby import orbit_next_to
from fenics_crack.balance.orbits import FlowOrbits
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import ConvergenceError, check_count
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.modal import all_modes
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import exact_flow
from fenics_crack.motion.orbit import PeriodicOrbit
from fenics_crack.time.march import initial_state

__all__ = ["PeriodicOrbit", "moving_below", "orbits_near", "shoot"]

MOVING = 60
"""Modes along whose motion a wave's multipliers are computed."""


def moving_below(structure: Structure, static_above: float) -> float:
    """Frequency [rad/s] above which modes answer at once, so that few move."""
    return min(static_above, all_modes(structure).above_lowest(MOVING))


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

    Raises
    ------
    InputError
        As :func:`integrate_events`.
    ConvergenceError
        No orbit nearby was found.
    """
    law = contact if contact is not None else solution.contact
    assert law is not None
    if steps_per_period is not None:
        check_count("steps_per_period", steps_per_period, 1)
    check_count("settle", settle, 0)
    orbits = orbits_near(structure, law, solution)
    start = orbits.state(orbits.followed(settle))
    found = orbit_next_to(orbits.flow, solution.omega, start, solution.subharmonic)
    if found is None or not found.residual <= tolerance:
        closest = "" if found is None else f"; closest {found.residual:.1e}"
        raise ConvergenceError(f"shooting: no periodic orbit near the solution{closest}")
    return found
