"""Direct integration in time by central differences: the reference for harmonic balance.

    M u'' + C u' + K u + B lambda(g) = f(t)

The paper's scheme, with the contact force that its printed form leaves out,

    (2 M + dt C) u_{n+1} = 2 dt^2 (f - K u - B lambda)_n + 4 M u_n - 2 M u_{n-1} + dt C u_{n-1},

integrated in increments d_n = u_n - u_{n-1} with r = f - K u - B lambda and A = M + dt/2 C:

    A (d_{n+1} - d_n) = dt^2 r_n - dt C d_n.

Modal damping C = M Phi diag(c) Phi^T M is inverted exactly: a step costs a product with K and one
with M, a solution with M and three products with Phi. Small structures are integrated in the
coordinates of all their modes instead, by the kernel. The scheme is second order. Steps longer than
dt = 2 / omega_max are unstable and refused. omega_max is the largest natural frequency, under the
penalty law with every pair closed. Shorter steps conserve energy as long as no pair opens or
closes. A contact from step a to step b, with contact stiffness k and gap g, creates the energy

    1/2 k (g_b |g_{b+1}| - g_a |g_{a-1}|),

of either sign. Close to the limit this energy can exceed the damping's loss. The created energy is
summed up and reported. More than twice the energy from load and initial state is an error.

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
    FrictionContactSolver,
    add_pair_for_each_contact_force,
    check_law,
    contact_energy,
    friction_coefficient_of,
    friction_of,
    is_piecewise_linear,
    solve_complementarity,
    spring_compliances,
)
from fenics_crack.model.factor import Factor, matrix_plus_weighted_matrix
from fenics_crack.model.modal import N_MODAL_COORDINATES_IN_CPU_CACHE, all_modes, is_small
from fenics_crack.model.modes import (
    find_largest_natural_omega,
    modes_with_modal_damping,
    multiply_columns,
)
from fenics_crack.model.reduced import REMEDY_FOR_MASSLESS_CRACK_FACES, check_faces_have_mass
from fenics_crack.model.structure import RayleighDamping, Structure
from fenics_crack.time.march import MarchRequest, PeriodWindow, Scheme, TimeHistory, march

SCHEME_NAME = "central differences"
"""Name of the scheme in messages."""
MORE_STEPS_REMEDY = "take more steps per period (steps_per_period)"
"""Advice if contact creates energy."""


def stable_steps_per_period(structure: Structure, omega: float, contact: ContactLaw) -> int:
    """Return the smallest stable number of steps per load period (collective).

    A step dt <= 2 / omega_max is stable. Under a penalty law omega_max is the largest natural
    frequency with all pairs closed by springs; under UnilateralConstraint with all pairs open.

    Parameters
    ----------
    structure : Structure
        Structure to integrate.
    omega : float [rad/s]
        Angular frequency of the load.
    contact : ContactLaw
        Law of all pairs.

    Returns
    -------
    int
        Smallest ``steps_per_period`` for :func:`integrate_central_difference`.

    Raises
    ------
    InputError
        An argument cannot be used, or the crack faces have no mass.

    Examples
    --------
    >>> steps = fc.stable_steps_per_period(structure, 2000.0, contact)
    """
    check_faces_have_mass(structure, REMEDY_FOR_MASSLESS_CRACK_FACES)
    check_omega(omega)
    check_law(structure, contact, allows_rigid=True)
    springs = _contact_stiffnesses(structure, contact)
    structure_with_contact_rows = add_pair_for_each_contact_force(contact, structure)
    if is_small(structure):
        open_modes = all_modes(structure_with_contact_rows)
        bonded_stiffness = (
            np.diag(open_modes.squares)
            + (open_modes.gaps_by_mode * springs) @ open_modes.gaps_by_mode.T
        )
        largest_omega = float(np.sqrt(np.linalg.eigvalsh(bonded_stiffness)[-1]))
    else:
        largest_omega = find_largest_natural_omega(
            structure_with_contact_rows.tied(springs) if np.any(springs) else structure
        )
        collect_garbage(structure.comm)
    return int(np.floor(np.pi * largest_omega * (1.0 + 1e-6) / omega)) + 1


def _contact_stiffnesses(structure: Structure, contact: ContactLaw) -> np.ndarray:
    """Return the stiffness of the contact spring for each contact force: (n_rows,) [N/m].

    Each pair's normal stiffness comes first; with friction the tangential stiffnesses follow.
    UnilateralConstraint has no spring: the result is 0. InputError if a friction law lacks a normal
    or tangential spring.
    """
    softness = spring_compliances(contact, structure.n_pairs)
    if friction_of(contact) is not None and not np.all(softness):
        requirement = (
            "a friction law with normal and tangential springs, as crack faces have mass: "
            "CoulombFriction(UnilateralPenalty(...), coefficient, tangential_stiffness)"
        )
        raise InputError("contact", contact, requirement)
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
    structure : Structure
        Best with :meth:`Structure.lumped` mass.
    omega : float [rad/s]
        Angular frequency of the load.
    contact : ContactLaw
        Law of all pairs. Under UnilateralConstraint an initial displacement with penetration is
        replaced by the nearest one without, in the norm of M.
    periods : int
        Load periods to integrate.
    steps_per_period : int
        At least :func:`stable_steps_per_period`.
    **options
        - initial: state at time 0, as a solution or arrays (displacement, velocity); default: rest.
        - settle: stop early below this relative change from period to period; 0: never.
        - record_periods: number of last periods to keep; default: all.
        - dofs: dofs whose displacements are recorded; default: all.
        - progress: show a progress bar.

        :class:`fenics_crack.time.march.MarchRequest` describes them further.

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
        The steps are too long: the motion grows without bound, or contact creates more than twice
        the energy from load and initial state. Or the contact forces of a step were not found.

    Notes
    -----
    A motion that does not settle is a result, not an error: look at ``settled``.

    Examples
    --------
    >>> steps = fc.stable_steps_per_period(structure, 2000.0, contact)
    >>> history = fc.integrate_central_difference(
    ...     structure, 2000.0, contact, periods=2, steps_per_period=steps)
    """
    request_arguments = structure, omega, contact, periods, steps_per_period
    request = MarchRequest.from_call(integrate_central_difference, options, *request_arguments)
    min_steps = stable_steps_per_period(structure, omega, contact)
    if steps_per_period < min_steps:
        allowed_text = f">= {min_steps}, as fewer steps make central differences unstable"
        raise InputError("steps_per_period", steps_per_period, allowed_text)
    has_kernel = is_small(structure) and (is_piecewise_linear(contact) or request.is_rigid)
    return march(request, (_ModalDifferences if has_kernel else _CentralDifferences)(request))


