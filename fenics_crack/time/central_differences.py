"""Direct integration in time by central differences: the reference for harmonic balance.

    M u'' + C u' + K u + B lambda(g) = f(t)

The paper's scheme, with the contact force that its printed form leaves out,

    (2 M + dt C) u_{n+1} = 2 dt^2 (f - K u - B lambda)_n + 4 M u_n - 2 M u_{n-1} + dt C u_{n-1},

integrated in increments d_n = u_n - u_{n-1} with r = f - K u - B lambda and A = M + dt/2 C:

    A (d_{n+1} - d_n) = dt^2 r_n - dt C d_n.

Modal damping C = M Phi diag(c) Phi^T M is inverted exactly: a step costs a product with K and one
with M, a solution with M and three products with Phi. Small structures are integrated in the
coordinates of all their modes instead, by the kernel. The scheme is second order. Steps beyond dt =
2 / omega_max, omega_max the largest natural frequency with every pair closed, are unstable and
refused. Shorter steps conserve energy as long as no pair opens or closes. A contact from step a to
step b creates

    1/2 k (g_b |g_{b+1}| - g_a |g_{a-1}|),

of either sign. Close to the limit this energy can exceed the damping's loss. It is summed up and
reported, and more than twice the energy put in is an error.

Without penetration (:class:`UnilateralConstraint`) the forces at instant n keep the gaps of the
next instant from penetrating. With the increment d* without forces,

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
    ActiveSetSolver,
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
from fenics_crack.model.modal import MODAL_COORDINATES_IN_CACHE, all_modes, is_small
from fenics_crack.model.modes import damped_modes, largest_frequency, multiply
from fenics_crack.model.reduced import MASS_REMEDY, check_mass
from fenics_crack.model.structure import RayleighDamping, Structure
from fenics_crack.time.march import March, Scheme, TimeHistory, Window, march

NAME, MORE_STEPS = "central differences", "take more steps per period"


def stable_steps_per_period(structure: Structure, omega: float, contact: ContactLaw) -> int:
    """Return the smallest stable number of steps per load period (collective).

    A step dt <= 2 / omega_max is stable. Under a penalty law omega_max is the largest natural
    frequency with all pairs closed by springs. Under a constraint, it is the one with open pairs.

    Parameters
    ----------
    structure, omega, contact
        As of :func:`integrate_central_difference`.

    Returns
    -------
    int
        Least ``steps_per_period`` of :func:`integrate_central_difference`.

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
    contact_structure = add_friction_pairs(contact, structure)
    if is_small(structure):
        modes = all_modes(contact_structure)
        bonded_stiffness = np.diag(modes.squares) + (modes.pairs * springs) @ modes.pairs.T
        largest_omega = float(np.sqrt(np.linalg.eigvalsh(bonded_stiffness)[-1]))
    else:
        largest_omega = largest_frequency(
            contact_structure.tied(springs) if np.any(springs) else structure
        )
        collect_garbage(structure.comm)
    return int(np.floor(np.pi * largest_omega * (1.0 + 1e-6) / omega)) + 1


def _springs(structure: Structure, contact: ContactLaw) -> np.ndarray:
    """Return the contact stiffness of each gap: (n_rows,) [N/m].

    A constraint has 0. The pairs' normal stiffnesses come first; with friction their tangential
    ones follow. Raises InputError if there is friction without springs.
    """
    softness = spring_compliances(contact, structure.n_pairs)
    if friction_of(contact) is not None and not np.all(softness):
        allowed = "a penalty with a tangential stiffness: crack faces have mass"
        raise InputError("contact", contact, allowed)
    return np.divide(1.0, softness, out=np.zeros_like(softness), where=softness > 0.0)


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

    M, C and K are mass, damping and stiffness, f is the load, and B takes the contact forces lambda
    to the dofs.

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
    arguments = structure, omega, contact, periods, steps_per_period
    request = March.from_call(integrate_central_difference, options, *arguments)
    min_steps = stable_steps_per_period(structure, omega, contact)
    if steps_per_period < min_steps:
        allowed = f">= {min_steps}, the stable limit of the scheme"
        raise InputError("steps_per_period", steps_per_period, allowed)
    has_kernel = is_small(structure) and (is_piecewise_linear(contact) or request.rigid)
    return march(request, (_ModalDifferences if has_kernel else _CentralDifferences)(request))


