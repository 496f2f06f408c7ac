"""Exact periodic orbits by shooting: z(T) = z(0) on the exact flow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import ConvergenceError
from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.structure import Structure
from fenics_crack.table import Described, counted
from fenics_crack.time.events import EventFlow
from fenics_crack.time.march import initial_state

__all__ = ["PeriodicOrbit", "describe_orbit", "shoot"]


PATIENCE = 6
"""Newton steps of shooting that may together fail to halve the residual."""


@dataclass(frozen=True, repr=False)
class PeriodicOrbit(Described):
    """A periodic orbit of the exact flow.

    Attributes
    ----------
    state : (2n,)
        At phase zero of the load.
    multipliers : (2n,) complex
        Floquet multipliers, largest modulus first.
    gap : (512, n_pairs) [m]
        Over one period, equally spaced.
    residual : float
        |z(T) - z(0)| / |z(0)|.
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


def describe_orbit(
    flow: EventFlow,
    state: np.ndarray,
    period: float,
    monodromy: np.ndarray,
    residual: float,
    iterations: int,
    events: int,
) -> PeriodicOrbit:
    """The orbit through a state at phase zero whose monodromy matrix is known."""
    _, gap, _, _ = flow.advance(state, 0.0, period, instants=np.arange(512) * period / 512)
    values = np.linalg.eigvals(monodromy)
    return PeriodicOrbit(
        state,
        values[np.argsort(-np.abs(values), kind="stable")],
        gap - flow.structure.clearance,
        residual,
        iterations,
        events,
    )


def shoot(
    structure: Structure,
    solution: PeriodicSolution,
    contact: ContactLaw | None = None,
    *,
    tolerance: float = 1e-10,
) -> PeriodicOrbit:
    """Refine a harmonic-balance solution to an exact periodic orbit: z(T) = z(0).

    Newton's method, dz = (I - M)^-1 (z(T) - z(0)), damped where the residual would grow.

    Raises
    ------
    InputError
        As :func:`integrate_events`.
    ConvergenceError
        No orbit nearby was found.
    """
    law = contact if contact is not None else solution.contact
    flow = EventFlow(structure, solution.omega, law)  # type: ignore[arg-type]
    state = flow.state(*initial_state(structure, solution))
    period, size = solution.period, 2 * structure.n_dofs
    moved, _, monodromy, events = flow.advance(state, 0.0, period, monodromy=np.eye(size))
    before = float(np.linalg.norm(moved - state) / np.linalg.norm(state))
    history = [before]
    for iteration in range(50):
        assert monodromy is not None
        if before <= tolerance:
            return describe_orbit(flow, state, period, monodromy, before, iteration, events)
        try:
            change = np.linalg.solve(np.eye(size) - monodromy, moved - state)
        except np.linalg.LinAlgError:
            break
        damping = 1.0
        while True:
            trial = state + damping * change
            moved, _, monodromy, events = flow.advance(trial, 0.0, period, monodromy=np.eye(size))
            now = float(np.linalg.norm(moved - trial) / np.linalg.norm(trial))
            if now < before or damping < 1e-3:
                break
            damping *= 0.5
        history.append(now)
        stalls = len(history) > PATIENCE and now > 0.5 * history[-1 - PATIENCE]
        if not now < before or stalls:
            break
        state, before = trial, now
    raise ConvergenceError(
        f"shooting: no periodic orbit near the solution; closest {before:.1e} "
        f"after {iteration} steps"
    )