class _CreatedEnergyAccount:
    """Sums over time: energy created by contact, and energy from load and initial state.

    Contact creates energy if a pair opens or closes between two steps. The work of a force at step
    n is f_n (u_{n+1} - u_{n-1}) / 2: with this rule the scheme balances kinetic and elastic energy
    exactly. ``initial_energy`` [J] is elastic plus kinetic energy at time 0.
    """

    def __init__(self, request: MarchRequest, initial_energy: float) -> None:
        self._request, self._created_energy, self._energy_input = request, 0.0, initial_energy
        n_gap_rows, n_loaded = request.n_gap_rows, len(request.loaded_dofs)
        column_counts = n_loaded, n_gap_rows, n_gap_rows, n_loaded
        self._last_rows: list[np.ndarray] = [
            np.empty((0, n_columns)) for n_columns in column_counts
        ]

    def add_period(self, window: PeriodWindow) -> tuple[float, float]:
        """Add a load period and return the energies summed since time 0.

        Returns
        -------
        created_energy : float [J]
            Energy created by contact; negative if lost.
        energy_input : float [J]
            Initial energy, plus the absolute value of the load's work in every period.
        """
        period_arrays = (
            self._request.load_samples,
            window.gap,
            window.force,
            window.displacement_at_load,
        )
        extended_arrays = [
            np.vstack(row_blocks) for row_blocks in zip(self._last_rows, period_arrays, strict=True)
        ]
        self._last_rows = [extended_array[-2:] for extended_array in extended_arrays]
        extended_load, extended_gaps, extended_contact_forces, displacement_at_load = (
            extended_arrays
        )
        if friction_of(self._request.contact) is not None:  # tangents create none
            extended_gaps, _ = np.hsplit(extended_gaps, 2)
            extended_contact_forces, _ = np.hsplit(extended_contact_forces, 2)
        self._created_energy -= 0.5 * float(
            np.sum(extended_contact_forces[1:-1] * (extended_gaps[2:] - extended_gaps[:-2]))
        )
        if not self._request.is_rigid:
            first_spring_energies, spring_energies_at_period_end = (
                contact_energy(self._request.row_law, gaps_at_either_end)
                for gaps_at_either_end in (extended_gaps[:2], extended_gaps[-2:])
            )
            self._created_energy += 0.5 * float(
                spring_energies_at_period_end.sum() - first_spring_energies.sum()
            )
        local_load_work = np.array(
            [
                0.5
                * np.sum(
                    extended_load[1:-1] * (displacement_at_load[2:] - displacement_at_load[:-2])
                )
            ]
        )
        self._energy_input += abs(float(self._request.structure.sum_over_ranks(local_load_work)[0]))
        return self._created_energy, self._energy_input


