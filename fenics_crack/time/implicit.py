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

with rho the spectral radius at infinite frequency: 1 loses no energy, 0 removes in one step what
the step cannot resolve. Without contact the scheme is of second order and stable for any step.

The matrix A = (1 - am) M + (1 - af) (gamma dt C + beta dt^2 K) is factored once.

The contact force of the step is taken from the potential V of the law, lambda = dV/dg,

    h = (V(g_{n+1}) - V(g_n)) / (g_{n+1} - g_n) + (1/2 - af) (lambda_{n+1} - lambda_n),

which for the penalty law is lambda_{n+1-af} where both ends are closed. So contact that begins or
ends within a step creates no energy, as averaged forces would: h (g_{n+1} - g_n) is at least the
change of V, and with rho = 1 the balance of energy is exact. The gap at the end of the step is
linear in h, with a small dense compliance that does not change,

    g_{n+1} = g_free - beta dt^2 B^T A^-1 B h(g_{n+1}),

a problem in the pairs alone (:mod:`fenics_crack.model.contact`).

A constraint (:class:`UnilateralConstraint`) acts by impulses p = dt lambda at the start of a step
and q at its end, each by the change of velocity (1 - am) D^-1 B, which is M^-1 B but for what the
step does not resolve; the step between is the linear one without contact:

    v_n+ = v_n - (1 - am) D^-1 B p,                0 <= p,  g_{n+1} <= 0,        complementary,
    v_{n+1} = v_{n+1}- - (1 - am) D^-1 B q,        0 <= q,  B^T v_{n+1} <= 0,    complementary,

the second for the pairs with p > 0. So nothing penetrates, and an impact is without rebound, as in
:mod:`fenics_crack.time.central_differences`; averaged forces of a constraint would swing from step
to step, and the rebound would depend on where in the step the impact falls. This part is of first
order in dt where C couples closed pairs to other dofs and rho < 1; elsewhere second order is
observed.

Small structures are integrated in the coordinates of all their modes by the kernel, under the
penalty law or a constraint (``kernel/implicit.c``).

Sources: Chung and Hulbert, Journal of Applied Mechanics 60 (1993) 371; for the potential's
quotient, Simo and Tarnow, Zeitschrift fuer angewandte Mathematik und Physik 43 (1992) 757.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError, check_number
from fenics_crack.kernel import Struct, kernel
from fenics_crack.model.contact import (
    MAX_NEWTON,
    ActiveSets,
    ContactLaw,
    gauss,
    is_piecewise_linear,
    is_regular,
    potential,
    solve_complementarity,
    solve_forces,
)
from fenics_crack.model.factor import factored_sum
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.reduced import INSTEAD, check_mass
from fenics_crack.model.structure import Structure
from fenics_crack.time.march import EnergyBalance, LoopedSteps, March, TimeHistory, Window, march
from fenics_crack.time.modal_march import ModalSteps, times_by_mode

NAME = "generalised alpha"
REMEDY = "take more steps per period or a smaller spectral radius"


def integrate_implicit(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    *,
    periods: int,
    steps_per_period: int,
    spectral_radius: float = 0.8,
    **options: Any,
) -> TimeHistory:
    """Integrate by the generalised-alpha method, by steps as long as accuracy allows (collective).

    Parameters
    ----------
    structure, omega, contact, periods, steps_per_period, **options
        As in :class:`fenics_crack.time.march.March`; the contact force may not fall where the gap
        grows. With a constraint, pairs that penetrate in the initial state are moved apart by the
        least change in the norm of M.
    spectral_radius : float
        rho from 0 to 1: what is left after a step of the fastest vibrations.

    Returns
    -------
    TimeHistory
        ``created_energy`` is the residual of the energy balance: the energy at the end and that
        lost in C, less the energy at the start and the load's work.

    Raises
    ------
    InputError
        An argument cannot be used, or the crack faces have no mass.
    ConvergenceError
        The contact forces of a step were not found, or the scheme creates more energy than the
        load puts in: the steps are too long for this contact.

    Notes
    -----
    Two columns of n_local numbers are kept for each pair.

    Source: Chung and Hulbert, Journal of Applied Mechanics 60 (1993) 371-375.

    Examples
    --------
    >>> history = fc.integrate_implicit(
    ...     structure, 2000.0, contact, periods=2, steps_per_period=400)
    """
    check_mass(structure, INSTEAD)
    check_number("spectral_radius", spectral_radius, 0.0)
    if spectral_radius > 1.0:
        raise InputError("spectral_radius", spectral_radius, "a number from 0 to 1")
    given = structure, omega, contact, periods, steps_per_period
    asked = March.of(integrate_implicit, options, *given)
    scheme = _ModalAlpha if _is_compiled(asked) else _GeneralisedAlpha
    return march(asked, scheme(asked, float(spectral_radius)))


def _is_compiled(asked: March) -> bool:
    """Return True if the kernel makes the steps: it has two laws, and of a constraint, forces that
    follow from the gaps alone."""
    if not is_small(asked.structure):
        return False
    if not asked.rigid:
        return is_piecewise_linear(asked.contact)
    pairs = all_modes(asked.structure).pairs
    return is_regular(pairs.T @ pairs)


