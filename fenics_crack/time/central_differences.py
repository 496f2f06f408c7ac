"""Direct integration in time by central differences: the reference for harmonic balance.

    M u'' + C u' + K u + B lambda(g) = f(t)

The paper's scheme, with the contact force that its printed form leaves out,

    (2 M + dt C) u_{n+1} = 2 dt^2 (f - K u - B lambda)_n + 4 M u_n - 2 M u_{n-1} + dt C u_{n-1},

integrated in increments d_n = u_n - u_{n-1} with r = f - K u - B lambda:

    (M + dt/2 C) (d_{n+1} - d_n) = dt^2 r_n - dt C d_n.

Modal damping C = M Phi diag(c) Phi^T M is inverted exactly: a step costs a product with K and one
with M, a solution with M and three products with Phi. Small structures are integrated in the
coordinates of all their modes instead, by the kernel. The scheme is second order. Steps beyond dt =
2 / omega_max, omega_max the largest natural frequency with every pair closed, are unstable and
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
the crack faces, when the mesh is refined.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fenics_crack.basics.errors import ConvergenceError, InputError, check_omega
from fenics_crack.basics.ranks import collect_garbage
from fenics_crack.kernel import Struct, kernel, pointer
from fenics_crack.model.contact import (
    ActiveSets,
    ContactLaw,
    FrictionSets,
    add_friction_pairs,
    check_law,
    coefficient_of,
    friction_of,
    is_piecewise_linear,
    potential,
    solve_complementarity,
    spring_compliances,
)
from fenics_crack.model.factor import Factor, weighted_sum
from fenics_crack.model.modal import CACHE_BLOCK_SIZE, all_modes, is_small
from fenics_crack.model.modes import damped_modes, largest_frequency, multiply
from fenics_crack.model.reduced import MASS_REMEDY, check_mass
from fenics_crack.model.structure import RayleighDamping, Structure
from fenics_crack.time.march import March, Scheme, TimeHistory, Window, march

NAME, MORE_STEPS = "central differences", "take more steps per period"


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
    check_mass(structure, MASS_REMEDY)
    check_omega(omega)
    check_law(structure, contact, rigid=True)
    springs = _springs(structure, contact)
    seen = add_friction_pairs(contact, structure)
    if is_small(structure):
        modes = all_modes(seen)
        tied = np.diag(modes.squares) + (modes.pairs * springs) @ modes.pairs.T
        highest = float(np.sqrt(np.linalg.eigvalsh(tied)[-1]))
    else:
        highest = largest_frequency(seen.tied(springs) if np.any(springs) else structure)
        collect_garbage(structure.comm)
    return int(np.floor(np.pi * highest * (1.0 + 1e-6) / omega)) + 1


def _springs(structure: Structure, contact: ContactLaw) -> np.ndarray:
    """Stiffness of closed pairs, with friction behind it of those that stick: (n_rows,) [N/m]; zero
    with a constraint. InputError with friction without springs."""
    soft = spring_compliances(contact, structure.n_pairs)
    if friction_of(contact) is not None and not np.all(soft):
        allowed = "a penalty with a tangential stiffness: crack faces have mass"
        raise InputError("contact", contact, allowed)
    return np.divide(1.0, soft, out=np.zeros_like(soft), where=soft > 0.0)


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
        allowed = f">= {least}, the stable limit of the scheme"
        raise InputError("steps_per_period", steps_per_period, allowed)
    compiled = is_small(structure) and (is_piecewise_linear(contact) or asked.rigid)
    return march(asked, (_ModalDifferences if compiled else _CentralDifferences)(asked))


class _ContactEnergy:
    """Energy that contact creates by opening and closing between steps, and the energy put in.

    Work over a step is force times half the displacement from the step before to the one after,
    for which the scheme balances kinetic and elastic energy exactly.
    """

    def __init__(self, asked: March, energy: float) -> None:
        self._asked, self._created, self._put_in = asked, 0.0, energy
        pairs, rows = asked.n_rows, len(asked.load_rows)
        widths = rows, pairs, pairs, rows
        self._tail: list[np.ndarray] = [np.empty((0, width)) for width in widths]

    def of(self, window: Window) -> tuple[float, float]:
        """Energies created and put in with one more period [J]."""
        period = self._asked.load, window.gap, window.force, window.load_motion
        parts = [np.vstack(part) for part in zip(self._tail, period, strict=True)]
        self._tail = [part[-2:] for part in parts]
        load, gap, force, motion = parts
        count = self._asked.structure.n_pairs  # springs and friction of tangents create none
        gap, force = gap[:, :count], force[:, :count]
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


# --- small structures, by the kernel --------------------------------------------------------------


class _ModalDifferences(Scheme):
    """State of a small structure in modal coordinates, integrated by the kernel.

    What acts on the modes is "by mode": an array (n,) where the damping leaves them uncoupled, and
    a matrix (n, n) where it couples them.
    """

    name, remedy = NAME, MORE_STEPS

    def __init__(self, asked: March) -> None:
        self._seen = add_friction_pairs(asked.contact, asked.structure)
        self._asked, self._modes, dt = asked, all_modes(self._seen), asked.step_size
        modes, (count, pairs) = self._modes, self._modes.pairs.shape
        springs, own = None, dict[str, Any]()
        if not asked.rigid:
            springs = _springs(asked.structure, asked.contact)
        if (mu := coefficient_of(asked.contact)) is not None:
            assert springs is not None
            self._sets = FrictionSets(np.diag(1.0 / springs), mu)
            self._held, states = np.zeros(pairs // 2), np.zeros(pairs // 2, dtype=np.int8)
            own = {"friction": self._sets.handle, "held": self._held, "states": states}
        self._shape, velocity = (modes.inverse @ part for part in asked.start[:2])
        gap = self._gap()
        if own:
            self._held[:] = asked.start[2] if asked.start[2:] else gap[pairs // 2 :]
        if asked.rigid and np.any(gap > 0.0):  # by the least change in the norm of M
            self._shape -= modes.pairs @ solve_complementarity(modes.pairs.T @ modes.pairs, gap)
        self._increment = dt * velocity - 0.5 * dt**2 * self._acceleration(velocity)
        energy = 0.5 * float(modes.squares @ self._shape**2 + velocity @ velocity)
        self._energy = _ContactEnergy(asked, energy)
        one = np.ones(count) if modes.damping.ndim == 1 else np.eye(count)
        damped = one + 0.5 * dt * modes.damping
        inverse = 1.0 / damped if damped.ndim == 1 else np.linalg.inv(damped)
        moved = inverse[:, None] * modes.pairs if inverse.ndim == 1 else inverse @ modes.pairs
        push = dt**2 * moved
        rows = np.ascontiguousarray
        body = Struct(
            "vibration", modes=count, pairs=pairs, coupled=modes.damping.ndim == 2,
            squares=rows(modes.squares), rows=rows(modes.pairs.T),
            clearance=np.array(self._seen.clearance, dtype=float),
            springs=springs, load=rows(asked.structure.force @ modes.shapes),
            waves=rows(asked.waves), loads=len(asked.structure.force),
            room=np.empty(2 * count + pairs), **own,
        )  # fmt: skip
        self._known = Struct(
            "central_differences", body=body,
            keep=2.0 * inverse - one, gain=dt**2 * inverse, push=rows(push.T),
            contact=ActiveSets(modes.pairs.T @ push).handle if asked.rigid else None,
            shape=self._shape, increment=self._increment, closed=np.zeros(pairs, bool),
        )  # fmt: skip

    def _gap(self) -> np.ndarray:
        """Gap at the end of the integration."""
        return np.asarray(self._shape @ self._modes.pairs - self._seen.clearance)

    def _acceleration(self, velocity: np.ndarray) -> np.ndarray:
        """f - w^2 q - P lambda - c v at phase zero of the load; forces of a constraint, which
        belong to the next step, are left out."""
        modes, force = self._modes, self._asked.structure.force
        found = (force[0] + force[1::2].sum(axis=0)) @ modes.shapes - modes.squares * self._shape
        if not self._asked.rigid:
            found -= modes.pairs @ self._forces(self._gap())
        return np.asarray(found - modes.damping_force(velocity))

    def _forces(self, gap: np.ndarray) -> np.ndarray:
        """Forces of gaps (n_rows,), without a constraint."""
        if friction_of(self._asked.contact) is None:
            return self._asked.contact.force(gap)
        return self._sets.solve(gap[None], self._held)[0][0]

    def fill(self, window: Window, number: int) -> None:
        modes, asked, count = self._modes, self._asked, len(window.gap)
        some = max(1, CACHE_BLOCK_SIZE // len(modes.squares))
        for first in range(0, count, some):
            place = slice(first, min(first + some, count))
            shape = np.empty((place.stop - first, len(modes.squares)))
            made = kernel.march_central(
                self._known.at, first, len(shape), pointer(window.gap[place]),
                pointer(window.force[place]), pointer(shape),
            )  # fmt: skip
            if made < len(shape):
                raise ConvergenceError(f"contact: no forces of step {first + made} were found")
            window.motion[place] = shape @ modes.shapes[asked.recorded_dofs].T
            window.load_motion[place] = shape @ modes.shapes[asked.load_rows].T
        self.book(*self._energy.of(window))

    def state(self) -> tuple[np.ndarray, ...]:
        velocity = _last_velocity(self._asked.step_size, self._increment, self._acceleration)
        found = self._modes.shapes @ self._shape, self._modes.shapes @ velocity
        return found if friction_of(self._asked.contact) is None else (*found, self._held.copy())


# --- step by step ---------------------------------------------------------------------------------


class _CentralDifferences(Scheme):
    """State of a structure and one step of the scheme, with A = M + dt/2 C factored (collective).

    Modal damping C = M Phi diag(c) Phi^T M enters by its low rank: with d = 1 + dt/2 c,

        A^-1 = M^-1 + Phi diag(1/d - 1) Phi^T,     A^-1 C = Phi diag(c/d) Phi^T M.
    """

    name, remedy = NAME, MORE_STEPS

    def __init__(self, asked: March) -> None:
        self.structure, dt = asked.structure, asked.step_size
        structure = self.structure
        self.contact, self.rigid, self.step_size = asked.contact, asked.rigid, dt
        self.load, self.load_rows = asked.load, asked.load_rows
        self.force = np.zeros(structure.n_pairs)
        # Only few rows of B are not zero.
        seen = add_friction_pairs(asked.contact, structure)
        self._gap_rows = np.flatnonzero(np.diff(seen.gap.indptr))
        self._gap_block = seen.gap[self._gap_rows].toarray()
        self._clearance = seen.clearance
        if (mu := coefficient_of(asked.contact)) is not None:
            self._sets = FrictionSets(np.diag(1.0 / _springs(structure, asked.contact)), mu)
        self._columns = asked.recorded_dofs - structure.first_dof
        self._modes, self._damping = damped_modes(structure), structure.damping_matrix
        self._x, self._y = structure.mass.createVecs()
        matrix = structure.mass
        if self._damping is not None:
            matrix = weighted_sum(structure.mass, 0.5 * dt, self._damping)
        # A C that was given need not be symmetric.
        symmetric = self._damping is None or isinstance(structure.damping, RayleighDamping)
        self._inverse = Factor(matrix, symmetric=symmetric, definite=True)
        own = () if self._damping is None else (matrix,)
        self.owned = self._x, self._y, self._inverse, *own
        if self._modes is not None:
            damped = 1.0 + 0.5 * dt * self._modes.rate
            self._correction, self._decay = 1.0 / damped - 1.0, self._modes.rate / damped
        if self.rigid:
            self._push, still = dt**2 * structure.gap.toarray(), np.zeros(structure.n_local)
            for column in self._push.T:
                column[:] = self._answer(column, still)
            self._compliance = structure.apply_bt(self._push.T).T
        displacement, velocity = asked.start[:2]
        self.displacement = self._admissible(displacement)
        if friction_of(self.contact) is not None:
            still = self._measured(displacement)[structure.n_pairs :]
            self._held = asked.start[2] if asked.start[2:] else still
        # The step before from u_{-1} = u - dt v + dt^2 a / 2.
        self.increment = dt * velocity - 0.5 * dt**2 * self._acceleration(velocity)
        self._energy = _ContactEnergy(asked, self._linear_energy(velocity))

    def fill(self, window: Window, number: int) -> None:
        for step in range(len(window.gap)):
            before = self.displacement
            self.advance(step)
            window.gap[step], window.force[step] = self.gap, self.force
            window.load_motion[step] = before[self.load_rows]
            window.motion[step] = before[self._columns]
        self.book(*self._energy.of(window))

    def state(self) -> tuple[np.ndarray, ...]:
        velocity = _last_velocity(self.step_size, self.increment, self._acceleration)
        found = self.displacement.copy(), velocity
        return found if friction_of(self.contact) is None else (*found, self._held.copy())

    def advance(self, step: int) -> None:
        """Integrate from an instant, ``step`` of the period, to the next."""
        dt = self.step_size
        pull = dt**2 * self._pull(step)
        self.increment = self.increment + self._answer(pull, dt * self.increment)
        if self.rigid:
            reached = self.gap + self._closing(self.increment)
            self.force = solve_complementarity(self._compliance, reached, self.force > 0.0)
            self.increment -= self._push @ self.force
        self.displacement = self.displacement + self.increment

    def _pull(self, step: int) -> np.ndarray:
        """f - K u - B lambda at an instant of the period; forces of a constraint, which belong to
        the next step, are left out."""
        self.gap = self._measured(self.displacement)
        pull = -self._applied(self.structure.stiffness.mult, self.displacement)
        pull[self.load_rows] += self.load[step]
        if not self.rigid:
            self.force = self._forces(self.gap)
            pull[self._gap_rows] -= self._gap_block @ self.force
        return pull

    def _forces(self, gap: np.ndarray) -> np.ndarray:
        """Forces of gaps (n_rows,), without a constraint; with friction pairs stick from here on
        where they are now."""
        if friction_of(self.contact) is None:
            return self.contact.force(gap)
        forces, _, places, _ = self._sets.solve(gap[None], self._held)
        self._held = places[0]
        return forces[0]

    def _closing(self, motion: np.ndarray) -> np.ndarray:
        """B^T of a motion (n_local,)."""
        return self.structure.sum_over_ranks(motion[self._gap_rows] @ self._gap_block)

    def _measured(self, displacement: np.ndarray) -> np.ndarray:
        """Gap of a displacement (n_local,)."""
        return self._closing(displacement) - self._clearance

    def _applied(self, operator: Callable[[Any, Any], None], rows: np.ndarray) -> np.ndarray:
        """Apply an operator of PETSc's to a vector (n_local,)."""
        self._x.array_w[:] = rows
        operator(self._x, self._y)
        return self._y.array_r.copy()

    def _answer(self, right: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """A^-1 (r - C v)."""
        modes = self._modes
        if modes is None:
            return self._applied(self._inverse.apply, right - self._damped(velocity))
        moved = self._applied(self.structure.mass.mult, velocity)
        both = np.stack([right @ modes.shapes, moved @ modes.shapes])
        pushed, speed = self.structure.sum_over_ranks(both)
        found = self._applied(self._inverse.apply, right)
        return found + modes.shapes @ (self._correction * pushed - self._decay * speed)

    def _damped(self, velocity: np.ndarray) -> np.ndarray:
        """C v."""
        if self._damping is not None:
            return self._applied(self._damping.mult, velocity)
        if self._modes is None:
            return np.zeros_like(velocity)
        modal = self.structure.sum_over_ranks(velocity @ self._modes.mass_shapes)
        return self._modes.mass_shapes @ (self._modes.rate * modal)

    def _acceleration(self, velocity: np.ndarray) -> np.ndarray:
        """M^-1 (f - K u - B lambda - C v) at phase zero of the load."""
        right = self._pull(0) - self._damped(velocity)
        with Factor(self.structure.mass, definite=True) as factor:
            return np.asarray(factor.solve(right[None])[0])

    def _linear_energy(self, velocity: np.ndarray) -> float:
        """(u^T K u + v^T M v) / 2: [J]."""
        structure = self.structure
        parts = (structure.stiffness, self.displacement), (structure.mass, velocity)
        energy = 0.5 * sum(rows @ multiply(matrix, rows[:, None])[:, 0] for matrix, rows in parts)
        return float(structure.sum_over_ranks(np.array([energy]))[0])

    def _admissible(self, displacement: np.ndarray) -> np.ndarray:
        """Displacement closest in the norm of M without penetration, with a constraint."""
        gap = self._measured(displacement)
        if not self.rigid or not np.any(gap > 0.0):
            return displacement
        with Factor(self.structure.mass, definite=True) as factor:
            push = factor.solve(self.structure.gap.T.toarray())
        return displacement - solve_complementarity(self.structure.apply_bt(push), gap) @ push