def _last_velocity(
    step_size: float,
    last_increment: np.ndarray,
    acceleration_function: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return the velocity (n,) at the end of a time integration from its last increment.

    The velocity half a step before the end is ``last_increment``, u_n - u_{n-1}, divided by
    ``step_size``. The result adds the acceleration over half a step. ``acceleration_function``
    takes a velocity (n,) and returns the acceleration (n,) at the end.
    """
    mean_velocity = velocity = last_increment / step_size
    for _ in range(3):  # the acceleration depends on the velocity a little
        velocity = mean_velocity + 0.5 * step_size * acceleration_function(velocity)
    return velocity


# --- small structures, by the kernel --------------------------------------------------------------


class _ModalDifferences(Scheme):
    """Integrate a small structure in the coordinates of all modes, by the compiled kernel.

    A step needs A^-1, with the modal matrix A: mass plus dt / 2 times damping. If damping leaves
    the n modes uncoupled, damping and A^-1 are stored as diagonals (n,), otherwise as matrices (n,
    n).
    """

    name, remedy = SCHEME_NAME, MORE_STEPS_REMEDY

    def __init__(self, request: MarchRequest) -> None:
        self._structure_with_contact_rows = add_pair_for_each_contact_force(
            request.contact, request.structure
        )
        self._request, self._modes, dt = (
            request,
            all_modes(self._structure_with_contact_rows),
            request.step_size,
        )
        modes, (n_modes, n_rows) = self._modes, self._modes.gaps_by_mode.shape
        springs, friction_members = None, dict[str, Any]()
        if not request.is_rigid:
            springs = _contact_stiffnesses(request.structure, request.contact)
        if (mu := friction_coefficient_of(request.row_law)) is not None:
            assert springs is not None
            self._friction_solver = FrictionContactSolver(np.diag(1.0 / springs), mu)
            self._sticking_tangential_gaps = np.zeros(n_rows // 2)
            pair_states = np.zeros(n_rows // 2, dtype=np.int8)
            friction_members = {
                "friction_solver": self._friction_solver.handle,
                "sticking_places": self._sticking_tangential_gaps,
                "pair_states": pair_states,
            }
        self._modal_displacement, modal_velocity = (
            modes.shapes_inverse @ start_state_part for start_state_part in request.start_state[:2]
        )
        initial_gap = self._end_gaps()
        if friction_members:
            self._sticking_tangential_gaps[:] = (
                request.start_state[2] if request.start_state[2:] else initial_gap[n_rows // 2 :]
            )
        if request.is_rigid and np.any(initial_gap > 0.0):  # by the least change in the norm of M
            self._modal_displacement -= modes.gaps_by_mode @ solve_complementarity(
                modes.gaps_by_mode.T @ modes.gaps_by_mode, initial_gap
            )
        self._modal_displacement_increment = (
            dt * modal_velocity - 0.5 * dt** 2 * self._acceleration_at_phase_zero(modal_velocity)
        )
        initial_energy = 0.5 * float(
            modes.squares @ self._modal_displacement**2 + modal_velocity @ modal_velocity
        )
        self._energy_account = _CreatedEnergyAccount(request, initial_energy)
        identity = np.ones(n_modes) if modes.damping.ndim == 1 else np.eye(n_modes)
        damped_mass = identity + 0.5 * dt * modes.damping
        inverse = 1.0 / damped_mass if damped_mass.ndim == 1 else np.linalg.inv(damped_mass)
        force_response = (
            inverse[:, None] * modes.gaps_by_mode
            if inverse.ndim == 1
            else inverse @ modes.gaps_by_mode
        )
        increment_per_force = dt**2 * force_response
        contiguous = np.ascontiguousarray
        vibration_struct = Struct(
            "vibration", n_modes=n_modes, n_rows=n_rows, has_coupled_modes=modes.damping.ndim == 2,
            squared_frequencies=contiguous(modes.squares),
            clearance=np.array(self._structure_with_contact_rows.clearance, dtype=float),
            spring_stiffnesses=springs, gap_rows=contiguous(modes.gaps_by_mode.T),
            load_rows=contiguous(request.structure.force @ modes.shapes),
            load_basis=contiguous(request.load_basis), n_load_rows=len(request.structure.force),
            work=np.empty(2 * n_modes + n_rows), **friction_members,
        )  # fmt: skip
        self._kernel_struct = Struct(
            "central_differences", vibration=vibration_struct,
            increment_factor=2.0 * inverse - identity, force_factor=dt**2 * inverse,
            increment_per_force=contiguous(increment_per_force.T),
            contact_solver=(
                ActiveSetSolver(modes.gaps_by_mode.T @ increment_per_force).handle
                if request.is_rigid else None
            ),
            displacements=self._modal_displacement, increment=self._modal_displacement_increment,
            is_closed=np.zeros(n_rows, bool),
        )  # fmt: skip

    def _end_gaps(self) -> np.ndarray:
        """Return the gaps at the current modal displacement: (n_rows,) [m].

        Each contact force has a gap: normal gaps first, with friction then tangential gaps.
        """
        return np.asarray(
            self._modal_displacement @ self._modes.gaps_by_mode
            - self._structure_with_contact_rows.clearance
        )

    def _acceleration_at_phase_zero(self, velocity: np.ndarray) -> np.ndarray:
        """Return the modal acceleration f - w^2 q - P lambda - c v at phase zero of the load: (n,).

        f is the modal load, w the natural frequencies, c the modal damping, q and v are modal
        displacement and velocity, P lambda modal contact forces. Under UnilateralConstraint lambda
        is 0 here: the next step finds the forces.
        """
        modes, load_coefficients_of_dofs = self._modes, self._request.structure.force
        acceleration = (
            load_coefficients_of_dofs[0] + load_coefficients_of_dofs[1::2].sum(axis=0)
        ) @ modes.shapes - modes.squares * self._modal_displacement
        if not self._request.is_rigid:
            acceleration -= modes.gaps_by_mode @ self._penalty_forces_of_rows(self._end_gaps())
        return np.asarray(acceleration - modes.damping_force(velocity))

    def _penalty_forces_of_rows(self, gap: np.ndarray) -> np.ndarray:
        """Return contact forces (n_rows,) [N] from gaps (n_rows,) [m] by the penalty law.

        Normal gaps come first; with friction tangential gaps follow, and the forces have the same
        order. Friction forces also depend on the sticking places, tangential gaps of sticking
        pairs. This call does not change the sticking places.
        """
        if friction_of(self._request.contact) is None:
            return self._request.row_law.force(gap)
        return self._friction_solver.solve(gap[None], self._sticking_tangential_gaps)[0][0]

    def integrate_and_fill_period(self, window: PeriodWindow, period_number: int) -> None:
        modes, request, n_window_steps = self._modes, self._request, len(window.gap)
        n_steps_per_block = max(1, N_MODAL_COORDINATES_IN_CPU_CACHE // len(modes.squares))
        for first_step_of_block in range(0, n_window_steps, n_steps_per_block):
            step_block_slice = slice(
                first_step_of_block, min(first_step_of_block + n_steps_per_block, n_window_steps)
            )
            modal_displacement = np.empty(
                (step_block_slice.stop - first_step_of_block, len(modes.squares))
            )
            n_steps_made = kernel.march_central(
                self._kernel_struct.address, first_step_of_block, len(modal_displacement),
                pointer(window.gap[step_block_slice]), pointer(window.force[step_block_slice]),
                pointer(modal_displacement),
            )  # fmt: skip
            if n_steps_made < len(modal_displacement):
                raise ConvergenceError(
                    f"central differences: no contact forces were found at step"
                    f" {first_step_of_block + n_steps_made}; {self.remedy}"
                )
            window.recorded_displacement[step_block_slice] = (
                modal_displacement @ modes.shapes[request.recorded_dofs].T
            )
            window.displacement_at_load[step_block_slice] = (
                modal_displacement @ modes.shapes[request.loaded_dofs].T
            )
        self.set_created_energy_ratio(*self._energy_account.add_period(window))

    def final_state_parts(self) -> tuple[np.ndarray, ...]:
        modal_velocity = _last_velocity(
            self._request.step_size,
            self._modal_displacement_increment,
            self._acceleration_at_phase_zero,
        )
        has_friction = friction_of(self._request.contact) is not None
        return (
            self._modes.shapes @ self._modal_displacement,
            self._modes.shapes @ modal_velocity,
            *((self._sticking_tangential_gaps.copy(),) if has_friction else ()),
        )


# --- step by step ---------------------------------------------------------------------------------


class _CentralDifferences(Scheme):
    """Integrate a large structure by steps with the factored matrix A = M + dt/2 C (collective).

    M and C are the mass and damping matrices. For modal damping C = M Phi diag(c) Phi^T M only M is
    factored. With the damping rates c of the mass-normalised modes Phi and d = 1 + dt/2 c:

        A^-1 = M^-1 + Phi diag(1/d - 1) Phi^T,     A^-1 C = Phi diag(c/d) Phi^T M.
    """

    name, remedy = SCHEME_NAME, MORE_STEPS_REMEDY

    def __init__(self, request: MarchRequest) -> None:
        self.structure, dt = request.structure, request.step_size
        structure = self.structure
        self.contact, self.is_rigid, self.step_size = request.contact, request.is_rigid, dt
        self.load_samples, self.loaded_dofs = request.load_samples, request.loaded_dofs
        self._row_law = request.row_law
        self.contact_force = np.zeros(request.n_gap_rows)
        # Only few rows of B are not zero.
        structure_with_contact_rows = add_pair_for_each_contact_force(request.contact, structure)
        self._contact_dofs = np.flatnonzero(np.diff(structure_with_contact_rows.gap.indptr))
        self._contact_dof_gap_matrix = structure_with_contact_rows.gap[self._contact_dofs].toarray()
        self._clearance = structure_with_contact_rows.clearance
        if (mu := friction_coefficient_of(request.row_law)) is not None:
            self._friction_solver = FrictionContactSolver(
                np.diag(1.0 / _contact_stiffnesses(structure, request.contact)), mu
            )
        self._recorded_local_dofs = request.recorded_dofs - structure.first_dof
        self._modes, self._damping_matrix = (
            modes_with_modal_damping(structure),
            structure.damping_matrix,
        )
        self._input_vector, self._output_vector = structure.mass.createVecs()
        damped_mass = structure.mass
        if self._damping_matrix is not None:
            damped_mass = matrix_plus_weighted_matrix(
                structure.mass, 0.5 * dt, self._damping_matrix
            )
        # A C that was given need not be symmetric.
        is_symmetric = self._damping_matrix is None or isinstance(
            structure.damping, RayleighDamping
        )
        self._factored_damped_mass = Factor(damped_mass, symmetric=is_symmetric, definite=True)
        owned_matrices = () if self._damping_matrix is None else (damped_mass,)
        self.petsc_objects = (
            self._input_vector,
            self._output_vector,
            self._factored_damped_mass,
            *owned_matrices,
        )
        if self._modes is not None:
            modal_damped_mass = 1.0 + 0.5 * dt * self._modes.damping_rates
            self._modal_inverse_correction, self._modal_decay = (
                1.0 / modal_damped_mass - 1.0,
                self._modes.damping_rates / modal_damped_mass,
            )
        if self.is_rigid:
            self._displacement_per_force, zero_velocity = (
                dt**2 * structure.gap.toarray(),
                np.zeros(structure.n_local),
            )
            for response_column in self._displacement_per_force.T:
                response_column[:] = self._solve_with_damped_mass(response_column, zero_velocity)
            self._pair_compliance = structure.apply_bt(self._displacement_per_force.T).T
        displacement, velocity = request.start_state[:2]
        self.displacement = self._nearest_admissible_displacement(displacement)
        if friction_of(self.contact) is not None:
            _, initial_tangential_gap = np.split(self._gap_of(displacement), 2)
            self._sticking_tangential_gaps = (
                request.start_state[2] if request.start_state[2:] else initial_tangential_gap
            )
        # The step before from u_{-1} = u - dt v + dt^2 a / 2.
        self.increment = dt * velocity - 0.5 * dt**2 * self._acceleration_at_phase_zero(velocity)
        self._energy_account = _CreatedEnergyAccount(request, self._linear_energy(velocity))

    def integrate_and_fill_period(self, window: PeriodWindow, period_number: int) -> None:
        for step_index in range(len(window.gap)):
            displacement = self.displacement
            self.advance(step_index)
            window.gap[step_index], window.force[step_index] = self.gap, self.contact_force
            window.displacement_at_load[step_index] = displacement[self.loaded_dofs]
            window.recorded_displacement[step_index] = displacement[self._recorded_local_dofs]
        self.set_created_energy_ratio(*self._energy_account.add_period(window))

    def final_state_parts(self) -> tuple[np.ndarray, ...]:
        velocity = _last_velocity(self.step_size, self.increment, self._acceleration_at_phase_zero)
        has_friction = friction_of(self.contact) is not None
        return (
            self.displacement.copy(),
            velocity,
            *((self._sticking_tangential_gaps.copy(),) if has_friction else ()),
        )

    def advance(self, step_index: int) -> None:
        """Integrate a step and update displacement, gap and contact force.

        The step begins at instant ``step_index`` of the load period.
        """
        dt = self.step_size
        scaled_net_force = dt**2 * self._load_minus_elastic_and_contact_force(step_index)
        self.increment = self.increment + self._solve_with_damped_mass(
            scaled_net_force, dt * self.increment
        )
        if self.is_rigid:
            next_gap = self.gap + self._gap_change(self.increment)
            self.contact_force = solve_complementarity(
                self._pair_compliance, next_gap, self.contact_force > 0.0
            )
            self.increment -= self._displacement_per_force @ self.contact_force
        self.displacement = self.displacement + self.increment

    def _load_minus_elastic_and_contact_force(self, step_index: int) -> np.ndarray:
        """Return load less elastic and contact forces, f - K u - B lambda: (n_local,) [N].

        f is the load at instant ``step_index`` of the period, u the current displacement. Under
        UnilateralConstraint B lambda is left out: :meth:`advance` finds lambda. Gap and, under a
        penalty law, contact force are updated.
        """
        self.gap = self._gap_of(self.displacement)
        net_force = -self._apply_operator(self.structure.stiffness.mult, self.displacement)
        net_force[self.loaded_dofs] += self.load_samples[step_index]
        if not self.is_rigid:
            self.contact_force = self._penalty_forces_of_rows(self.gap)
            net_force[self._contact_dofs] -= self._contact_dof_gap_matrix @ self.contact_force
        return net_force

    def _penalty_forces_of_rows(self, gap: np.ndarray) -> np.ndarray:
        """Return contact forces (n_rows,) [N] from gaps (n_rows,) [m] by the penalty law.

        Normal gaps come first; with friction tangential gaps follow, and the forces have the same
        order. Friction forces also depend on the sticking places, tangential gaps of sticking
        pairs. This call updates the sticking places.
        """
        if friction_of(self.contact) is None:
            return self._row_law.force(gap)
        forces, _, sticking_places, _ = self._friction_solver.solve(
            gap[None], self._sticking_tangential_gaps
        )
        self._sticking_tangential_gaps = sticking_places[0]
        return forces[0]

    def _gap_change(self, displacement: np.ndarray) -> np.ndarray:
        """Return the gaps' change by a displacement u: (n_rows,) [m].

        The change is B^T u. The matrix B takes contact forces to forces on the dofs.
        ``displacement`` (n_local,) [m] is this rank's part of u; the result is summed over ranks.
        """
        return self.structure.sum_over_ranks(
            displacement[self._contact_dofs] @ self._contact_dof_gap_matrix
        )

    def _gap_of(self, displacement: np.ndarray) -> np.ndarray:
        """Return the gaps at a displacement (n_local,) [m], clearance included: (n_rows,) [m].

        A gap is positive if the crack faces penetrate, and minus the clearance at zero
        displacement.
        """
        return self._gap_change(displacement) - self._clearance

    def _apply_operator(
        self, operator: Callable[[Any, Any], None], vector: np.ndarray
    ) -> np.ndarray:
        """Apply a PETSc operator to a vector (n_local,) and return the result (n_local,).

        ``operator`` takes two PETSc vectors: the first is read, the second written. Examples are
        the product with a matrix, and the solution by factors of a matrix.
        """
        self._input_vector.array_w[:] = vector
        operator(self._input_vector, self._output_vector)
        return self._output_vector.array_r.copy()

    def _solve_with_damped_mass(self, force: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Return the acceleration A^-1 (r - C v), with A = M + dt/2 C: (n_local,) [m/s^2].

        M and C are the mass and damping matrices, and dt is the step. ``force`` (n_local,) [N] is
        r, ``velocity`` (n_local,) [m/s] is v.
        """
        modes = self._modes
        if modes is None:
            return self._apply_operator(
                self._factored_damped_mass.apply, force - self._damping_force(velocity)
            )
        mass_times_velocity = self._apply_operator(self.structure.mass.mult, velocity)
        local_modal_parts = np.stack([force @ modes.shapes, mass_times_velocity @ modes.shapes])
        modal_force, modal_velocity = self.structure.sum_over_ranks(local_modal_parts)
        acceleration = self._apply_operator(self._factored_damped_mass.apply, force)
        return acceleration + modes.shapes @ (
            self._modal_inverse_correction * modal_force - self._modal_decay * modal_velocity
        )

    def _damping_force(self, velocity: np.ndarray) -> np.ndarray:
        """Return the damping force C v for a velocity v (n_local,) [m/s]: (n_local,) [N]."""
        if self._damping_matrix is not None:
            return self._apply_operator(self._damping_matrix.mult, velocity)
        if self._modes is None:
            return np.zeros_like(velocity)
        modal_velocity = self.structure.sum_over_ranks(velocity @ self._modes.mass_shapes)
        return self._modes.mass_shapes @ (self._modes.damping_rates * modal_velocity)

    def _acceleration_at_phase_zero(self, velocity: np.ndarray) -> np.ndarray:
        """Return the acceleration at phase zero of the load: (n_local,) [m/s^2].

        The acceleration is M^-1 (f - K u - B lambda - C v), with load f, current displacement u,
        contact forces lambda and ``velocity`` v (n_local,). Under UnilateralConstraint lambda is 0
        here: the next step finds the forces.
        """
        force = self._load_minus_elastic_and_contact_force(0) - self._damping_force(velocity)
        with Factor(self.structure.mass, definite=True) as factored_mass:
            return np.asarray(factored_mass.solve(force[None])[0])

    def _linear_energy(self, velocity: np.ndarray) -> float:
        """Return elastic plus kinetic energy without contact springs, over all ranks [J].

        The energy is (u^T K u + v^T M v) / 2, with stiffness K and mass M. u is the current
        displacement, and v is ``velocity`` (n_local,) [m/s].
        """
        structure = self.structure
        matrices_and_vectors = (structure.stiffness, self.displacement), (structure.mass, velocity)
        local_energy = 0.5 * sum(
            vector @ multiply_columns(matrix, vector[:, None])[:, 0]
            for matrix, vector in matrices_and_vectors
        )
        return float(structure.sum_over_ranks(np.array([local_energy]))[0])

    def _nearest_admissible_displacement(self, displacement: np.ndarray) -> np.ndarray:
        """Return the nearest displacement without penetration: (n_local,) [m].

        Used for the start under UnilateralConstraint. The change d of the given ``displacement``
        has the smallest d^T M d, with the mass matrix M. The given displacement is returned under a
        penalty law, or if no pair penetrates.
        """
        gap = self._gap_of(displacement)
        if not self.is_rigid or not np.any(gap > 0.0):
            return displacement
        with Factor(self.structure.mass, definite=True) as factored_mass:
            displacement_per_force = factored_mass.solve(self.structure.gap.T.toarray())
        return (
            displacement
            - solve_complementarity(self.structure.apply_bt(displacement_per_force), gap)
            @ displacement_per_force
        )