def _parameters(radius: float) -> tuple[float, float, float, float]:
    """am, af, gamma and beta."""
    am, af = (2.0 * radius - 1.0) / (radius + 1.0), radius / (radius + 1.0)
    return am, af, 0.5 - am + af, 0.25 * (1.0 - am + af) ** 2


class _ModalAlpha(ModalSteps):
    """State of a small structure in modal coordinates, integrated by the kernel."""

    name, remedy = NAME, REMEDY

    def __init__(self, asked: March, radius: float) -> None:
        super().__init__(asked)
        modes, (count, pairs), self._velocity = self._modes, self._modes.pairs.shape, self._begin()
        held = np.zeros(pairs) if asked.rigid else asked.contact.force(self._gap())
        am, af, gamma, beta = _parameters(radius)
        self._known = Struct(
            "generalised_alpha", body=self._body(), instants=asked.steps_per_period,
            dt=asked.step_size, am=am, af=af, gamma=gamma, beta=beta,
            damping=np.ascontiguousarray(modes.damping), most=MAX_NEWTON,
            shape=self._shape, velocity=self._velocity, held=held, lost=0.0,
            change=self._acceleration(self._velocity), closed=np.zeros(2 * pairs, bool),
            room=np.empty(5 * count + (7 + pairs) * pairs), pivots=np.empty(pairs, np.intc),
            **self._answers(1.0 - am, 1.0 - af, gamma, beta),
        )  # fmt: skip
        self._balance = EnergyBalance(asked, self._energy())

    def _answers(self, inertia: float, now: float, gamma: float, beta: float) -> dict[str, Any]:
        """A^-1 by mode, and what unit forces or impulses on pairs change."""
        modes, dt = self._modes, self._asked.step_size
        pairs, undamped = modes.pairs, inertia + now * beta * dt**2 * modes.squares
        inverse = self._inverse(undamped, now * gamma * dt)
        if not self._asked.rigid:
            pull = -times_by_mode(inverse, pairs)
            compliance = np.ascontiguousarray(-(dt**2) * beta * (pairs.T @ pull))
            return {"inverse": inverse, "pull": pull.T.copy(), "compliance": compliance}
        kick = inertia * pairs / undamped[:, None]
        # C v of the whole step, K u of the end.
        right = modes.damped(kick.T).T + now * dt * modes.squares[:, None] * kick
        pull = times_by_mode(inverse, right)
        moved = dt * kick - dt**2 * beta * pull
        return {
            "inverse": inverse, "pull": pull.T.copy(), "kick": kick.T.copy(),
            "contact": ActiveSets(pairs.T @ moved).handle,
            "stops": ActiveSets(pairs.T @ kick).handle,
        }  # fmt: skip

    def fill(self, window: Window, number: int) -> None:
        self._march(window, kernel.march_implicit)
        last = self._modes.shapes[self._asked.load_rows] @ self._shape
        motion = np.vstack([window.load_motion, last])
        created = self._balance.created(motion, self._energy(), self._known.at.lost)
        self.book(created, self._balance.put_in)

    def _energy(self) -> float:
        """Energy of the motion, and of the law's springs [J]."""
        stored = 0.0 if self._asked.rigid else potential(self._asked.contact, self._gap()).sum()
        return self._energy_of(self._velocity) + float(stored)

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        return self._modes.shapes @ self._shape, self._modes.shapes @ self._velocity