class _ContactEnergy:
    """Sum the energy that contact creates between steps, and the energy put in.

    Contact creates energy if a pair opens or closes between two steps. The work of a step is the
    force times half the displacement from the previous step to the next one: with it the scheme
    balances kinetic and elastic energy exactly.
    """

    def __init__(self, request: March, energy: float) -> None:
        self._request, self._created_energy, self._energy_input = request, 0.0, energy
        pairs, rows = request.n_rows, len(request.loaded_dofs)
        widths = rows, pairs, pairs, rows
        self._tail: list[np.ndarray] = [np.empty((0, width)) for width in widths]

    def add_period(self, window: Window) -> tuple[float, float]:
        """Add one period; return the energy created and the energy put in so far [J]."""
        period = self._request.load, window.gap, window.force, window.load_motion
        parts = [np.vstack(part) for part in zip(self._tail, period, strict=True)]
        self._tail = [part[-2:] for part in parts]
        load, gap, force, motion = parts
        n_pairs = self._request.structure.n_pairs  # springs and friction of tangents create none
        gap, force = gap[:, :n_pairs], force[:, :n_pairs]
        self._created_energy -= 0.5 * float(np.sum(force[1:-1] * (gap[2:] - gap[:-2])))
        if not self._request.rigid:
            first_spring_energy, last_spring_energy = (
                potential(self._request.contact, ends) for ends in (gap[:2], gap[-2:])
            )
            self._created_energy += 0.5 * float(
                last_spring_energy.sum() - first_spring_energy.sum()
            )
        load_work = np.array([0.5 * np.sum(load[1:-1] * (motion[2:] - motion[:-2]))])
        self._energy_input += abs(float(self._request.structure.sum_over_ranks(load_work)[0]))
        return self._created_energy, self._energy_input


def _last_velocity(
    step_size: float, increment: np.ndarray, acceleration: Callable[[np.ndarray], np.ndarray]
) -> np.ndarray:
    """Return the velocity at the end of a time integration from its last increment.

    The last increment (n,) over the step size is the velocity half a step earlier. The callable
    takes a velocity (n,) to the acceleration at the end.
    """
    mean_velocity = velocity = increment / step_size
    for _ in range(3):  # the acceleration depends on the velocity a little
        velocity = mean_velocity + 0.5 * step_size * acceleration(velocity)
    return velocity


# --- small structures, by the kernel --------------------------------------------------------------


