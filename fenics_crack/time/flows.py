"""Direct integration in time along the flows of small structures.

Exact from one switching instant to the next (:mod:`fenics_crack.motion.flow`), or by exponential
steps (:mod:`fenics_crack.time.exponential`).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fenics_crack.model.contact import ContactLaw
from fenics_crack.model.modes import times
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import Flow, exact_flow
from fenics_crack.time.exponential import ExponentialFlow, Steps
from fenics_crack.time.march import March, Scheme, TimeHistory, Window, march


def integrate_events(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    *,
    periods: int,
    steps_per_period: int = 256,
    **options: Any,
) -> TimeHistory:
    """Integrate exactly from one switching instant to the next.

    Parameters
    ----------
    structure : Structure
        At most 600 dofs; reduce a larger one first.
    contact : UnilateralPenalty, UnilateralConstraint or CoulombFriction of one of them
        Law of all pairs; the latter where crack faces have no mass.
    steps_per_period : int
        Instants recorded in a period; they do not change the motion.
    omega, periods, **options
        As in :class:`fenics_crack.time.march.March`.

    Returns
    -------
    TimeHistory
        The last periods, sampled at equal steps.

    Raises
    ------
    InputError
        The structure is too large, its crack faces have mass under rigid contact, or an argument
        cannot be used.
    ConvergenceError
        Pairs open and close without end.

    Examples
    --------
    >>> history = fc.integrate_events(structure, 2000.0, contact, periods=2, initial=solution)
    """
    given = structure, omega, contact, periods, steps_per_period
    asked = March.of(integrate_events, options, *given)
    return march(asked, _ByEvents(asked))


def integrate_exponential(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    *,
    periods: int,
    steps_per_period: int = 512,
    **options: Any,
) -> TimeHistory:
    """Integrate by exact exponential steps, under the penalty law or without penetration.

        z_{n+1} = E z_n - Gamma (lambda_n + lambda_{n+1}),        E = exp(A h),

    z being displacements and velocities of the modes less the steady response to the load, and
    2 Gamma the response to unit contact forces held over the step h.

    Parameters
    ----------
    structure : Structure
        At most 600 dofs; reduce a larger one first. Without penetration crack faces have no mass
        (``reduce_structure(method="massless")``).
    contact : UnilateralPenalty, UnilateralConstraint or CoulombFriction of one of them
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
        its last force times its opening: much where hardly any residual flexibility is there.

    Raises
    ------
    InputError
        The structure is too large, its pairs with mass are rigid, or an argument cannot be used.
    ConvergenceError
        The load is on an undamped resonance, no contact forces of a step were found, or contact
        creates more than twice the energy put in.

    Examples
    --------
    >>> history = fc.integrate_exponential(structure, 2000.0, contact, periods=2)
    """
    given = structure, omega, contact, periods, steps_per_period
    asked = March.of(integrate_exponential, options, *given)
    return march(asked, _ByExponentials(asked))


def _load_sizes(asked: March) -> np.ndarray:
    """Factors that make displacements of coordinates under the load: massless ones are none, and
    are compared by the work of the load."""
    if not asked.structure.light_lips:
        return np.ones(len(asked.load_rows))
    return np.asarray(np.linalg.norm(asked.structure.force[:, asked.load_rows], axis=0))


def _ends(flow: Flow, motion: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, ...]:
    """Displacement and velocity, with friction also places, in a state of a flow."""
    _, rate, places = np.split(state, [flow.count, 2 * flow.count])
    known = motion.copy(), flow.modes.shapes @ rate
    return (*known, places.copy()) if flow.friction else known


class _ByEvents(Scheme):
    """The exact flow, period by period."""

    name = "events"

    def __init__(self, asked: March) -> None:
        self._asked, self._flow = asked, exact_flow(asked.structure, asked.contact)
        self._period = 2.0 * np.pi / asked.omega
        parts = np.arange(asked.steps_per_period + 1) / asked.steps_per_period
        self._instants = parts * self._period
        self._state = self._flow.state(*asked.start, asked.places)

    def fill(self, window: Window, number: int) -> None:
        asked = self._asked
        flow, period = self._flow, self._period
        motion = flow.advance(self._state, asked.omega, period, instants=self._instants)
        self._state, samples = motion.state, motion.samples
        moved = samples.displacement
        self._motion = moved[-1]
        window.gap[:], window.force[:] = samples.gaps[:-1], samples.forces[:-1]
        window.motion[:] = moved[:-1, asked.recorded_dofs]
        window.load_motion[:] = moved[:-1, asked.load_rows] * _load_sizes(asked)

    def state(self) -> tuple[np.ndarray, ...]:
        return _ends(self._flow, self._motion, self._state)


class _ByExponentials(Scheme):
    """The integration, period by period."""

    name = "exponential"
    remedy = "take more steps per period, or keep fewer modes: what they leave out softens contact"

    def __init__(self, asked: March) -> None:
        self._asked, steps = asked, asked.steps_per_period
        self._flow = ExponentialFlow(asked.structure, asked.omega, asked.contact, steps)
        self._state = self._flow.state(*asked.start, asked.places)
        # The load does the work of its mean over a step, the trapezoidal rule.
        self._means = 0.5 * (asked.load + np.roll(asked.load, -1, axis=0))
        self._put_in = self._missing = 0.0

    def fill(self, window: Window, number: int) -> None:
        flow, asked = self._flow, self._asked
        steps = flow.advance(self._state)
        window.gap[:], window.force[:] = steps.gaps[:-1], steps.forces[:-1]
        window.motion[:] = flow.coordinates(
            steps.states[:-1], steps.forces[:-1], asked.recorded_dofs
        )
        load_motion = flow.coordinates(steps.states, steps.forces, asked.load_rows)
        window.load_motion[:] = load_motion[:-1] * _load_sizes(asked)
        if number == 0:
            self._put_in = self._energy(steps, 0)
            self._missing = -self._put_in
        rate = steps.states[:, len(flow.modes.squares) :]
        lost = np.einsum("nj,nj->n", flow.modes.damped(rate), rate)
        work = float(np.sum(self._means * np.diff(load_motion, axis=0)))
        self._put_in += abs(work)
        self._missing += flow.step_size * float(np.sum(0.5 * (lost[1:] + lost[:-1])))
        self._missing += steps.lost - work
        self.book(self._energy(steps, -1) + self._missing, self._put_in)
        self._state = steps.end
        self._motion = flow.coordinates(steps.states[-1:], steps.forces[-1:])[0]

    def _energy(self, steps: Steps, place: int) -> float:
        """Kinetic, elastic, and contact energy at an instant."""
        flow = self._flow
        motion = flow.coordinates(steps.states[[place]], steps.forces[[place]])[0]
        elastic = motion @ times(flow.structure.stiffness, motion[:, None])[:, 0]
        rate = steps.states[place, len(flow.modes.squares) :]
        springs = np.sum(flow.softness * steps.forces[place] ** 2)
        return 0.5 * float(elastic + rate @ rate + springs)

    def state(self) -> tuple[np.ndarray, ...]:
        return _ends(self._flow, self._motion, self._state)