class _GeneralisedAlpha(LoopedSteps):
    """State and one step of the scheme, and its energy."""

    name, remedy = NAME, REMEDY

    def __init__(self, asked: March, radius: float) -> None:
        self._am, self._af, self._gamma, self._beta = _parameters(radius)
        self._inertia, self._now, dt = 1.0 - self._am, 1.0 - self._af, asked.step_size
        spring, dashpot = self._now * self._beta * dt**2, self._now * self._gamma * dt
        super().__init__(asked, self._inertia, spring, dashpot)
        self._prepare_contact()
        displacement, self._velocity = asked.start
        self.displacement = self._admissible(displacement)
        self.gap = self._measured(self.displacement)
        if not self.rigid:
            self._held = self.contact.force(self.gap)
        self._change, self._lost = self._acceleration(self._velocity), 0.0
        self._balance = EnergyBalance(asked, self._energy())

    def _prepare_contact(self) -> None:
        """Change of acceleration by unit forces or impulses, of velocity, and the gaps' change."""
        structure, dt = self.structure, self.step_size
        pairs = structure.gap.toarray()
        if self.rigid:
            kick = self._kick = self._kicks(pairs)
            # C v of the whole step, K u of the end.
            right = [
                self._damped(one) + self._now * dt * self._times(structure.stiffness, one)
                for one in kick.T
            ]
            self._rates = structure.apply_bt(kick.T).T
            self._pull = self._answers(np.array(right).reshape(kick.T.shape).T)
            moved = dt * kick - dt**2 * self._beta * self._pull
        else:
            self._pull = -self._answers(pairs)
            moved = -(dt**2) * self._beta * self._pull
        self._compliance = structure.apply_bt(moved.T).T

    def _kicks(self, pairs: np.ndarray) -> np.ndarray:
        """(1 - am) D^-1 B: change of velocity by unit impulses."""
        structure = self.structure
        if self._damping is None:
            return self._inertia * self._inverse.solve(pairs.T).T
        weight = self._now * self._beta * self.step_size**2 / self._inertia
        undamped = factored_sum(structure.mass, weight, structure.stiffness, definite=True)
        with undamped as factor:
            return factor.solve(pairs.T).T

    def advance(self, step: int) -> None:
        dt, displacement = self.step_size, self.displacement
        velocity, acceleration = self._velocity, self._change
        self.before, self.gap = displacement, self._measured(displacement)

        moved = displacement + dt * velocity + dt**2 * (0.5 - self._beta) * acceleration
        faster = velocity + dt * (1.0 - self._gamma) * acceleration
        found = self._without_contact(step, moved, faster)
        free = self._measured(moved + (self._beta * dt**2) * found)
        if self.rigid:
            impulse = solve_complementarity(self._compliance, free, self.force > 0.0)
            change = self._kick @ impulse
            velocity = velocity - change
            faster -= change
            moved -= dt * change
        else:
            impulse = self._forces(free)
        found += self._pull @ impulse
        self.displacement = moved + (self._beta * dt**2) * found
        faster += (self._gamma * dt) * found
        self._lost += dt * self._dissipated(0.5 * (velocity + faster))
        if self.rigid:
            stop = self._stopped(faster, impulse)
            self.force = (impulse + stop) / dt
            faster -= self._kick @ stop
        self._velocity, self._change = faster, found

    def _without_contact(self, step: int, moved: np.ndarray, faster: np.ndarray) -> np.ndarray:
        """Acceleration at the end of a step from what Newmark's formulas know of u and v there."""
        following = (step + 1) % len(self.load)
        right = -self._times(
            self.structure.stiffness, self._now * moved + self._af * self.displacement
        ) - self._times(self.structure.mass, self._am * self._change)
        right[self.load_rows] += self._now * self.load[following] + self._af * self.load[step]
        return self._answer(right, self._now * faster + self._af * self._velocity)

    def _forces(self, free: np.ndarray) -> np.ndarray:
        """h of a step from the present gap, given the gap at its end without contact forces."""
        contact, start = self.contact, self.gap
        self.force = force = contact.force(start)
        shift = 0.5 - self._af

        def response(gaps: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            gap = gaps[0]
            mean, slope = _mean_force(contact, start, gap)
            mean += shift * (contact.force(gap) - force)
            return mean[None], (slope + shift * contact.tangent(gap))[None]

        self._held = solve_forces(response, self._compliance, free[None], self._held[None])[0]
        return self._held

    def _stopped(self, velocity: np.ndarray, impulse: np.ndarray) -> np.ndarray:
        """Impulses that keep pairs which are closed at the end of a step from closing further."""
        stop = np.zeros_like(impulse)
        closed = np.flatnonzero(impulse > 0.0)
        if len(closed):
            rates = self._closing(velocity)[closed]
            stop[closed] = solve_complementarity(self._rates[np.ix_(closed, closed)], rates)
        return stop

    def state(self) -> tuple[np.ndarray, np.ndarray]:
        return self.displacement.copy(), self._velocity.copy()

    # --- energy -----------------------------------------------------------------------------------

    def fill(self, window: Window, number: int) -> None:
        self.record(window)
        motion = np.vstack([window.load_motion, self.displacement[self.load_rows]])
        created = self._balance.created(motion, self._energy(), self._lost)
        self.book(created, self._balance.put_in)

    def _energy(self) -> float:
        """Energy of the motion, and of the law's springs [J]."""
        energy = self._linear_energy(self._velocity)
        if not self.rigid:
            energy += float(potential(self.contact, self._measured(self.displacement)).sum())
        return energy

    def _dissipated(self, velocity: np.ndarray) -> float:
        """v^T C v [W]."""
        if self._modes is not None:
            modal = self.structure.sum_over_ranks(velocity @ self._modes.mass_shapes)
            return float(self._modes.rate @ modal**2)
        power = np.array([velocity @ self._damped(velocity)])
        return float(self.structure.sum_over_ranks(power)[0])


def _mean_force(
    contact: ContactLaw, start: np.ndarray, end: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(V(end) - V(start)) / (end - start) and its derivative by the end: (n_pairs,) each.

    Where g keeps its sign, from the mean of lambda: laws have their kink at g = 0.
    """
    change, (nodes, weights) = end - start, gauss(8)
    between = start + nodes[:, None] * change
    mean = weights @ contact.force(between)
    slope = (weights * nodes) @ contact.tangent(between)
    crosses = start * end < 0.0
    if np.any(crosses):
        length = np.where(crosses, change, 1.0)
        split = (potential(contact, end) - potential(contact, start)) / length
        mean = np.where(crosses, split, mean)
        slope = np.where(crosses, (contact.force(end) - split) / length, slope)
    return mean, slope
