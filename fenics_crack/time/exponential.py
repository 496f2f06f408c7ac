"""The flow of a small structure with contact by exponential steps.

Of the state z = (q, q') of :mod:`fenics_crack.motion.flow` less the steady response to the load,
which is known in closed form, z' = A z - [0, P]^T lambda(t). A step of length h is exact for a
force that is held over it, here the mean of those at its ends,

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
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import Flow, check_exact, doubles
from fenics_crack.numerics.fourier import derivative, from_complex, to_complex, waves_of


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
        mean = modes.steady_response(0.0, self.force[0] + 0j).real
        moving = [
            modes.steady_response(order * omega, load)
            for order, load in enumerate(to_complex(self.force)[1:], 1)
        ]
        shape = from_complex(np.array([mean, *moving]))
        rate = derivative(shape, omega)
        instants = waves_of(self.force, 2.0 * np.pi * np.arange(steps) / steps)
        self.steady = instants @ np.hstack([shape, rate])
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
            coupled=modes.damping.ndim == 2, moved=moved, rows=doubles(modes.pairs.T),
            pushed=doubles(pushed.T), gaps=doubles(moved_gap), linear=self.linear_gap,
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
        count, pairs, total = 2 * self.count, self.structure.n_pairs, periods * self.steps
        state, places = np.split(shaped(state, self.size), [count])
        states, forces = np.empty((total + 1, count)), np.empty((total + 1, len(self.softness)))
        closed = np.empty((total + 1, pairs), dtype=np.int8)
        states[0] = state
        gap = self.gap_rows @ (state - self.steady[0]) + self.linear_gap[0]
        if self.friction:
            forces[:1], closed[:1], held = self._rubbing.solve(gap[None], places)
            self._held[:] = held[0]
        else:
            forces[:1], closed[:1] = self._static.solve(gap[None])
        done = kernel.march_exponential(
            self._known.at, total, pointer(states), pointer(forces), pointer(closed)
        )
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
        return np.asarray(moved + flow.linear_gap[instants] - self.forces @ flow.residual)

    @property
    def lost(self) -> float:
        """Loss by friction over all steps [J], of the mean forces over each."""
        flow, count = self.flow, self.flow.structure.n_pairs
        if not flow.friction:
            return 0.0
        force = self.forces[:, count:]
        places = self.gaps[:, count:] - flow.softness[count:] * force
        return float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(places, axis=0)))
