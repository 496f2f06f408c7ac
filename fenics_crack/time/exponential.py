"""Direct integration in time by exact exponential steps (:mod:`fenics_crack.model.flow`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.flow import ExponentialFlow, Steps
from fenics_crack.model.structure import Structure
from fenics_crack.time.march import March, Scheme, TimeHistory, Window, march

__all__ = ["integrate_exponential"]


def integrate_exponential(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    *,
    periods: int,
    steps_per_period: int = 512,
    **options: Any,
) -> TimeHistory:
    """March by exact exponential steps, under the penalty law or without penetration.

        z_{n+1} = E z_n - Gamma (lambda_n + lambda_{n+1}),        E = exp(A h),

    z being displacements and velocities of the modes less the steady response to the load, and
    2 Gamma the response to unit contact forces held over the step h.

    Parameters
    ----------
    structure : Structure
        At most 600 dofs; reduce a larger one first. Without penetration lips have no mass
        (``reduce_structure(method="massless")``).
    contact : UnilateralPenalty or UnilateralConstraint
        Law of all pairs.
    steps_per_period : int
        Of the load; the error falls with its square.
    omega, periods, **options
        As in :class:`fenics_crack.time.march.March`.

    Returns
    -------
    TimeHistory
        ``created_energy`` is what is missing in the balance of energy, by the trapezoidal rule. A
        step between equal sets of closed pairs creates none; one in which a pair opens creates half
        its last force times its opening, which is much where hardly anything answers at once.

    Raises
    ------
    InputError
        The structure is too large or has mass at its lips, or an argument cannot be used.
    ConvergenceError
        The load is on an undamped resonance, no contact forces of a step were found, or contact
        creates more than twice the energy put in.

    Examples
    --------
    >>> history = fc.integrate_exponential(structure, 2000.0, contact, periods=2)
    """
    asked = March(structure, omega, contact, periods, steps_per_period, **options)
    return march(asked, _ByExponentials(asked))


class _ByExponentials(Scheme):
    """The march, period by period."""

    name = "exponential"
    remedy = "take more steps per period, or keep fewer modes: what they leave out softens contact"

    def __init__(self, asked: March) -> None:
        self._flow = flow = ExponentialFlow(
            asked.structure, asked.omega, asked.contact, asked.steps_per_period
        )
        self._columns, self._load_rows = asked.recorded_dofs, asked.load_rows
        # Coordinates without mass are no displacements: compared by the work of the load.
        self._load_sizes = np.linalg.norm(asked.structure.force[:, asked.load_rows], axis=0)
        self._state = flow.state(*asked.start)
        self._work = self._lost = 0.0
        self._first: float | None = None
        self._put_in = 0.0

    def fill(self, window: Window, number: int) -> None:
        flow = self._flow
        steps = flow.advance(self._state)
        window.gap[:], window.force[:] = steps.gap, steps.forces[:-1]
        window.motion[:] = flow.coordinates(steps.states[:-1], steps.forces[:-1], self._columns)
        load_motion = flow.coordinates(steps.states, steps.forces, self._load_rows)
        window.load_motion[:] = load_motion[:-1] * self._load_sizes
        self._state = steps.states[-1]
        self._motion = flow.coordinates(steps.states[-1:], steps.forces[-1:])[0]
        self._book(steps, load_motion)

    def _book(self, steps: Steps, load_motion: np.ndarray) -> None:
        """Energy at both ends, put in by the load, and lost in the modes' damping."""
        flow, force = self._flow, self._flow.structure.force[:, self._load_rows]
        count = len(flow.modes.squares)
        rate = steps.states[:, count:]
        lost = np.einsum("nj,nj->n", flow.modes.damped(rate), rate)
        self._lost += flow.step_size * float(np.sum(0.5 * (lost[1:] + lost[:-1])))
        phase = 2.0 * np.pi * np.arange(len(load_motion)) / flow.steps
        waves = np.column_stack([np.ones_like(phase), np.cos(phase), np.sin(phase)])
        conjugate = load_motion @ force.T
        gained = float(np.sum(0.5 * (waves[1:] + waves[:-1]) * np.diff(conjugate, axis=0)))
        self._work += gained
        if self._first is None:
            first = flow.coordinates(steps.states[:1], steps.forces[:1])[0]
            self._first = self._energy(steps, first, 0)
            self._put_in = abs(self._first)
        self._put_in += abs(gained)
        now = self._energy(steps, self._motion, -1)
        self.balance(now + self._lost - self._first - self._work, self._put_in)

    def _energy(self, steps: Steps, motion: np.ndarray, place: int) -> float:
        """Kinetic, elastic, and contact energy at an instant with displacement (n_dofs,)."""
        flow = self._flow
        structure, count = flow.structure, len(flow.modes.squares)
        stretched = structure.stiffness.createVecLeft()
        shape = structure.stiffness.createVecRight()
        shape.array_w[:] = motion
        structure.stiffness.mult(shape, stretched)
        energy = 0.5 * float(shape.array_r @ stretched.array_r)
        shape.destroy()
        stretched.destroy()
        rate = steps.states[place, count:]
        springs = 0.5 * float(np.sum(flow.springs * steps.forces[place] ** 2))
        return energy + 0.5 * float(rate @ rate) + springs

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        flow, count = self._flow, len(self._flow.modes.squares)
        return self._motion.copy(), flow.modes.shapes @ self._state[count:]
