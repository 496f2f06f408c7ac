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

import numpy as np

from fenics_crack.basics.errors import ConvergenceError
from fenics_crack.kernel import Struct, kernel, pointer, shaped
from fenics_crack.model.contact import ActiveSets, ContactLaw
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
    gap_rows : (n_pairs, 2 n_modes)
        Q.
    steady : (N, 2 n_modes)
        Steady response to the load without contact at all instants of its period.
    linear_gap : (N, n_pairs) [m]
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
        self._static = ActiveSets(self.compliance)
        self._known = Struct(
            "exponential", modes=count, pairs=pairs, instants=steps,
            coupled=modes.damping.ndim == 2, moved=moved, rows=doubles(modes.pairs.T),
            pushed=doubles(pushed.T), gaps=doubles(moved_gap), linear=self.linear_gap,
            steady=self.steady, contact=ActiveSets(self.compliance + moved_gap).handle,
            room=np.empty(4 * count + 2 * pairs),
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
        state, pairs = shaped(state, self.size), self.structure.n_pairs
        count = len(state)
        total = periods * self.steps
        states, forces = np.empty((total + 1, count)), np.empty((total + 1, pairs))
        closed = np.empty((total + 1, pairs), dtype=bool)
        states[0] = state
        gap = self.gap_rows @ (state - self.steady[0]) + self.linear_gap[0]
        forces[:1], closed[:1] = self._static.solve(gap[None])
        done = kernel.march_exponential(
            self._known.at, total, pointer(states), pointer(forces), pointer(closed)
        )
        if done < total:
            raise ConvergenceError(
                f"exponential: the contact forces of step {done + 1} were not found"
            )
        return Steps(self, states, forces, closed)


class Steps:
    """Integrated periods of the load.

    Attributes
    ----------
    states : (N + 1, 2 n_modes)
        At all instants, both ends included.
    forces : (N + 1, n_pairs) [N]
    closed : (N + 1, n_pairs) bool
    """

    def __init__(
        self, flow: ExponentialFlow, states: np.ndarray, forces: np.ndarray, closed: np.ndarray
    ) -> None:
        self._flow, self.states, self.forces, self.closed = flow, states, forces, closed

    @property
    def gap(self) -> np.ndarray:
        """Gap at all instants but the last: (N, n_pairs) [m]."""
        flow, count = self._flow, len(self.states) - 1
        instants = np.arange(count) % flow.steps
        moved = (self.states[:-1] - flow.steady[instants]) @ flow.gap_rows.T
        return moved + flow.linear_gap[instants] - self.forces[:-1] @ flow.residual
