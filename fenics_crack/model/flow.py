"""The flow in time by exact exponential steps, with contact solved in the step.

In modal coordinates, z = (q, q') less the steady response to the load, which is known in closed
form,

    z' = A z - [0, P]^T lambda(t),        P = Phi^T B,

a step of length h is exact for a force that is held over it, here the mean of those at its ends,

    z_{n+1} = E z_n - Gamma (lambda_n + lambda_{n+1}),        E = exp(A h),

2 Gamma being the response to unit forces that are held. The gap at its end is linear in the forces
there, with Q z the gap of a state and R_inf what answers at once
(:mod:`fenics_crack.model.coupled`),

    g_{n+1} = s_free - (R_inf + Q Gamma) lambda_{n+1},

so that 0 <= lambda, (R_inf + I/k + Q Gamma) lambda - s_free >= 0, complementary: nothing
penetrates, or only as far as the law lets it. Where the set of closed pairs stays, this is one
product with a matrix that is kept. The scheme is of second order in h, and without contact exact.
The work of a held force is known exactly, so that in a step between equal sets of closed pairs no
energy is created: it is stable for any step. (With forces linear over the step it would not be:
with mass at the lips that is the method of linear acceleration.)

With the sets A of a step's ends, forces follow lambda_A = (D_AA)^-1 s_A, and the step's tangent is

    dz_{n+1} = (I - Gamma S'_A+ Q) (E - Gamma S_A Q) dz_n;

the product over a period is the monodromy matrix.

Sources: Hochbruck and Ostermann, Acta Numerica 19 (2010) 209 (exponential integrators);
Monjaraz-Tec, Gross and Krack, Computers & Structures 267 (2022) 106810.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from fenics_crack.errors import ConvergenceError, InputError
from fenics_crack.model.complementarity import solve_complementarity
from fenics_crack.model.contact import ContactLaw, check_law, is_piecewise_linear, is_rigid
from fenics_crack.model.modal import AllModes, all_modes, is_small
from fenics_crack.model.structure import Structure

__all__ = ["ExponentialFlow", "Steps"]

MAX_KEPT = 2**28
"""Bytes of matrices of sets of closed pairs that are kept."""


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
        if not (is_piecewise_linear(contact) or is_rigid(contact)):
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
        self._static = _Sets(self.residual + np.diag(self.springs))
        self._prepare()

    def at(self, omega: float) -> ExponentialFlow:
        """The same with another load frequency."""
        other = object.__new__(ExponentialFlow)
        vars(other).update(vars(self))
        other.omega = omega
        other._prepare()
        return other

    def _prepare(self) -> None:
        """Everything that depends on the length of a step."""
        modes, count = self.modes, len(self.modes.squares)
        self.step_size = h = 2.0 * np.pi / self.omega / self.steps
        self._moved, held = _transition(modes, h)
        self._pushed = 0.5 * held  # Gamma
        self.gap_rows = np.hstack([modes.pairs.T, np.zeros((self.structure.n_pairs, count))])
        moved_gap = modes.pairs.T @ self._pushed[:count]
        self._contact = _Sets(self.residual + np.diag(self.springs) + moved_gap)
        # [E, -Gamma; Q E, -Q Gamma]: the state and the gap that a step reaches without forces at
        # its end.
        free = np.hstack([self._moved, -self._pushed])
        self._free = np.vstack([free, self.gap_rows @ free])
        self._prepare_load()
        self._tangents: dict[tuple[bytes, bytes], np.ndarray] = {}

    def _prepare_load(self) -> None:
        """Steady response to the load without contact at all instants of its period."""
        structure, modes, omega = self.structure, self.modes, self.omega
        force = structure.force @ modes.shapes
        phase = 2.0 * np.pi * np.arange(self.steps) / self.steps
        waves = np.column_stack([np.ones_like(phase), np.cos(phase), np.sin(phase)])
        mean = _response(modes, 0.0, force[0] + 0j).real
        first = _response(modes, omega, force[1] - 1j * force[2])
        shape = np.vstack([mean, first.real, -first.imag])
        rate = np.vstack([0.0 * mean, -omega * first.imag, -omega * first.real])
        self.steady = waves @ np.hstack([shape, rate])
        """(N, 2 n_modes)"""
        gap = self.steady @ self.gap_rows.T - structure.clearance
        if modes.static_loads is not None:
            static = structure.force @ modes.static_loads
            gap += waves @ structure.apply_bt(static)
        self.linear_gap = gap
        """(N, n_pairs) [m]"""

    def state(self, displacement: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """State of a displacement and a velocity (n_dofs,)."""
        inverse = self.modes.inverse
        return np.concatenate([inverse @ displacement, inverse @ velocity])

    def coordinates(self, states: np.ndarray, force: np.ndarray) -> np.ndarray:
        """Displacements (n, n_dofs) of states (n, 2 n_modes) at instants from phase 0 on."""
        modes, structure = self.modes, self.structure
        found = states[:, : len(modes.squares)] @ modes.shapes.T
        if modes.static_loads is not None and modes.static_pairs is not None:
            phase = 2.0 * np.pi * np.arange(len(states)) / self.steps
            waves = np.column_stack([np.ones_like(phase), np.cos(phase), np.sin(phase)])
            found += waves @ (structure.force @ modes.static_loads) - force @ modes.static_pairs.T
        return found

    def advance(self, state: np.ndarray, periods: int = 1) -> Steps:
        """March whole periods of the load from phase 0."""
        count, pairs = len(state), self.structure.n_pairs
        total = periods * self.steps
        states, forces = np.empty((total + 1, count)), np.zeros((total + 1, pairs))
        closed = np.zeros((total + 1, pairs), dtype=bool)
        steady, linear, free = self.steady, self.linear_gap, self._free
        states[0] = state
        forces[0] = self._static.solve(self.gap_rows @ (state - steady[0]) + linear[0])
        closed[0] = forces[0] > 0.0
        now = np.concatenate([state - steady[0], forces[0]])
        contact, pushed = self._contact, self._pushed
        active = closed[0]
        known = contact.of(active)
        for step in range(1, total + 1):
            reached = free @ now
            gap = reached[count:] + linear[step % self.steps]
            answer = known.matrix @ gap
            if answer.size and answer.min() < 0.0:
                force = solve_complementarity(contact.compliance, gap, active)
                active = force > 0.0
                known = contact.of(active)
            else:
                force = answer * active
            now = np.concatenate([reached[:count] - pushed @ force, force])
            states[step], forces[step], closed[step] = now[:count], force, active
        instants = np.arange(total + 1) % self.steps
        states[1:] += steady[instants[1:]]
        return Steps(self, states, forces, closed)

    def tangent(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """dz_{n+1} / dz_n between instants with these sets of closed pairs."""
        key = before.tobytes(), after.tobytes()
        if key not in self._tangents:
            if (len(self._tangents) + 1) * self._moved.nbytes > MAX_KEPT:
                self._tangents.clear()
            rows, count = self.gap_rows, len(self._moved)
            found = self._moved - self._pushed @ (self._static.of(before).stiffness @ rows)
            force = self._contact.of(after).stiffness @ (rows @ found)
            self._tangents[key] = found - self._pushed @ force
            assert found.shape == (count, count)
        return self._tangents[key]


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
        """At all instants but the last: (N, n_pairs) [m]."""
        flow, count = self._flow, len(self.states) - 1
        instants = np.arange(count) % flow.steps
        moved = (self.states[:-1] - flow.steady[instants]) @ flow.gap_rows.T
        return moved + flow.linear_gap[instants] - self.forces[:-1] @ flow.residual

    @property
    def switches(self) -> int:
        """How often a pair opens or closes."""
        return int(np.sum(self.closed[1:] != self.closed[:-1]))

    def monodromy(self) -> np.ndarray:
        """M, the product of the steps' tangents; equal ones by powers."""
        flow, closed = self._flow, self.closed
        changes = np.flatnonzero(np.any(closed[1:] != closed[:-1], axis=1))
        product: np.ndarray = np.eye(self.states.shape[1])
        begin = 0
        powers: dict[tuple[bytes, int], np.ndarray] = {}
        for change in [*map(int, changes), len(closed) - 1]:
            if change > begin:
                key = closed[begin].tobytes(), change - begin
                if key not in powers:
                    still = flow.tangent(closed[begin], closed[begin])
                    powers[key] = np.linalg.matrix_power(still, change - begin)
                product = powers[key] @ product
            if change < len(closed) - 1:
                product = flow.tangent(closed[change], closed[change + 1]) @ product
            begin = change + 1
        return product


