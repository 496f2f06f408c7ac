"""Direct integration in time by central differences: the reference for harmonic balance.

    M u'' + C u' + K u + B lambda(g) = f(t)

The paper's scheme, with the contact force that its printed form leaves out,

    (2 M + dt C) u_{n+1} = 2 dt^2 (f - K u - B lambda)_n + 4 M u_n - 2 M u_{n-1} + dt C u_{n-1},

marched in increments d_n = u_n - u_{n-1} with r = f - K u - B lambda:

    (2 M + dt C) d_{n+1} = 2 dt^2 r_n + (2 M - dt C) d_n.

Modal damping C = M Phi diag(c) Phi^T M is inverted exactly: with s = dt c / (2 + dt c),

    d_{n+1} = d_n + dt^2 M^-1 r_n - Phi s (dt^2 Phi^T r_n + 2 q_n),     q_n = Phi^T M d_n,

where q is carried along, so that one step costs a product with K, a solution with M and two
products with Phi. Small structures are marched in the coordinates of all their modes instead, by
the kernel (:mod:`fenics_crack.time.steps`). The scheme is second order. Steps beyond
dt = 2 / omega_max, omega_max the largest natural frequency with every pair closed, are unstable and
refused. Below that the scheme conserves energy as long as no pair changes its state; a contact from
step a to step b creates

    1/2 k (g_b |g_{b+1}| - g_a |g_{a-1}|),

of either sign, which close to the limit can outgrow the damping. So this energy is summed up and
reported, and it is an error if it outweighs what the load has put in.

Without penetration (:class:`UnilateralConstraint`) the forces of instant n are those that keep the
gaps of the next from penetrating, with d* the increment without them and A^-1 as above,

    B^T (u_n + d* - dt^2 A^-1 B lambda_n) - g0 <= 0,    lambda_n >= 0,   complementary,

the forward increment Lagrange multiplier method (Carpenter, Taylor and Katona, International
Journal for Numerical Methods in Engineering 32, 1991). An impact is then without rebound: the pair
stays closed, and the kinetic energy of its closing, with the mass (B^T M^-1 B)^-1, is lost. The
penalty law, which loses nothing, tends to another motion; the difference vanishes with the mass of
the lips, when the mesh is refined.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from petsc4py import PETSc

from fenics_crack.errors import InputError, check_omega
from fenics_crack.kernel import Struct, doubles, kernel
from fenics_crack.model.contact import ContactLaw, check_law, is_rigid
from fenics_crack.model.coupled import ActiveSets, solve_complementarity
from fenics_crack.model.factor import weighted_sum
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import by_columns, largest_frequency
from fenics_crack.model.reduced import INSTEAD, check_mass
from fenics_crack.model.structure import Structure
from fenics_crack.parallel import collect_garbage
from fenics_crack.time.march import March, TimeHistory, Window, march
from fenics_crack.time.steps import (
    LoopedSteps,
    ModalSteps,
    StepScheme,
    inverse_of,
    modal_steps,
    solve_once,
)

__all__ = ["integrate_central_difference", "stable_steps_per_period"]


def stable_steps_per_period(structure: Structure, omega: float, contact: ContactLaw) -> int:
    """Smallest number of steps per load period that is stable (collective).

    dt <= 2 / omega_max with every pair closed by its spring; with a constraint, which lowers the
    largest frequency, with every pair open.

    Parameters
    ----------
    structure, omega, contact
        As of :func:`integrate_central_difference`.

    Returns
    -------
    int
        Of :func:`integrate_central_difference`.

    Raises
    ------
    InputError
        An argument cannot be used, or the lips have no mass.

    Examples
    --------
    >>> steps = fc.stable_steps_per_period(structure, 2000.0, contact)
    """
    check_mass(structure, INSTEAD)
    check_omega(omega)
    check_law(structure, contact, rigid=True)
    rigid = is_rigid(contact)
    if is_small(structure):
        modes = all_modes(structure)
        springs = np.broadcast_to(0.0 if rigid else contact.stiffness, structure.n_pairs)
        tied = np.diag(modes.squares) + (modes.pairs * springs) @ modes.pairs.T
        highest = float(np.sqrt(np.linalg.eigvalsh(tied)[-1]))
    else:
        highest = largest_frequency(structure if rigid else structure.tied(contact.stiffness))
        collect_garbage(structure.comm)
    return int(np.floor(np.pi * highest * (1.0 + 1e-6) / omega)) + 1


def integrate_central_difference(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    *,
    periods: int,
    steps_per_period: int,
    **options: Any,
) -> TimeHistory:
    """March by central differences under the structure's load (collective).

        (2 M + dt C) u_{n+1} = 2 dt^2 (f - K u - B lambda)_n + 4 M u_n - (2 M - dt C) u_{n-1}

    Parameters
    ----------
    structure, omega, contact, periods, **options
        As in :class:`fenics_crack.time.march.March`; best with :meth:`Structure.lumped` mass. With
        a constraint, pairs that penetrate in the initial state are moved apart by the least change
        in the norm of M.
    steps_per_period : int
        At least :func:`stable_steps_per_period`.

    Returns
    -------
    TimeHistory
        The last periods.

    Raises
    ------
    InputError
        An argument cannot be used, the lips have no mass, or the step is longer than the stable
        one.
    ConvergenceError
        The motion grows without bound, or contact creates more energy than the load puts in: the
        steps are too long. Or no contact forces keep the lips from penetrating.

    Notes
    -----
    A motion that does not settle is a result, not an error: look at ``settled``.

    Examples
    --------
    >>> steps = fc.stable_steps_per_period(structure, 2000.0, contact)
    >>> history = fc.integrate_central_difference(
    ...     structure, 2000.0, contact, periods=2, steps_per_period=steps)
    """
    asked = March(structure, omega, contact, periods, steps_per_period, **options)
    least = stable_steps_per_period(structure, omega, contact)
    if steps_per_period < least:
        raise InputError(
            "steps_per_period", steps_per_period, f">= {least}, the stable limit of the scheme"
        )
    scheme = _ModalDifferences if modal_steps(asked) else _CentralDifferences
    return march(asked, scheme(asked))


class _Energy(StepScheme):
    """The account of energy: what contact creates by its opening and closing between steps."""

    name = "central differences"
    remedy = "take more steps per period"

    def __init__(self, asked: March) -> None:
        super().__init__(asked)
        pairs, rows = self.structure.n_pairs, len(self.load_rows)
        self._tail: list[np.ndarray] = [
            np.empty((0, width)) for width in (rows, pairs, pairs, rows)
        ]

    def _book(self, window: Window) -> None:
        """Work over a step is force times half the displacement from the step before to the one
        after, for which the scheme balances kinetic and elastic energy exactly."""
        period = self.load, window.gap, window.force, window.load_motion
        parts = [np.vstack(part) for part in zip(self._tail, period, strict=True)]
        self._tail = [part[-2:] for part in parts]
        load, gap, force, motion = parts
        self._created -= 0.5 * float(np.sum(force[1:-1] * (gap[2:] - gap[:-2])))
        if not self.rigid:
            stored = 0.25 * (gap * force).sum(axis=1)
            self._created += stored[-2:].sum() - stored[:2].sum()
        self._put_in += abs(self._total(0.5 * np.sum(load[1:-1] * (motion[2:] - motion[:-2]))))


class _ModalDifferences(_Energy, ModalSteps):
    """In modal coordinates, by the kernel."""

    def __init__(self, asked: March) -> None:
        super().__init__(asked)
        modes, dt = self.modes, self.step_size
        rate = dt * modes.damping
        keep: np.ndarray
        if self.diagonal:
            keep, gain = (2.0 - rate) / (2.0 + rate), 2.0 * dt**2 / (2.0 + rate)
        else:
            unit = np.eye(len(rate))
            keep = np.linalg.solve(2.0 * unit + rate, 2.0 * unit - rate)
            gain = 2.0 * dt**2 * np.linalg.inv(2.0 * unit + rate)
        push = self.by_mode(gain, modes.pairs)
        increment = dt * self.velocity - 0.5 * dt**2 * self.acceleration(self.velocity)
        self.increment = increment
        self._put_in = self.linear_energy()
        sets = ActiveSets(modes.pairs.T @ push).handle if self.rigid else None
        self._known = Struct(
            "central_differences", body=self.body, keep=keep, gain=gain,
            push=np.ascontiguousarray(push.T), contact=sets, shape=self.shape,
            increment=increment, closed=np.zeros(self.structure.n_pairs, bool),
        )  # fmt: skip

    def _steps(self, first: int, gap: np.ndarray, force: np.ndarray, shape: np.ndarray) -> int:
        return int(
            kernel.march_central(
                self._known.at, first, len(gap), doubles(gap), doubles(force), doubles(shape)
            )
        )

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        backwards = velocity = self.increment / self.step_size
        for _ in range(3):  # the acceleration depends on the velocity a little
            velocity = backwards + 0.5 * self.step_size * self.acceleration(velocity)
        return self.motion(velocity)


class _CentralDifferences(_Energy, LoopedSteps):
    """State and one step of the scheme."""

    def __init__(self, asked: March) -> None:
        super().__init__(asked)
        structure, dt = self.structure, self.step_size
        self.displacement, self.increment, self.before, self.rhs, self.solved = (
            np.zeros(structure.n_local) for _ in range(5)
        )
        size = (structure.n_local, structure.n_dofs)
        self._u, self._r, self._a, self._d = (
            PETSc.Vec().createWithArray(array, size, comm=structure.comm)
            for array in (self.displacement, self.rhs, self.solved, self.increment)
        )
        self._mixed: Any = None
        matrix = structure.mass
        if self._modes is not None:
            growth = dt * self._modes.rate
            self._share = growth / (2.0 + growth)
        elif self._damping is not None:
            matrix = weighted_sum(structure.mass, 0.5 * dt, self._damping)
            self._mixed = weighted_sum(structure.mass, -0.5 * dt, self._damping)
        self._inverse = inverse_of(matrix, symmetric=self._mixed is None)
        self.owned = self._u, self._r, self._a, self._d, self._inverse
        if self.rigid:
            self._push, self._modal_push = self._response()
            self._compliance = structure.apply_bt(self._push.T).T
        self._start(*asked.start)

    def _response(self) -> tuple[np.ndarray, np.ndarray]:
        """What unit forces on the pairs take from the increment (n_local, n_pairs), and from q."""
        dt2 = self.step_size**2
        pairs = self.structure.gap.toarray()
        push = dt2 * by_columns(self._inverse.apply, self.structure.mass, pairs)
        if self._modes is None:
            return push, np.zeros((0, self.structure.n_pairs))
        pushed = dt2 * self.structure.apply_bt(self._modes.shapes.T)
        push -= self._modes.shapes @ (self._share[:, None] * pushed)
        return push, (1.0 - self._share)[:, None] * pushed

    def _start(self, displacement: np.ndarray, velocity: np.ndarray) -> None:
        """Set the state at time 0; the step before follows from u_{-1} = u - dt v + dt^2 a / 2."""
        dt = self.step_size
        self.displacement[:] = displacement = self._admissible(displacement)
        acceleration = self._acceleration(velocity)
        self.increment[:] = dt * velocity - 0.5 * dt**2 * acceleration
        self._put_in = self._linear_energy(displacement, velocity)
        if self._modes is not None:
            self._modal = self.structure.sum_over_ranks(self.increment @ self._modes.mass_shapes)

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        backwards = self.increment / self.step_size
        velocity = backwards.copy()
        for _ in range(3):  # the acceleration depends on the velocity a little
            velocity = backwards + 0.5 * self.step_size * self._acceleration(velocity)
        self.increment[:] = self.step_size * backwards
        return self.displacement.copy(), velocity

    def _acceleration(self, velocity: np.ndarray) -> np.ndarray:
        """M^-1 (f - K u - B lambda - C v) at phase zero of the load; spoils the increment.

        The forces of a constraint, which belong to the next increment, are left out.
        """
        self.gap = self._measured(self.displacement)
        self._unbalance(0)
        if self._mixed is not None:
            self._d.array_w[:] = velocity
            self._damping.mult(self._d, self._a)
            self.rhs -= self.solved
            return solve_once(self.structure.mass, self.rhs[:, None])[:, 0]
        self._inverse.apply(self._r, self._a)
        acceleration = self.solved.copy()
        if self._modes is not None:
            modal = self.structure.sum_over_ranks(velocity @ self._modes.mass_shapes)
            acceleration -= self._modes.shapes @ (self._modes.rate * modal)
        return acceleration

    def advance(self, step: int) -> None:
        dt2 = self.step_size**2
        self.gap = self._measured(self.displacement)
        self._unbalance(step)
        if self._mixed is not None:
            self._mixed.mult(self._d, self._a)
            self.rhs *= dt2
            self.rhs += self.solved
            self._inverse.apply(self._r, self._d)
        else:
            self._inverse.apply(self._r, self._a)
            self.increment += dt2 * self.solved
        if self._modes is not None:
            pushed = dt2 * self.structure.sum_over_ranks(self.rhs @ self._modes.shapes)
            lost = self._share * (pushed + 2.0 * self._modal)
            self._modal += pushed - lost
            self.increment -= self._modes.shapes @ lost
        if self.rigid:
            self._push_apart()
        self.before[:] = self.displacement
        self.displacement += self.increment

    def _push_apart(self) -> None:
        """Find the forces of a constraint and take their part from the increment."""
        reached = self.gap + self._closing(self.increment)
        self.force = solve_complementarity(self._compliance, reached, self.force > 0.0)
        self.increment -= self._push @ self.force
        if self._modes is not None:
            self._modal -= self._modal_push @ self.force

    def _unbalance(self, step: int) -> None:
        """r = f - K u - B lambda."""
        self.structure.stiffness.mult(self._u, self._r)
        np.negative(self.rhs, out=self.rhs)
        self.rhs[self.load_rows] += self.load[step]
        if not self.rigid:
            self.force = self.contact.force(self.gap)
            self.rhs[self._gap_rows] -= self._gap_block @ self.force
