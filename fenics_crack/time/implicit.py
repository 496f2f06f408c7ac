"""Direct integration in time by the generalised-alpha method, with contact implicit in the step.

    M u'' + C u' + K u + B lambda = f(t)

Displacement u, velocity v and acceleration a advance by Newmark's formulas,

    u_{n+1} = u_n + dt v_n + dt^2 ((1/2 - beta) a_n + beta a_{n+1}),
    v_{n+1} = v_n + dt ((1 - gamma) a_n + gamma a_{n+1}),

and the equation of motion holds between both ends of the step,

    M a_{n+1-am} + C v_{n+1-af} + K u_{n+1-af} + B h = f_{n+1-af},
    x_{n+1-s} = (1 - s) x_{n+1} + s x_n,

    am = (2 rho - 1)/(rho + 1),  af = rho/(rho + 1),  gamma = 1/2 - am + af,
    beta = (1 - am + af)^2 / 4,

with rho the spectral radius at infinite frequency: 1 loses no energy, 0 wipes out in one step what
the step cannot resolve. Without contact the scheme is of second order and stable whatever the step.

The matrix A = (1 - am) M + (1 - af) (gamma dt C + beta dt^2 K) is factored once. Modal damping
C = M Phi diag(c) Phi^T M enters by its low rank: with D the part of A without damping, d_j its
value on mode j, and e = (1 - af) gamma dt,

    A^-1 = D^-1 + Phi diag(1/(d + e c) - 1/d) Phi^T.

The contact force of the step is taken from the potential V of the law, lambda = dV/dg,

    h = (V(g_{n+1}) - V(g_n)) / (g_{n+1} - g_n) + (1/2 - af) (lambda_{n+1} - lambda_n),

where both ends are closed by the penalty law nothing but lambda_{n+1-af}. So contact that begins or
ends within a step creates no energy: h (g_{n+1} - g_n) is at least the change of V, and with
rho = 1 the balance of energy is exact. Averaged forces would feed stiff contact. The gap at the end
of the step is linear in h, with a small dense compliance that does not change,

    g_{n+1} = g_free - beta dt^2 B^T A^-1 B h(g_{n+1}),

a problem in the pairs alone (:mod:`fenics_crack.time.complementarity`).

A constraint (:class:`UnilateralConstraint`) acts by impulses p = dt lambda at the start of a step
and q at its end, each by the change of velocity (1 - am) D^-1 B, which is M^-1 B but for what the
step does not resolve; the step between is the linear one without contact:

    v_n+ = v_n - (1 - am) D^-1 B p,                0 <= p,  g_{n+1} <= 0,        complementary,
    v_{n+1} = v_{n+1}- - (1 - am) D^-1 B q,        0 <= q,  B^T v_{n+1} <= 0,    complementary,

the second for the pairs with p > 0. So nothing penetrates, and an impact is without rebound, as in
:mod:`fenics_crack.time.march`; averaged forces of a constraint would swing from step to step, and
the rebound would depend on where in the step the impact falls. This part is of first order in dt
where C couples closed pairs to other dofs and rho < 1; elsewhere second order is observed.

Sources: Chung and Hulbert, Journal of Applied Mechanics 60 (1993) 371; for the potential's
quotient, Simo and Tarnow, Zeitschrift fuer angewandte Mathematik und Physik 43 (1992) 757.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from petsc4py import PETSc

from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.errors import ConvergenceError, InputError, check_number, check_omega
from fenics_crack.model.contact import ContactLaw, UnilateralConstraint, check_law
from fenics_crack.model.factor import weighted_sum
from fenics_crack.model.modes import damped_modes
from fenics_crack.model.structure import Structure
from fenics_crack.time.complementarity import solve_complementarity, solve_forces
from fenics_crack.time.march import (
    Recorder,
    TimeHistory,
    check_march,
    dofs_to_record,
    gap_block,
    initial_state,
    inverse_of,
    linear_energy,
    load_waves,
    march,
    moved_apart,
    solve_columns,
)

__all__ = ["integrate_implicit"]


def integrate_implicit(
    structure: Structure,
    omega: float,
    contact: ContactLaw | UnilateralConstraint,
    *,
    periods: int,
    steps_per_period: int,
    spectral_radius: float = 0.8,
    initial: PeriodicSolution | tuple[np.ndarray, np.ndarray] | None = None,
    settle: float = 0.0,
    record_periods: int | None = None,
    record_dofs: Sequence[int] | None = None,
    progress: bool = False,
) -> TimeHistory:
    """March the equation of motion by steps as long as accuracy allows (collective).

    Parameters
    ----------
    structure : Structure
        What vibrates.
    omega : float
        Angular frequency of the load [rad/s].
    contact : ContactLaw or UnilateralConstraint
        Law of all pairs; its force may not fall where the gap grows.
    periods : int
        Load periods to march.
    steps_per_period : int
        Steps in one load period.
    spectral_radius : float
        rho from 0 to 1: what is left after a step of the fastest vibrations.
    initial : PeriodicSolution, (displacement, velocity) or None
        State at time 0: a solution's, two arrays (n_local,) [m], [m/s], or rest. With a constraint,
        pairs that penetrate are moved apart by the least change in the norm of M.
    settle : float
        Stop early when the relative change over a period is below this.
    record_periods : int, optional
        Keep only the last so many periods; default: all.
    record_dofs : sequence of int, optional
        Record only these displacements; default: all. A reduced structure records all.
    progress : bool
        Show a progress bar.

    Returns
    -------
    TimeHistory
        Instants n dt, n = 0, 1, ...; ``created_energy`` is the energy balance's residual: the
        energy at the end and that lost in C, less the energy at the start and the load's work.

    Raises
    ------
    InputError
        An argument cannot be used, or the history would not fit in memory.
    ConvergenceError
        The contact forces of a step were not found, or the scheme creates more energy than the
        load puts in: the steps are too long for this contact.

    Notes
    -----
    Two columns of n_local numbers are kept for each pair.

    Source: the module's text.
    """
    check_march(periods, steps_per_period, record_periods, settle)
    check_omega(omega)
    check_number("spectral_radius", spectral_radius, 0.0)
    if spectral_radius > 1.0:
        raise InputError("spectral_radius", spectral_radius, "a number from 0 to 1")
    if not isinstance(contact, UnilateralConstraint):
        check_law(structure, contact)
    displacement, velocity = initial_state(structure, initial)
    wanted = dofs_to_record(structure, record_dofs, "record_dofs")
    recorder = Recorder(structure, wanted, periods, record_periods, steps_per_period)
    scheme = _GeneralisedAlpha(structure, omega, contact, steps_per_period, float(spectral_radius))
    scheme.start(displacement, velocity)
    return march(recorder, scheme, omega, settle, "generalised alpha", hidden=not progress)


class _GeneralisedAlpha:
    """State and one step of the scheme, and its energy; what does not change is prepared once."""

    def __init__(
        self,
        structure: Structure,
        omega: float,
        contact: ContactLaw | UnilateralConstraint,
        steps_per_period: int,
        radius: float,
    ) -> None:
        self.structure, self.contact = structure, contact
        self.step_size = dt = 2.0 * np.pi / omega / steps_per_period
        self._am = (2.0 * radius - 1.0) / (radius + 1.0)
        self._af = radius / (radius + 1.0)
        self._gamma = 0.5 - self._am + self._af
        self._beta = 0.25 * (1.0 - self._am + self._af) ** 2
        self._inertia, self._now = 1.0 - self._am, 1.0 - self._af
        self.displacement, self.velocity, self.acceleration = np.zeros((3, structure.n_local))
        self.before = self.displacement
        self.force = np.zeros(structure.n_pairs)
        """At the instant that :meth:`advance` has started from."""
        self._x, self._y = structure.mass.createVecs()
        self._gap_rows, self._gap_block = gap_block(structure)
        self.load_rows, self.load = load_waves(structure, steps_per_period)
        self._load_means = 0.5 * (self.load + np.roll(self.load, -1, axis=0))

        self._modes = damped_modes(structure)
        self._damping = structure.damping_matrix
        spring, dashpot = self._now * self._beta * dt**2, self._now * self._gamma * dt
        matrix = structure.mass.copy()
        matrix.scale(self._inertia)
        parts = [(spring, structure.stiffness)]
        if self._damping is not None:
            parts.append((dashpot, self._damping))
        for weight, part in parts:
            total = weighted_sum(matrix, weight, part)
            matrix.destroy()
            matrix = total
        self._matrix = matrix
        self._inverse = inverse_of(matrix, symmetric=self._damping is None)
        if self._modes is not None:
            undamped = self._inertia + spring * self._modes.omega**2
            self._modal = undamped + dashpot * self._modes.rate
            self._correction = 1.0 / self._modal - 1.0 / undamped
        self._prepare_contact()

    def _prepare_contact(self) -> None:
        """Change of acceleration by unit forces or impulses, of velocity, and the gaps' change."""
        structure, dt = self.structure, self.step_size
        self._kick: np.ndarray | None = None
        pairs = structure.gap.toarray()
        if isinstance(self.contact, UnilateralConstraint):
            kick = self._kicks(pairs)
            right = np.empty_like(kick)
            for column in range(structure.n_pairs):
                # C v of the whole step, K u of the end.
                right[:, column] = self._damped(kick[:, column]) + self._now * dt * self._times(
                    structure.stiffness, kick[:, column]
                )
            self._kick, self._rates = kick, structure.closing(kick.T).T
            self._pull = self._solve(right)
            moved = dt * kick - dt**2 * self._beta * self._pull
        else:
            self._pull = -self._solve(pairs)
            moved = -(dt**2) * self._beta * self._pull
        self._compliance = structure.closing(moved.T).T
        if self._modes is not None:
            self._modal_pull = structure.sum_over_ranks(self._modes.mass_shapes.T @ self._pull)
            if self._kick is not None:
                self._modal_kick = structure.sum_over_ranks(self._modes.mass_shapes.T @ self._kick)

    def _kicks(self, pairs: np.ndarray) -> np.ndarray:
        """(1 - am) D^-1 B: change of velocity by unit impulses."""
        structure = self.structure
        if self._damping is None:
            return self._inertia * solve_columns(self._inverse, self._matrix, pairs)
        weight = self._now * self._beta * self.step_size**2 / self._inertia
        undamped = weighted_sum(structure.mass, weight, structure.stiffness)
        inverse = inverse_of(undamped, symmetric=True)
        kick = solve_columns(inverse, undamped, pairs)
        inverse.destroy()
        undamped.destroy()
        return kick

    def start(self, displacement: np.ndarray, velocity: np.ndarray) -> None:
        """Set the state at time 0; the acceleration follows from the equation of motion."""
        structure = self.structure
        constrained = isinstance(self.contact, UnilateralConstraint)
        if constrained:
            displacement = moved_apart(structure, displacement)
        self.displacement, self.velocity = displacement.copy(), velocity.copy()
        self.gap = self._measured(self.displacement)
        right = -self._times(structure.stiffness, displacement) - self._damped(velocity)
        right[self.load_rows] += self.load[0]
        if not constrained:
            self.force = self.contact.force(self.gap)  # type: ignore[union-attr]
            right[self._gap_rows] -= self._gap_block @ self.force
            self._held = self.force
        inverse = inverse_of(structure.mass, symmetric=True)
        self.acceleration = solve_columns(inverse, structure.mass, right[:, None])[:, 0]
        inverse.destroy()
        if self._modes is not None:
            both = np.vstack([self.velocity, self.acceleration]) @ self._modes.mass_shapes
            self._modal_velocity, self._modal_acceleration = structure.sum_over_ranks(both)
        self._work = self._lost = self._created = 0.0
        self._first_energy = self._put_in = self._energy()

    def advance(self, step: int) -> None:
        """March from this instant, ``step`` of the period, to the next."""
        dt, structure, modes = self.step_size, self.structure, self._modes
        following = (step + 1) % len(self.load)
        self.gap = self._measured(self.displacement)
        self.before = self.displacement

        moved = self.displacement + dt * self.velocity
        moved += (dt**2 * (0.5 - self._beta)) * self.acceleration
        faster = self.velocity + (dt * (1.0 - self._gamma)) * self.acceleration
        right = -self._times(
            structure.stiffness, self._now * moved + self._af * self.displacement
        ) - self._times(structure.mass, self._am * self.acceleration)
        right[self.load_rows] += self._now * self.load[following] + self._af * self.load[step]
        if modes is not None:
            modal_faster = self._modal_velocity + (
                dt * (1.0 - self._gamma) * self._modal_acceleration
            )
            drag = modes.rate * (self._now * modal_faster + self._af * self._modal_velocity)
            pushed = structure.sum_over_ranks(right @ modes.shapes)
            modal_found = (pushed - drag) / self._modal
            # D^-1 (r - M Phi drag) = D^-1 r - Phi drag / d, and the correction's part of both.
            found = self._apply(right)
            found += modes.shapes @ (self._correction * pushed - drag / self._modal)
        else:
            if self._damping is not None:
                right -= self._damped(self._now * faster + self._af * self.velocity)
            found = self._apply(right)

        free = self._measured(moved + (self._beta * dt**2) * found)
        kicked = self.velocity
        if self._kick is None:
            impulse = self._forces(free)
            found += self._pull @ impulse
        else:
            impulse = solve_complementarity(self._compliance, free, self.force > 0.0)
            found += self._pull @ impulse
            change = self._kick @ impulse
            kicked = self.velocity - change
            faster -= change
            moved -= dt * change
        self.displacement = moved + (self._beta * dt**2) * found
        velocity = faster + (self._gamma * dt) * found
        stop = self._stopped(velocity, impulse) if self._kick is not None else None
        if modes is not None:
            modal_found += self._modal_pull @ impulse
            modal_kicked = self._modal_velocity
            if self._kick is not None:
                change = self._modal_kick @ impulse
                modal_kicked = modal_kicked - change
                modal_faster -= change
            self._modal_velocity = modal_faster + self._gamma * dt * modal_found
            self._modal_acceleration = modal_found
            mean = 0.5 * (modal_kicked + self._modal_velocity)
            self._lost += dt * float(modes.rate @ mean**2)
        elif self._damping is not None:
            means = 0.5 * (kicked + velocity)
            lost = np.array([means @ self._damped(means)])
            self._lost += dt * float(structure.sum_over_ranks(lost)[0])
        if self._kick is not None:
            self.force = (impulse + stop) / dt
            velocity -= self._kick @ stop
            if modes is not None:
                self._modal_velocity = self._modal_velocity - self._modal_kick @ stop
        self.velocity, self.acceleration = velocity, found

    def _forces(self, free: np.ndarray) -> np.ndarray:
        """h of a step from the present gap, its end where there are no contact forces given."""
        contact, start = self.contact, self.gap
        assert not isinstance(contact, UnilateralConstraint)
        self.force = force = contact.force(start)
        shift = 0.5 - self._af

        def response(gap: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            mean, slope = _mean_force(contact, start, gap)
            mean += shift * (contact.force(gap) - force)
            return mean, slope + shift * contact.tangent(gap)

        self._held = solve_forces(response, self._compliance, free, self._held)
        return self._held

    def _stopped(self, velocity: np.ndarray, impulse: np.ndarray) -> np.ndarray:
        """Impulses that keep pairs which are closed at the end of a step from closing further."""
        stop = np.zeros_like(impulse)
        closed = np.flatnonzero(impulse > 0.0)
        if len(closed):
            rates = self.structure.sum_over_ranks(velocity[self._gap_rows] @ self._gap_block)
            stop[closed] = solve_complementarity(self._rates[np.ix_(closed, closed)], rates[closed])
        return stop

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        """Displacement and velocity."""
        return self.displacement.copy(), self.velocity.copy()

    # --- energy -----------------------------------------------------------------------------------

    def close_period(self, gap: np.ndarray, force: np.ndarray, load_motion: np.ndarray) -> None:
        """Book a period; an error where it has created too much energy."""
        ahead = np.vstack([load_motion[1:], self.displacement[self.load_rows]])
        work = np.array([np.sum(self._load_means * (ahead - load_motion))])
        gained = float(self.structure.sum_over_ranks(work)[0])
        self._work += gained
        self._put_in += abs(gained)
        self._created = self._energy() + self._lost - self._first_energy - self._work
        if not np.isfinite(self._created) or self._created > 2.0 * self._put_in > 0.0:
            raise ConvergenceError(
                "generalised alpha: the steps are too long for this contact, which creates "
                f"{self.created_share:.3g} times the energy put in; take more steps per period or "
                "a smaller spectral radius"
            )

    @property
    def created_share(self) -> float:
        """Residual of the energy balance relative to the energy put in."""
        return self._created / self._put_in if self._put_in > 0.0 else 0.0

    def _energy(self) -> float:
        """Kinetic, elastic, and contact energy at this instant."""
        energy = linear_energy(self.structure, self.displacement, self.velocity)
        if not isinstance(self.contact, UnilateralConstraint):
            gap = self._measured(self.displacement)
            energy += float(_potential(self.contact, gap).sum())
        return energy

    # --- linear algebra ---------------------------------------------------------------------------

    def _measured(self, displacement: np.ndarray) -> np.ndarray:
        """Gap of a displacement."""
        closing = displacement[self._gap_rows] @ self._gap_block
        return self.structure.sum_over_ranks(closing) - self.structure.clearance

    def _times(self, matrix: PETSc.Mat, rows: np.ndarray) -> np.ndarray:
        """A matrix times (n_local,)."""
        self._x.array_w[:] = rows
        matrix.mult(self._x, self._y)
        return self._y.array_r.copy()

    def _apply(self, rows: np.ndarray) -> np.ndarray:
        """The factored matrix's inverse times (n_local,)."""
        self._x.array_w[:] = rows
        self._inverse.apply(self._x, self._y)
        return self._y.array_r.copy()

    def _solve(self, columns: np.ndarray) -> np.ndarray:
        """A^-1 X of columns (n_local, m)."""
        found = solve_columns(self._inverse, self._matrix, columns)
        if self._modes is not None:
            pushed = self.structure.sum_over_ranks(self._modes.shapes.T @ columns)
            found += self._modes.shapes @ (self._correction[:, None] * pushed)
        return found

    def _damped(self, velocity: np.ndarray) -> np.ndarray:
        """C v."""
        if self._damping is not None:
            return self._times(self._damping, velocity)
        if self._modes is None:
            return np.zeros_like(velocity)
        modal = self.structure.sum_over_ranks(velocity @ self._modes.mass_shapes)
        return self._modes.mass_shapes @ (self._modes.rate * modal)

    def free(self) -> None:
        """Free PETSc's objects (collective)."""
        for item in (self._x, self._y, self._inverse, self._matrix):
            item.destroy()


_GAUSS = np.polynomial.legendre.leggauss(8)
_POINTS, _WEIGHTS = 0.5 * (1.0 + _GAUSS[0]), 0.5 * _GAUSS[1]


def _potential(contact: ContactLaw, gap: np.ndarray) -> np.ndarray:
    """V(g), the integral of lambda from 0, by Gauss's rule: (n_pairs,) [J]."""
    return gap * (_WEIGHTS @ contact.force(_POINTS[:, None] * gap))


def _mean_force(
    contact: ContactLaw, start: np.ndarray, end: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(V(end) - V(start)) / (end - start) and its derivative by the end: (n_pairs,) each.

    On one side of g = 0, where laws have their kink, from the mean of lambda.
    """
    change = end - start
    between = start + _POINTS[:, None] * change
    mean = _WEIGHTS @ contact.force(between)
    slope = (_WEIGHTS * _POINTS) @ contact.tangent(between)
    crosses = start * end < 0.0
    if np.any(crosses):
        length = np.where(crosses, change, 1.0)
        split = (_potential(contact, end) - _potential(contact, start)) / length
        mean = np.where(crosses, split, mean)
        slope = np.where(crosses, (contact.force(end) - split) / length, slope)
    return mean, slope
