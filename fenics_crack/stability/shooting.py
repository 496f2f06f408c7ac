"""Exact periodic orbits by shooting: z(T) = z(0) on the exact flow.

In x = z / |z_0| and p = w / w_0, z_0 and w_0 those of a solution nearby, an orbit solves

    F(x, p) = z(T; x, p) / |z_0| - x = 0,        T = 2 pi m / w,

z the state at phase zero, m the periods of the load in the response's; dF/dx = M - I with the
monodromy matrix M, dF/dp by central differences. Newton's method is that of :mod:`bordered`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.balance.bordered import PathPoint, solve_in_plane
from fenics_crack.balance.exact_orbits import EventOrbits
from fenics_crack.balance.orbits import INSTANTS, MarchedOrbits, OrbitPoint
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import ConvergenceError, check_count
from fenics_crack.model.contact import ContactLaw, is_piecewise_linear, is_rigid
from fenics_crack.model.exact_flow import EventFlow
from fenics_crack.model.flow import ExponentialFlow
from fenics_crack.model.modal import all_modes
from fenics_crack.model.structure import Structure
from fenics_crack.table import Described, counted
from fenics_crack.time.march import initial_state

__all__ = [
    "CLOSE",
    "FARTHEST",
    "ExactOrbits",
    "PeriodicOrbit",
    "SteppedOrbits",
    "allowed_distance",
    "distance",
    "leaves",
    "moving_below",
    "orbits_near",
    "shoot",
]

MAX_STEPS, MIN_DAMPING, PATIENCE = 20, 1e-3, 6
"""Newton steps of shooting, how much they may be shortened, and how many may together fail to halve
the residual."""
MOVING, STEPS = 60, 1024
"""Modes that are marched, and steps in a period of the load."""
CLOSE, FOLLOWED, AWAY = 1e-3, 30, 3.0
"""Distance of a solution from its stable orbit to which the motion that begins with the solution
need not be followed; periods that it is followed else, and how many times farther away than the
linearised motion it has then left its orbit."""
BELIEVED = 3.0
"""Times the estimated error, beyond which an orbit is another one."""
FARTHEST = 0.1
"""Distance from which on an orbit judges no solution, whatever the estimate: it may be unknown."""


@dataclass(frozen=True, repr=False)
class PeriodicOrbit(Described):
    """A periodic orbit of the exact flow.

    Attributes
    ----------
    state : (2n,)
        At phase zero of the load: displacements of the modes, on the exact flow times its highest
        frequency [rad/s], and their velocities.
    multipliers : (2n,) complex
        Floquet multipliers, largest modulus first.
    gap : (512, n_pairs) [m]
        Over one period, equally spaced.
    residual : float
        ``|z(T) - z(0)| / |z(0)|``.
    iterations, events : int
        Newton steps; switching instants in the period.
    """

    state: np.ndarray
    multipliers: np.ndarray
    gap: np.ndarray
    residual: float
    iterations: int
    events: int

    def to_dict(self) -> dict[str, Any]:
        """Largest multiplier, extremes of the gap [m] of all pairs, and how it was found."""
        return {
            "multiplier": float(abs(self.multipliers[0])),
            "opening": float(max(0.0, -self.gap.min(initial=0.0))),
            "penetration": float(self.gap.max(initial=0.0)),
            "events": int(self.events),
            "residual": float(self.residual),
            "iterations": int(self.iterations),
        }

    def _title(self) -> str:
        return (
            f"largest multiplier {abs(self.multipliers[0]):.6g} of {len(self.multipliers)}, "
            f"{counted(self.events, 'event')}, residual {self.residual:.2g}"
        )


class ExactOrbits(EventOrbits):
    """F(x, p) of exact orbits next to a solution.

    Raises
    ------
    InputError
        As :class:`EventFlow`.
    """

    def __init__(
        self, structure: Structure, contact: ContactLaw, solution: PeriodicSolution
    ) -> None:
        flow = EventFlow(structure, solution.omega, contact)
        state = flow.state(*initial_state(structure, solution))
        super().__init__(flow, state, solution.subharmonic)

    def unknown_of(self, displacement: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """x of another motion at phase zero, (n_dofs,) each."""
        return self.unknown(self._flow.state(displacement, velocity))

    def orbit(self, found: PathPoint) -> PeriodicOrbit:
        """The orbit of a solution of the equations."""
        assert isinstance(found.at, OrbitPoint)
        size = float(np.linalg.norm(found.unknown))
        return PeriodicOrbit(
            self._size * found.unknown,
            found.at.multipliers,
            self.gap(found.unknown, found.parameter),
            float(np.linalg.norm(found.at.residual)) / size if size > 0.0 else 0.0,
            found.iterations,
            found.at.events,
        )


class SteppedOrbits(MarchedOrbits):
    """F(x, p) of orbits by exponential steps next to a solution; modes beyond the lowest
    :data:`MOVING` answer at once.

    Raises
    ------
    InputError
        As :class:`ExponentialFlow`.
    """

    def __init__(
        self, structure: Structure, contact: ContactLaw, solution: PeriodicSolution, steps: int
    ) -> None:
        # A constraint needs something that answers at once.
        heavy = not structure.light_lips and is_rigid(contact)
        above = moving_below(structure, (solution.static_above if heavy else None) or np.inf)
        flow = ExponentialFlow(structure, solution.omega, contact, steps, static_above=above)
        state = flow.state(*initial_state(structure, solution))
        super().__init__(flow, state, solution.subharmonic)

    def unknown_of(self, displacement: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """x of another motion at phase zero, (n_dofs,) each."""
        return np.asarray(self._flow.state(displacement, velocity) / self._size)

    def gap(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        """Gaps [m] over the period of the motion from a state: (512, n_pairs)."""
        gap = self.steps(unknown, parameter).gap
        return gap[np.arange(INSTANTS) * len(gap) // INSTANTS]

    def orbit(self, found: PathPoint) -> PeriodicOrbit:
        """The orbit of a solution of the equations."""
        assert isinstance(found.at, OrbitPoint)
        size = float(np.linalg.norm(found.unknown))
        return PeriodicOrbit(
            self._size * found.unknown,
            found.at.multipliers,
            self.gap(found.unknown, found.parameter),
            float(np.linalg.norm(found.at.residual)) / size if size > 0.0 else 0.0,
            found.iterations,
            found.at.events,
        )


def leaves(
    orbits: ExactOrbits, motion: np.ndarray, orbit: np.ndarray, parameter: float = 1.0
) -> bool:
    """Whether a motion, given by its x at phase zero, leaves a stable orbit given like that: it is
    much farther away within some periods than at first, and than a small disturbance would be."""
    monodromy = orbits.linearise(orbit, parameter).monodromy
    linear = off = motion - orbit
    try:
        for _ in range(FOLLOWED):
            motion, linear = orbits.moved(motion, parameter)[0], monodromy @ linear
            near = max(np.linalg.norm(off), np.linalg.norm(linear))
            if np.linalg.norm(motion - orbit) > AWAY * near:
                return True
    except ConvergenceError:  # pairs chatter without end
        return True
    return False


def distance(orbit: PeriodicOrbit, solution: PeriodicSolution) -> float:
    """Of the gaps over the period, relative to B^T u as the estimated errors are."""
    gap = solution.gap(np.arange(len(orbit.gap)) * solution.period / len(orbit.gap))
    size = float(np.linalg.norm(orbit.gap + solution.structure.clearance))
    return float(np.linalg.norm(orbit.gap - gap)) / size if size > 0.0 else 0.0


def allowed_distance(solution: PeriodicSolution, least: float) -> float:
    """How far the orbit may be that judges a solution of the same structure: three times the
    estimated error."""
    return max(least, BELIEVED * (solution.report.total - solution.report.reduction))


def moving_below(structure: Structure, static_above: float) -> float:
    """Frequency [rad/s] above which modes answer at once, so that few are marched."""
    return min(static_above, all_modes(structure).above_lowest(MOVING))


def orbits_near(
    structure: Structure,
    contact: ContactLaw,
    solution: PeriodicSolution,
    steps_per_period: int | None = None,
) -> ExactOrbits | SteppedOrbits:
    """Orbits of the exact flow, or of a march where steps are given, or lips have no mass."""
    exact = not structure.light_lips and is_piecewise_linear(contact)
    if exact and steps_per_period is None:
        return ExactOrbits(structure, contact, solution)
    return SteppedOrbits(structure, contact, solution, steps_per_period or STEPS)


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

    Newton's method at the solution's frequency, damped where the residual would grow.

    Parameters
    ----------
    structure, contact
        Default of the law: the solution's.
    solution : PeriodicSolution
        Where the orbit is sought.
    steps_per_period : int, optional
        March by exponential steps, so many in a period of the load. Default: the exact flow where
        lips have mass, else 1024.
    settle : int
        Follow the flow for so many periods of the response first: towards what attracts it.
    tolerance : float
        ``|z(T) - z(0)| / |z(0)|``.

    Raises
    ------
    InputError
        As :func:`integrate_events` or :func:`integrate_exponential`.
    ConvergenceError
        No orbit nearby was found.
    """
    law = contact if contact is not None else solution.contact
    assert law is not None
    if steps_per_period is not None:
        check_count("steps_per_period", steps_per_period, 1)
    check_count("settle", settle, 0)
    orbits = orbits_near(structure, law, solution, steps_per_period)
    sizes: list[float] = []
    found = solve_in_plane(
        orbits, orbits.followed(settle), 1.0, None, tolerance=tolerance, iterations=MAX_STEPS,
        least_damping=MIN_DAMPING, patience=PATIENCE, history=sizes,
    )  # fmt: skip
    if found is None:
        closest = f"closest {sizes[-1]:.1e} after {len(sizes) - 1} steps" if sizes else "no motion"
        raise ConvergenceError(f"shooting: no periodic orbit near the solution; {closest}")
    return orbits.orbit(found)