class _ModalDifferences(Scheme):
    """Integrate a small structure in modal coordinates by the kernel.

    Operators on the n modes are arrays (n,) if damping leaves the modes uncoupled, and matrices
    (n, n) if it couples them.
    """

    name, remedy = NAME, MORE_STEPS

    def __init__(self, request: March) -> None:
        self._contact_structure = add_friction_pairs(request.contact, request.structure)
        self._request, self._modes, dt = (
            request,
            all_modes(self._contact_structure),
            request.step_size,
        )
        modes, (n_modes, n_rows) = self._modes, self._modes.pairs.shape
        springs, friction_members = None, dict[str, Any]()
        if not request.rigid:
            springs = _springs(request.structure, request.contact)
        if (mu := coefficient_of(request.contact)) is not None:
            assert springs is not None
            self._sets = FrictionSets(np.diag(1.0 / springs), mu)
            self._sticking_places, states = (
                np.zeros(n_rows // 2),
                np.zeros(n_rows // 2, dtype=np.int8),
            )
            friction_members = {
                "friction": self._sets.handle,
                "stick_places": self._sticking_places,
                "pair_states": states,
            }
        self._shape, velocity = (modes.inverse @ part for part in request.start[:2])
        gap = self._gap()
        if friction_members:
            self._sticking_places[:] = request.start[2] if request.start[2:] else gap[n_rows // 2 :]
        if request.rigid and np.any(gap > 0.0):  # by the least change in the norm of M
            self._shape -= modes.pairs @ solve_complementarity(modes.pairs.T @ modes.pairs, gap)
        self._increment = dt * velocity - 0.5 * dt**2 * self._acceleration(velocity)
        energy = 0.5 * float(modes.squares @ self._shape**2 + velocity @ velocity)
        self._energy = _ContactEnergy(request, energy)
        identity = np.ones(n_modes) if modes.damping.ndim == 1 else np.eye(n_modes)
        damping_operator = identity + 0.5 * dt * modes.damping
        inverse = (
            1.0 / damping_operator
            if damping_operator.ndim == 1
            else np.linalg.inv(damping_operator)
        )
        pair_response = (
            inverse[:, None] * modes.pairs if inverse.ndim == 1 else inverse @ modes.pairs
        )
        force_step = dt**2 * pair_response
        contiguous = np.ascontiguousarray
        body = Struct(
            "vibration", modes=n_modes, pairs=n_rows, coupled=modes.damping.ndim == 2,
            squares=contiguous(modes.squares), rows=contiguous(modes.pairs.T),
            clearance=np.array(self._contact_structure.clearance, dtype=float),
            springs=springs, load=contiguous(request.structure.force @ modes.shapes),
            waves=contiguous(request.waves), loads=len(request.structure.force),
            work=np.empty(2 * n_modes + n_rows), **friction_members,
        )  # fmt: skip
        self._kernel_data = Struct(
            "central_differences", vibration=body,
            keep=2.0 * inverse - identity, gain=dt**2 * inverse, push=contiguous(force_step.T),
            contact=ActiveSetSolver(modes.pairs.T @ force_step).handle if request.rigid else None,
            displacements=self._shape, increment=self._increment, closed=np.zeros(n_rows, bool),
        )  # fmt: skip

    def _gap(self) -> np.ndarray:
        """Return the gaps at the end of the integration: (n_rows,) [m]."""
        return np.asarray(self._shape @ self._modes.pairs - self._contact_structure.clearance)

    def _acceleration(self, velocity: np.ndarray) -> np.ndarray:
        """Return the modal acceleration f - w^2 q - P lambda - c v at phase zero: (n,).

        q and v are modal displacements and velocities, w natural frequencies, and P lambda modal
        contact forces. Forces of a constraint are left out: they belong to the next step.
        """
        modes, load_coefficients = self._modes, self._request.structure.force
        acceleration = (
            load_coefficients[0] + load_coefficients[1::2].sum(axis=0)
        ) @ modes.shapes - modes.squares * self._shape
        if not self._request.rigid:
            acceleration -= modes.pairs @ self._forces(self._gap())
        return np.asarray(acceleration - modes.damping_force(velocity))

    def _forces(self, gap: np.ndarray) -> np.ndarray:
        """Return the contact forces of gaps (n_rows,) under a penalty law [N]."""
        if friction_of(self._request.contact) is None:
            return self._request.contact.force(gap)
        return self._sets.solve(gap[None], self._sticking_places)[0][0]

    def fill(self, window: Window, number: int) -> None:
        modes, request, count = self._modes, self._request, len(window.gap)
        n_in_cache = max(1, MODAL_COORDINATES_IN_CACHE // len(modes.squares))
        for first_step in range(0, count, n_in_cache):
            steps = slice(first_step, min(first_step + n_in_cache, count))
            shape = np.empty((steps.stop - first_step, len(modes.squares)))
            n_made = kernel.march_central(
                self._kernel_data.address, first_step, len(shape), pointer(window.gap[steps]),
                pointer(window.force[steps]), pointer(shape),
            )  # fmt: skip
            if n_made < len(shape):
                raise ConvergenceError(
                    f"contact: no forces of step {first_step + n_made} were found"
                )
            window.motion[steps] = shape @ modes.shapes[request.recorded_dofs].T
            window.load_motion[steps] = shape @ modes.shapes[request.loaded_dofs].T
        self.book(*self._energy.add_period(window))

    def state(self) -> tuple[np.ndarray, ...]:
        velocity = _last_velocity(self._request.step_size, self._increment, self._acceleration)
        motion = self._modes.shapes @ self._shape, self._modes.shapes @ velocity
        return (
            motion
            if friction_of(self._request.contact) is None
            else (*motion, self._sticking_places.copy())
        )


# --- step by step ---------------------------------------------------------------------------------


class _CentralDifferences(Scheme):
    """Integrate a large structure step by step with A = M + dt/2 C factored (collective).

    Modal damping C = M Phi diag(c) Phi^T M enters by its low rank. With rates c of the
    mass-normalised modes Phi and d = 1 + dt/2 c:

        A^-1 = M^-1 + Phi diag(1/d - 1) Phi^T,     A^-1 C = Phi diag(c/d) Phi^T M.
    """

    name, remedy = NAME, MORE_STEPS

    def __init__(self, request: March) -> None:
        self.structure, dt = request.structure, request.step_size
        structure = self.structure
        self.contact, self.rigid, self.step_size = request.contact, request.rigid, dt
        self.load, self.loaded_dofs = request.load, request.loaded_dofs
        self.force = np.zeros(structure.n_pairs)
        # Only few rows of B are not zero.
        contact_structure = add_friction_pairs(request.contact, structure)
        self._gap_rows = np.flatnonzero(np.diff(contact_structure.gap.indptr))
        self._gap_block = contact_structure.gap[self._gap_rows].toarray()
        self._clearance = contact_structure.clearance
        if (mu := coefficient_of(request.contact)) is not None:
            self._sets = FrictionSets(np.diag(1.0 / _springs(structure, request.contact)), mu)
        self._columns = request.recorded_dofs - structure.first_dof
        self._modes, self._damping = damped_modes(structure), structure.damping_matrix
        self._x, self._y = structure.mass.createVecs()
        matrix = structure.mass
        if self._damping is not None:
            matrix = weighted_sum(structure.mass, 0.5 * dt, self._damping)
        # A C that was given need not be symmetric.
        symmetric = self._damping is None or isinstance(structure.damping, RayleighDamping)
        self._inverse = Factor(matrix, symmetric=symmetric, definite=True)
        damped_mass = () if self._damping is None else (matrix,)
        self.petsc_objects = self._x, self._y, self._inverse, *damped_mass
        if self._modes is not None:
            mass_factors = 1.0 + 0.5 * dt * self._modes.modal_damping
            self._correction, self._decay = (
                1.0 / mass_factors - 1.0,
                self._modes.modal_damping / mass_factors,
            )
        if self.rigid:
            self._push, rest = dt**2 * structure.gap.toarray(), np.zeros(structure.n_local)
            for column in self._push.T:
                column[:] = self._solve(column, rest)
            self._compliance = structure.apply_bt(self._push.T).T
        displacement, velocity = request.start[:2]
        self.displacement = self._admissible(displacement)
        if friction_of(self.contact) is not None:
            rest = self._gap_of(displacement)[structure.n_pairs :]
            self._sticking_places = request.start[2] if request.start[2:] else rest
        # The step before from u_{-1} = u - dt v + dt^2 a / 2.
        self.increment = dt * velocity - 0.5 * dt**2 * self._acceleration(velocity)
        self._energy = _ContactEnergy(request, self._linear_energy(velocity))

    def fill(self, window: Window, number: int) -> None:
        for step in range(len(window.gap)):
            displacement = self.displacement
            self.advance(step)
            window.gap[step], window.force[step] = self.gap, self.force
            window.load_motion[step] = displacement[self.loaded_dofs]
            window.motion[step] = displacement[self._columns]
        self.book(*self._energy.add_period(window))

    def state(self) -> tuple[np.ndarray, ...]:
        velocity = _last_velocity(self.step_size, self.increment, self._acceleration)
        motion = self.displacement.copy(), velocity
        return (
            motion if friction_of(self.contact) is None else (*motion, self._sticking_places.copy())
        )

    def advance(self, step: int) -> None:
        """Integrate one step, from instant ``step`` of the period."""
        dt = self.step_size
        squared_step_pull = dt**2 * self._pull(step)
        self.increment = self.increment + self._solve(squared_step_pull, dt * self.increment)
        if self.rigid:
            next_gap = self.gap + self._gap_motion(self.increment)
            self.force = solve_complementarity(self._compliance, next_gap, self.force > 0.0)
            self.increment -= self._push @ self.force
        self.displacement = self.displacement + self.increment

    def _pull(self, step: int) -> np.ndarray:
        """Return load less elastic and contact forces, f - K u - B lambda: (n_local,) [N].

        ``step`` is the instant in the period. Forces of a constraint are left out: they belong to
        the next step.
        """
        self.gap = self._gap_of(self.displacement)
        pull = -self._apply(self.structure.stiffness.mult, self.displacement)
        pull[self.loaded_dofs] += self.load[step]
        if not self.rigid:
            self.force = self._forces(self.gap)
            pull[self._gap_rows] -= self._gap_block @ self.force
        return pull

    def _forces(self, gap: np.ndarray) -> np.ndarray:
        """Return the contact forces of gaps (n_rows,) under a penalty law [N].

        With friction the tangential gaps at which pairs stick are updated.
        """
        if friction_of(self.contact) is None:
            return self.contact.force(gap)
        forces, _, places, _ = self._sets.solve(gap[None], self._sticking_places)
        self._sticking_places = places[0]
        return forces[0]

    def _gap_motion(self, motion: np.ndarray) -> np.ndarray:
        """Return B^T u, the gaps' change by a displacement u (n_local,): (n_rows,) [m]."""
        return self.structure.sum_over_ranks(motion[self._gap_rows] @ self._gap_block)

    def _gap_of(self, displacement: np.ndarray) -> np.ndarray:
        """Return the gaps of a displacement (n_local,): (n_rows,) [m]."""
        return self._gap_motion(displacement) - self._clearance

    def _apply(self, operator: Callable[[Any, Any], None], rows: np.ndarray) -> np.ndarray:
        """Apply a PETSc operator to a vector (n_local,)."""
        self._x.array_w[:] = rows
        operator(self._x, self._y)
        return self._y.array_r.copy()

    def _solve(self, force: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return A^-1 (r - C v) with A = M + dt/2 C, a force r and a velocity v (n_local,)."""
        modes = self._modes
        if modes is None:
            return self._apply(self._inverse.apply, force - self._damping_force(velocity))
        momentum = self._apply(self.structure.mass.mult, velocity)
        modal_parts = np.stack([force @ modes.shapes, momentum @ modes.shapes])
        modal_force, modal_velocity = self.structure.sum_over_ranks(modal_parts)
        acceleration = self._apply(self._inverse.apply, force)
        return acceleration + modes.shapes @ (
            self._correction * modal_force - self._decay * modal_velocity
        )

    def _damping_force(self, velocity: np.ndarray) -> np.ndarray:
        """Return the damping force C v: (n_local,) [N]."""
        if self._damping is not None:
            return self._apply(self._damping.mult, velocity)
        if self._modes is None:
            return np.zeros_like(velocity)
        modal_velocity = self.structure.sum_over_ranks(velocity @ self._modes.mass_shapes)
        return self._modes.mass_shapes @ (self._modes.modal_damping * modal_velocity)

    def _acceleration(self, velocity: np.ndarray) -> np.ndarray:
        """Return the acceleration M^-1 (f - K u - B lambda - C v) at phase zero of the load."""
        force = self._pull(0) - self._damping_force(velocity)
        with Factor(self.structure.mass, definite=True) as factor:
            return np.asarray(factor.solve(force[None])[0])

    def _linear_energy(self, velocity: np.ndarray) -> float:
        """Return elastic plus kinetic energy, (u^T K u + v^T M v) / 2 [J]."""
        structure = self.structure
        matrix_and_rows = (structure.stiffness, self.displacement), (structure.mass, velocity)
        energy = 0.5 * sum(
            rows @ multiply(matrix, rows[:, None])[:, 0] for matrix, rows in matrix_and_rows
        )
        return float(structure.sum_over_ranks(np.array([energy]))[0])

    def _admissible(self, displacement: np.ndarray) -> np.ndarray:
        """Return the nearest displacement (n_local,) without penetration, in the norm of M."""
        gap = self._gap_of(displacement)
        if not self.rigid or not np.any(gap > 0.0):
            return displacement
        with Factor(self.structure.mass, definite=True) as factor:
            push = factor.solve(self.structure.gap.T.toarray())
        return displacement - solve_complementarity(self.structure.apply_bt(push), gap) @ push
