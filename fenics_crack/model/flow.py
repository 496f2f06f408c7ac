"""The flow in time by exact exponential steps, with contact solved in the step.

In modal coordinates, z = (q, q') less the steady response to the load, which is known in closed
form,

    z' = A z - [0, P]^T lambda(t),        P = Phi^T B,

a step of length h is exact for a force that is held over it, here the mean of those at its ends,

    z_{n+1} = E z_n - Gamma (lambda_n + lambda_{n+1}),        E = exp(A h),

2 Gamma being the response to unit forces that are held. The gap at its end is linear in the forces
there, with Q z the gap of a state and R_inf the residual flexibility
(:mod:`fenics_crack.model.contact`),

    g_{n+1} = s_free - (R_inf + Q Gamma) lambda_{n+1},

so that 0 <= lambda, (R_inf + I/k + Q Gamma) lambda - s_free >= 0, complementary: nothing
penetrates, or only as far as the law lets it. Where the set of closed pairs stays, this is one
product with a matrix that is kept. Modes that the damping leaves uncoupled move by themselves, so
that a step costs little more than 2 n_modes n_pairs products (``kernel/march.c``). The scheme is of
second order in h, and without contact exact. The work of a held force is known exactly, so that in
a step between equal sets of closed pairs no energy is created, however long it is. A step in which
a pair opens creates 1/2 lambda_n times its opening, one in which it closes loses as much: with
hardly any R_inf, which softens contact, and long steps motions can grow, and the march says so.
(With forces linear over the step energy would be created everywhere: with mass at the lips that is
the method of linear acceleration.)

Sources: Hochbruck and Ostermann, Acta Numerica 19 (2010) 209 (exponential integrators);
Monjaraz-Tec, Gross and Krack, Computers & Structures 267 (2022) 106810.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.kernel import Struct, doubles, kernel, shaped, signs
from fenics_crack.model.contact import ActiveSets, ContactLaw, check_law, is_rigid, is_unilateral
from fenics_crack.model.modal import AllModes, all_modes, is_small
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.fourier import waves

__all__ = ["ExponentialFlow", "Steps", "transition"]


class ExponentialFlow:
    """The flow of a small structure under its own load, in steps of a part of the load's period.

    States are (2 n_modes,) arrays (q, q') of modal coordinates.

    Attributes
    ----------
    structure : Structure
    omega : float [rad/s]
    steps : int
        In one period of the load.
    modes : AllModes
        Those that move; above the frequency ``static_above`` [rad/s], if it is given, modes answer
        at once.
    """

    def __init__(
        self,
        structure: Structure,
        omega: float,
        contact: ContactLaw,
        steps: int,
        *,
        static_above: float | None = None,
    ) -> None:
        check_law(structure, contact, rigid=True)
        if not is_unilateral(contact):
            raise InputError("contact", contact, "UnilateralPenalty or UnilateralConstraint")
        if not is_small(structure):
            raise InputError("structure", f"{structure.n_dofs} dofs", "reduced, on one rank")
        self.structure, self.omega, self.contact, self.steps = structure, omega, contact, steps
        modes = all_modes(structure)
        self.modes: AllModes = modes if static_above is None else modes.below(static_above)
        pairs = structure.n_pairs
        residual = self.modes.residual
        self.residual = np.zeros((pairs, pairs)) if residual is None else residual
        """R_inf [m/N]."""
        self.springs = np.broadcast_to(1.0 / np.asarray(contact.stiffness, float), pairs)
        if is_rigid(contact) and pairs and np.linalg.eigvalsh(self.residual)[0] <= 0.0:
            allowed = "one whose lips have no mass: reduce_structure(structure, method='massless')"
            raise InputError("structure", repr(structure), allowed)
        self._static = ActiveSets(self.residual + np.diag(self.springs))
        self._prepare()

    def _prepare(self) -> None:
        """Everything that depends on the length of a step."""
        modes, (count, pairs) = self.modes, self.modes.pairs.shape
        self.step_size = h = 2.0 * np.pi / self.omega / self.steps
        moved, held = transition(modes, h)
        pushed = 0.5 * held  # Gamma
        self.gap_rows = np.hstack([modes.pairs.T, np.zeros((pairs, count))])
        moved_gap = modes.pairs.T @ pushed[:count]
        self._prepare_load()
        springs = self.residual + np.diag(self.springs)
        self._known = Struct(
            "exponential", modes=count, pairs=pairs, instants=self.steps,
            coupled=modes.damping.ndim == 2, moved=moved, rows=np.ascontiguousarray(modes.pairs.T),
            pushed=np.ascontiguousarray(pushed.T), gaps=np.ascontiguousarray(moved_gap),
            linear=self.linear_gap, steady=self.steady,
            contact=ActiveSets(springs + moved_gap).handle, room=np.empty(4 * count + 2 * pairs),
        )  # fmt: skip

    def _prepare_load(self) -> None:
        """Steady response to the load without contact at all instants of its period."""
        structure, modes, omega = self.structure, self.modes, self.omega
        force = structure.force @ modes.shapes
        instants = waves(2.0 * np.pi * np.arange(self.steps) / self.steps)
        mean = _response(modes, 0.0, force[0] + 0j).real
        first = _response(modes, omega, force[1] - 1j * force[2])
        shape = np.vstack([mean, first.real, -first.imag])
        rate = np.vstack([0.0 * mean, -omega * first.imag, -omega * first.real])
        self.steady = instants @ np.hstack([shape, rate])
        """(N, 2 n_modes)"""
        gap = instants @ (shape @ modes.pairs) - structure.clearance
        if modes.static_loads is not None:
            static = structure.force @ modes.static_loads
            gap += instants @ structure.apply_bt(static)
        self.linear_gap = np.ascontiguousarray(gap)
        """(N, n_pairs) [m]"""

    def state(self, displacement: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """State of a displacement and a velocity (n_dofs,)."""
        inverse = self.modes.inverse
        return np.concatenate([inverse @ displacement, inverse @ velocity])

    def coordinates(
        self, states: np.ndarray, force: np.ndarray, dofs: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """Displacements (n, n_dofs), or of some dofs, of states (n, 2 n_modes) at instants from
        phase 0 on."""
        modes, structure = self.modes, self.structure
        found: np.ndarray = states[:, : len(modes.squares)] @ modes.shapes[dofs].T
        if modes.static_loads is not None and modes.static_pairs is not None:
            phase = 2.0 * np.pi * np.arange(len(states)) / self.steps
            loads = structure.force @ modes.static_loads[:, dofs]
            found += waves(phase) @ loads - force @ modes.static_pairs[dofs].T
        return found

    def advance(self, state: np.ndarray, periods: int = 1) -> Steps:
        """March whole periods of the load from phase 0.

        Raises ConvergenceError where the contact forces of a step are not found.
        """
        state, pairs = shaped(state, 2 * len(self.modes.squares)), self.structure.n_pairs
        count = len(state)
        total = periods * self.steps
        states, forces = np.empty((total + 1, count)), np.empty((total + 1, pairs))
        closed = np.empty((total + 1, pairs), dtype=bool)
        states[0] = state
        gap = self.gap_rows @ (state - self.steady[0]) + self.linear_gap[0]
        forces[:1], closed[:1] = self._static.solve(gap[None])
        done = kernel.march_exponential(
            self._known.at, total, doubles(states), doubles(forces), signs(closed)
        )
        if done < total:
            raise ConvergenceError(
                f"exponential: the contact forces of step {done + 1} were not found"
            )
        return Steps(self, states, forces, closed)


class Steps:
    """Marched periods of the load.

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


def transition(modes: AllModes, h: float) -> tuple[np.ndarray, np.ndarray]:
    """E, and the response to unit forces on the pairs that are held over the step (2n, n_pairs).

    Where damping leaves the modes uncoupled E is given by the diagonals of its blocks, (4, n),
    else whole, (2n, 2n).
    """
    count, pairs = modes.pairs.shape
    if modes.damping.ndim == 1:
        # Mode by mode: exp of h [A, b; 0, 0], scaled to balance q and q'.
        scale = np.maximum(np.sqrt(np.abs(modes.squares)), 1.0 / h)
        system = np.zeros((count, 3, 3))
        system[:, 0, 1] = scale
        system[:, 1, 0], system[:, 1, 1] = -modes.squares / scale, -modes.damping
        system[:, 1, 2] = 1.0
        found = scipy.linalg.expm(h * system)
        blocks = found[:, 0, 0], found[:, 0, 1] / scale, found[:, 1, 0] * scale, found[:, 1, 1]
        shape = (found[:, 0, 2] / scale)[:, None] * modes.pairs
        return np.array(blocks), np.vstack([shape, found[:, 1, 2][:, None] * modes.pairs])
    whole = np.zeros((2 * count + pairs,) * 2)
    whole[:count, count : 2 * count] = np.eye(count)
    whole[count : 2 * count, :count] = -np.diag(modes.squares)
    whole[count : 2 * count, count : 2 * count] = -modes.damping
    whole[count : 2 * count, 2 * count :] = modes.pairs
    found = scipy.linalg.expm(h * whole)[: 2 * count]
    return np.ascontiguousarray(found[:, : 2 * count]), found[:, 2 * count :]


def _response(modes: AllModes, omega: float, force: np.ndarray) -> np.ndarray:
    """Complex amplitude of the modes under a load (n_modes,); modes without load are at rest."""
    loaded = force != 0.0
    if not np.any(loaded):
        return np.zeros_like(force)
    if modes.damping.ndim == 2:
        impedance = np.diag(modes.squares - omega**2) + 1j * omega * modes.damping
        found = np.linalg.lstsq(impedance, force, rcond=None)[0]
        singular = np.abs(impedance @ found - force).max() > 1e-9 * np.abs(force).max()
    else:
        impedance = modes.squares - omega**2 + 1j * omega * modes.damping
        size = np.abs(modes.squares) + omega**2
        singular = bool(np.any(np.abs(impedance[loaded]) <= 1e-15 * size[loaded]))
        if omega == 0.0 and modes.unconstrained:
            singular |= bool(np.any(loaded & (np.abs(modes.squares) <= 1e-12 * modes.squares[-1])))
        known = loaded & (impedance != 0.0)
        found = np.divide(force, impedance, out=np.zeros_like(force), where=known)
    if singular:
        raise ConvergenceError(
            f"exponential: at {omega:g} rad/s the load is on an undamped resonance, or moves the "
            "structure as a rigid body"
        )
    return found
