"""Direct integration in time by central differences: the reference for harmonic balance.

    M u'' + C u' + K u + B lambda(g) = f(t)

The paper's scheme, with the contact force that its printed form leaves out,

    (2 M + dt C) u_{n+1} = 2 dt^2 (f - K u - B lambda)_n + 4 M u_n - 2 M u_{n-1} + dt C u_{n-1},

integrated in increments d_n = u_n - u_{n-1} with r = f - K u - B lambda:

    (M + dt/2 C) (d_{n+1} - d_n) = dt^2 r_n - dt C d_n.

Modal damping C = M Phi diag(c) Phi^T M is inverted exactly (:class:`LoopedSteps`): a step costs a
product with K and one with M, a solution with M and three products with Phi. Small structures are
integrated in the coordinates of all their modes instead, by the kernel
(:mod:`fenics_crack.time.modal_march`). The scheme is second order. Steps beyond dt = 2 / omega_max,
omega_max the largest natural frequency with every pair closed, are unstable and refused. Below that
the scheme conserves energy as long as no pair changes its state; a contact from step a to step b
creates

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
the crack faces, when the mesh is refined.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError, check_omega
from fenics_crack.basics.ranks import collect_garbage
from fenics_crack.kernel import Struct, kernel
from fenics_crack.model.contact import (
    ActiveSets,
    ContactLaw,
    check_law,
    is_piecewise_linear,
    is_rigid,
    potential,
    solve_complementarity,
)
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.modes import largest_frequency
from fenics_crack.model.reduced import INSTEAD, check_mass
from fenics_crack.model.structure import Structure
from fenics_crack.time.march import LoopedSteps, March, TimeHistory, Window, march
from fenics_crack.time.modal_march import ModalSteps, times_by_mode

NAME, REMEDY = "central differences", "take more steps per period"


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
        An argument cannot be used, or the crack faces have no mass.

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
    """Integrate by central differences under the structure's load (collective).

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
        An argument cannot be used, the crack faces have no mass, or the step is longer than the
        stable one.
    ConvergenceError
        The motion grows without bound, or contact creates more energy than the load puts in: the
        steps are too long. Or no contact forces keep the crack faces from penetrating.

    Notes
    -----
    A motion that does not settle is a result, not an error: look at ``settled``.

    Examples
    --------
    >>> steps = fc.stable_steps_per_period(structure, 2000.0, contact)
    >>> history = fc.integrate_central_difference(
    ...     structure, 2000.0, contact, periods=2, steps_per_period=steps)
    """
    given = structure, omega, contact, periods, steps_per_period
    asked = March.of(integrate_central_difference, options, *given)
    least = stable_steps_per_period(structure, omega, contact)
    if steps_per_period < least:
        raise InputError(
            "steps_per_period", steps_per_period, f">= {least}, the stable limit of the scheme"
        )
    compiled = is_small(structure) and (is_piecewise_linear(contact) or asked.rigid)
    return march(asked, (_ModalDifferences if compiled else _CentralDifferences)(asked))


class _ContactEnergy:
    """Energy that contact creates by opening and closing between steps, and the energy put in.

    Work over a step is force times half the displacement from the step before to the one after,
    for which the scheme balances kinetic and elastic energy exactly.
    """

    def __init__(self, asked: March, energy: float) -> None:
        self._asked, self._created, self._put_in = asked, 0.0, energy
        pairs, rows = asked.structure.n_pairs, len(asked.load_rows)
        widths = rows, pairs, pairs, rows
        self._tail: list[np.ndarray] = [np.empty((0, width)) for width in widths]

    def of(self, window: Window) -> tuple[float, float]:
        """Energies created and put in with one more period [J]."""
        period = self._asked.load, window.gap, window.force, window.load_motion
        parts = [np.vstack(part) for part in zip(self._tail, period, strict=True)]
        self._tail = [part[-2:] for part in parts]
        load, gap, force, motion = parts
        self._created -= 0.5 * float(np.sum(force[1:-1] * (gap[2:] - gap[:-2])))
        if not self._asked.rigid:
            before, after = (potential(self._asked.contact, ends) for ends in (gap[:2], gap[-2:]))
            self._created += 0.5 * float(after.sum() - before.sum())
        work = np.array([0.5 * np.sum(load[1:-1] * (motion[2:] - motion[:-2]))])
        self._put_in += abs(float(self._asked.structure.sum_over_ranks(work)[0]))
        return self._created, self._put_in


def _last_velocity(
    step_size: float, increment: np.ndarray, acceleration: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Velocity at the end of a time integration, whose last increment leads back by half a step."""
    backwards = velocity = increment / step_size
    for _ in range(3):  # the acceleration depends on the velocity a little
        velocity = backwards + 0.5 * step_size * acceleration(velocity)
    return velocity