class _Known:
    """What belongs to a set A of closed pairs."""

    def __init__(self, compliance: np.ndarray, closed: np.ndarray) -> None:
        self.stiffness = np.zeros_like(compliance)
        """(D_AA)^-1, zero outside A."""
        block = np.ix_(closed, closed)
        self.stiffness[block] = np.linalg.inv(compliance[block])
        opening = compliance @ self.stiffness - np.eye(len(closed))
        self.matrix = np.where(closed[:, None], self.stiffness, opening)
        """Forces of closed pairs and openings of the others from the gaps: all >= 0 if A is
        right."""


class _Sets:
    """Matrices of sets of closed pairs under a compliance D, kept."""

    def __init__(self, compliance: np.ndarray) -> None:
        self.compliance = compliance
        self._kept: dict[bytes, _Known] = {}

    def of(self, closed: np.ndarray) -> _Known:
        """What belongs to a set."""
        key = closed.tobytes()
        if key not in self._kept:
            if 2 * (len(self._kept) + 1) * self.compliance.nbytes > MAX_KEPT:
                self._kept.clear()
            self._kept[key] = _Known(self.compliance, closed)
        return self._kept[key]

    def solve(self, gap: np.ndarray) -> np.ndarray:
        """Forces of gaps (n_pairs,); none where D is singular: with mass at the lips they are
        those of the next step."""
        if not len(gap) or not np.any(self.compliance):
            return np.zeros_like(gap)
        return solve_complementarity(self.compliance, gap)


