"""Direct integration in time along the flows of small structures.

Exact from one switching instant to the next (:mod:`fenics_crack.motion.flow`), or by exponential
steps. Of the state z = (q, q') of that flow less the steady response to the load, which is known in
closed form, z' = A z - [0, P]^T lambda(t). A step of length h is exact for a force that is held
over it, here the mean of those at its ends,

    z_{n+1} = E z_n - Gamma (lambda_n + lambda_{n+1}),        E = exp(A h),

2 Gamma being the response to unit forces that are held. The gap at its end is linear in the forces
there, with Q z the gap of a state,

    g_{n+1} = s_free - (R_inf + Q Gamma) lambda_{n+1},

so that 0 <= lambda, (R_inf + I/kappa + Q Gamma) lambda - s_free >= 0, complementary. Where the set
of closed pairs stays, this is one product with a matrix that is kept; modes that the damping leaves
uncoupled move by themselves, so that a step costs little more than 2 n_modes n_pairs products
(``kernel/march.c``). The scheme is of second order in h, and without contact exact. The work of a
held force is known exactly, so that in a step between equal sets of closed pairs no energy is
created, however long it is. A step in which a pair opens creates 1/2 lambda_n times its opening,
one in which it closes loses as much: with hardly any R_inf, which softens contact, and long steps
motions can grow, and the integration reports it. (With forces linear over the step energy would be
created everywhere: with mass at the crack faces that is the method of linear acceleration.)

Source: Hochbruck and Ostermann, Acta Numerica 19 (2010) 209 (exponential integrators).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import Struct, kernel, pointer, shaped
from fenics_crack.model.contact import ActiveSets, ContactLaw, FrictionSets, coefficient_of
from fenics_crack.model.modes import times
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import Flow, as_doubles, check_exact, exact_flow
from fenics_crack.numerics.fourier import differentiate, fourier_basis_for, from_complex, to_complex
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


# --- the schemes ----------------------------------------------------------------------------------


def _load_sizes(asked: March) -> np.ndarray:
    """Factors that make displacements of coordinates under the load: massless ones are none, and
    are compared by the work of the load."""
    if not asked.structure.light_lips:
        return np.ones(len(asked.load_rows))
    return np.asarray(np.linalg.norm(asked.structure.force[:, asked.load_rows], axis=0))


def _ends(flow: Flow, motion: np.ndarray, state: np.ndarray) -> tuple[np.ndarray, ...]:
    """Displacement and velocity, with friction also places, in a state of a flow."""
    _, rate, places = np.split(state, [flow.n_modes, 2 * flow.n_modes])
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
        self._state = self._flow.state(*asked.start)

    def fill(self, window: Window, number: int) -> None:
        asked = self._asked
        motion = self._flow.advance(self._state, asked.omega, self._period, instants=self._instants)
        self._state, samples = motion.state, motion.samples
        moved = samples.displacement
        self._motion = moved[-1]
        window.gap[:], window.force[:] = samples.gaps[:-1], samples.forces[:-1]
        window.motion[:] = moved[:-1, asked.recorded_dofs]
        window.load_motion[:] = moved[:-1, asked.load_rows] * _load_sizes(asked)

    def state(self) -> tuple[np.ndarray, ...]:
        return _ends(self._flow, self._motion, self._state)


class ExponentialFlow(Flow):
    """The flow at one frequency of the load, in steps of a part of its period.

    Attributes
    ----------
    omega : float [rad/s]
    steps : int
        In one period of the load.
    step_size : float [s]
        h.
    gap_rows : (n_rows, 2 n_modes)
        Q.
    steady : (N, 2 n_modes)
        Steady response to the load without contact at all instants of its period.
    linear_gap : (N, n_rows) [m]
        Its gap.
    """

    def __init__(self, structure: Structure, omega: float, contact: ContactLaw, steps: int) -> None:
        check_exact(structure, contact)
        super().__init__(structure, contact)
        self.omega, self.steps, self.step_size = omega, steps, 2.0 * np.pi / omega / steps
        modes, (count, pairs) = self.modes, self.modes.pairs.shape
        moved, held = modes.transition(self.step_size)
        pushed = 0.5 * held  # Gamma
        moved_gap = modes.pairs.T @ pushed[:count]
        self.gap_rows = np.hstack([modes.pairs.T, np.zeros((pairs, count))])
        loads = enumerate(to_complex(self.force))
        answers = [modes.steady_response(order * omega, load) for order, load in loads]
        shape = from_complex(np.array(answers))
        instants = fourier_basis_for(self.force, 2.0 * np.pi * np.arange(steps) / steps)
        self.steady = instants @ np.hstack([shape, differentiate(shape, omega)])
        self.linear_gap = instants @ (shape @ modes.pairs + self.gap)
        seen = self.compliance + moved_gap
        own: dict[str, Any]
        if (mu := coefficient_of(contact)) is None:
            self._static = ActiveSets(self.compliance)
            own = {"contact": ActiveSets(seen).handle}
        else:
            self._rubbing = FrictionSets(self.compliance, mu)
            self._held = np.empty(pairs // 2)
            self._sets = FrictionSets(seen, mu)
            own = {"friction": self._sets.handle, "held": self._held}
        self._known = Struct(
            "exponential", modes=count, pairs=pairs, instants=steps,
            coupled=modes.damping.ndim == 2, moved=moved, rows=as_doubles(modes.pairs.T),
            pushed=as_doubles(pushed.T), gaps=as_doubles(moved_gap), linear=self.linear_gap,
            steady=self.steady, room=np.empty(4 * count + 2 * pairs), **own,
        )  # fmt: skip

    def coordinates(
        self, states: np.ndarray, force: np.ndarray, dofs: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """:meth:`displacement` of states at instants from phase 0 on."""
        phase = 2.0 * np.pi * np.arange(len(states)) / self.steps
        return self.displacement(states, force, phase, dofs)

    def advance(self, state: np.ndarray, periods: int = 1) -> Steps:
        """Integrate whole periods of the load from phase 0.

        Raises ConvergenceError where the contact forces of a step are not found.
        """
        count, pairs, total = 2 * self.n_modes, self.structure.n_pairs, periods * self.steps
        state, places = np.split(shaped(state, self.size), [count])
        states, forces = np.empty((total + 1, count)), np.empty((total + 1, len(self.softness)))
        closed = np.empty((total + 1, pairs), dtype=np.int8)
        states[0] = state
        gap = self.gap_rows @ (state - self.steady[0]) + self.linear_gap[0]
        if self.friction:
            forces[:1], closed[:1], held, _ = self._rubbing.solve(gap[None], places)
            self._held[:] = held[0]
        else:
            forces[:1], closed[:1] = self._static.solve(gap[None])
        arrays = map(pointer, (states, forces, closed))
        done = kernel.march_exponential(self._known.at, total, *arrays)
        if done < total:
            raise ConvergenceError(
                f"exponential: the contact forces of step {done + 1} were not found"
            )
        places = self._held.copy() if self.friction else places
        return Steps(self, states, forces, closed > 0, np.append(states[-1], places))


@dataclass(frozen=True)
class Steps:
    """Integrated periods of the load.

    Attributes
    ----------
    states : (N + 1, 2 n_modes)
        At all instants, both ends included.
    forces : (N + 1, n_rows) [N]
    closed : (N + 1, n_pairs) bool
    end : (size,)
        State of the flow at the end.
    """

    flow: ExponentialFlow
    states: np.ndarray
    forces: np.ndarray
    closed: np.ndarray
    end: np.ndarray

    @property
    def gaps(self) -> np.ndarray:
        """Gaps of all rows at all instants: (N + 1, n_rows) [m]."""
        flow = self.flow
        instants = np.arange(len(self.states)) % flow.steps
        moved = (self.states - flow.steady[instants]) @ flow.gap_rows.T
        return np.asarray(
            moved + flow.linear_gap[instants] - self.forces @ flow.residual_flexibility
        )

    @property
    def lost(self) -> float:
        """Loss by friction over all steps [J], of the mean forces over each."""
        flow, count = self.flow, self.flow.structure.n_pairs
        if not flow.friction:
            return 0.0
        force = self.forces[:, count:]
        places = self.gaps[:, count:] - flow.softness[count:] * force
        return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(places, axis=0)))


class _ByExponentials(Scheme):
    """The integration, period by period."""

    name = "exponential"
    remedy = "take more steps per period, or keep fewer modes: what they leave out softens contact"

    def __init__(self, asked: March) -> None:
        self._asked, steps = asked, asked.steps_per_period
        self._flow = ExponentialFlow(asked.structure, asked.omega, asked.contact, steps)
        self._state = self._flow.state(*asked.start)
        # The load does the work of its mean over a step, the trapezoidal rule.
        self._means = 0.5 * (asked.load + np.roll(asked.load, -1, axis=0))
        self._put_in = self._missing = 0.0

    def fill(self, window: Window, number: int) -> None:
        flow, asked = self._flow, self._asked
        steps = flow.advance(self._state)
        states, forces = steps.states, steps.forces
        window.gap[:], window.force[:] = steps.gaps[:-1], forces[:-1]
        window.motion[:] = flow.coordinates(states[:-1], forces[:-1], asked.recorded_dofs)
        load_motion = flow.coordinates(states, forces, asked.load_rows)
        window.load_motion[:] = load_motion[:-1] * _load_sizes(asked)
        if number == 0:
            self._put_in = self._energy(steps, 0)
            self._missing = -self._put_in
        rate = states[:, len(flow.modes.squares) :]
        lost = np.einsum("nj,nj->n", flow.modes.damped(rate), rate)
        work = float(np.sum(self._means * np.diff(load_motion, axis=0)))
        self._put_in += abs(work)
        self._missing += flow.step_size * float(np.sum(0.5 * (lost[1:] + lost[:-1])))
        self._missing += steps.lost - work
        self.book(self._energy(steps, -1) + self._missing, self._put_in)
        self._state = steps.end
        self._motion = flow.coordinates(states[-1:], forces[-1:])[0]

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