class _ModalDifferences(ModalSteps):
    """State of a small structure in modal coordinates, integrated by the kernel."""

    name, remedy = NAME, REMEDY

    def __init__(self, asked: March) -> None:
        super().__init__(asked)
        modes, dt, velocity = self._modes, asked.step_size, self._begin()
        count, pairs = modes.pairs.shape
        inverse = self._inverse(np.ones(count), 0.5 * dt)
        push = dt**2 * times_by_mode(inverse, modes.pairs)
        self._increment = dt * velocity - 0.5 * dt**2 * self._acceleration(velocity)
        self._energy = _ContactEnergy(asked, self._energy_of(velocity))
        self._known = Struct(
            "central_differences", body=self._body(room=np.empty(2 * count + pairs)),
            keep=2.0 * inverse - (1.0 if inverse.ndim == 1 else np.eye(count)),
            gain=dt**2 * inverse, push=np.ascontiguousarray(push.T),
            contact=ActiveSets(modes.pairs.T @ push).handle if asked.rigid else None,
            shape=self._shape, increment=self._increment, closed=np.zeros(pairs, bool),
        )  # fmt: skip

    def fill(self, window: Window, number: int) -> None:
        self._march(window, kernel.march_central)
        self.book(*self._energy.of(window))

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        velocity = _last_velocity(self._asked.step_size, self._increment, self._acceleration)
        return self._modes.shapes @ self._shape, self._modes.shapes @ velocity


class _CentralDifferences(LoopedSteps):
    """State and one step of the scheme."""

    name, remedy = NAME, REMEDY

    def __init__(self, asked: March) -> None:
        dt = asked.step_size
        super().__init__(asked, 1.0, 0.0, 0.5 * dt)
        if self.rigid:
            self._push = dt**2 * self._answers(self.structure.gap.toarray())
            self._compliance = self.structure.apply_bt(self._push.T).T
        displacement, velocity = asked.start
        self.displacement = self._admissible(displacement)
        # The step before from u_{-1} = u - dt v + dt^2 a / 2.
        self.increment = dt * velocity - 0.5 * dt**2 * self._acceleration(velocity)
        self._energy = _ContactEnergy(asked, self._linear_energy(velocity))

    def fill(self, window: Window, number: int) -> None:
        self.record(window)
        self.book(*self._energy.of(window))

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        velocity = _last_velocity(self.step_size, self.increment, self._acceleration)
        return self.displacement.copy(), velocity

    def advance(self, step: int) -> None:
        dt = self.step_size
        self.gap = self._measured(self.displacement)
        pull = -self._times(self.structure.stiffness, self.displacement)  # f - K u - B lambda
        pull[self.load_rows] += self.load[step]
        if not self.rigid:
            self.force = self.contact.force(self.gap)
            pull[self._gap_rows] -= self._gap_block @ self.force
        self.increment = self.increment + self._answer(dt**2 * pull, dt * self.increment)
        if self.rigid:
            reached = self.gap + self._closing(self.increment)
            self.force = solve_complementarity(self._compliance, reached, self.force > 0.0)
            self.increment -= self._push @ self.force
        self.before = self.displacement
        self.displacement = self.displacement + self.increment