def _transition(modes: AllModes, h: float) -> tuple[np.ndarray, np.ndarray]:
    """E (2n, 2n), and the response to unit forces on the pairs that are held over the step:
    (2n, n_pairs)."""
    count, pairs = modes.pairs.shape
    if modes.damping.ndim == 1:
        # Mode by mode: exp of h [A, b; 0, 0], scaled to balance q and q'.
        scale = np.maximum(np.sqrt(np.abs(modes.squares)), 1.0 / h)
        system = np.zeros((count, 3, 3))
        system[:, 0, 1] = scale
        system[:, 1, 0], system[:, 1, 1] = -modes.squares / scale, -modes.damping
        system[:, 1, 2] = 1.0
        found = scipy.linalg.expm(h * system)
        moved = np.zeros((2 * count, 2 * count))
        place = np.arange(count)
        moved[place, place], moved[count + place, count + place] = found[:, 0, 0], found[:, 1, 1]
        moved[place, count + place] = found[:, 0, 1] / scale
        moved[count + place, place] = found[:, 1, 0] * scale
        shape = (found[:, 0, 2] / scale)[:, None] * modes.pairs
        return moved, np.vstack([shape, found[:, 1, 2][:, None] * modes.pairs])
    whole = np.zeros((2 * count + pairs,) * 2)
    whole[:count, count : 2 * count] = np.eye(count)
    whole[count : 2 * count, :count] = -np.diag(modes.squares)
    whole[count : 2 * count, count : 2 * count] = -modes.damping
    whole[count : 2 * count, 2 * count :] = modes.pairs
    found = scipy.linalg.expm(h * whole)[: 2 * count]
    return found[:, : 2 * count], found[:, 2 * count :]


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
        found = np.divide(force, impedance, out=np.zeros_like(force), where=loaded)
    if singular:
        raise ConvergenceError(
            f"exponential: at {omega:g} rad/s the load is on an undamped resonance, or moves the "
            "structure as a rigid body"
        )
    return found
