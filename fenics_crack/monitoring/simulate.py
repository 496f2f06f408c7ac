"""Arrival times of a blade tip, from a periodic solution or response curve.

The angle of the blade tip is that of the rotor, alpha, plus that of its vibration (Heath and
Imregun, International Journal of Mechanical Sciences 38, 1996, 1047, solve this for arrival times):

    theta(alpha) = alpha + u(alpha) / R,     u(alpha) = Re sum_k U_k exp(i k q alpha)

U_k are the harmonics of the tangential displacement of the blade tip, positive in the direction of
rotation, and q the periods of the response in a revolution. The blade tip passes a probe at phi in
revolution n where theta = phi + 2 pi n. As |u| <= sum |U_k|, each root lies within sum |U_k| / R of
that angle. Newton's method finds all roots at once; a step that leaves its root's bracket, or is
not half as long as the one before, is replaced by the middle of the bracket. There is one root, as
long as the blade tip moves forwards: theta' > 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral

import numpy as np
from numpy.polynomial.polynomial import polyval

from fenics_crack.arrivals.arrival_times import MOST_PASSAGES, ArrivalTimes, check_probes
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import InputError, check_count, check_number
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.model.matrices import numbers
from fenics_crack.numerics.fourier import from_complex, sample_period, to_complex

MAX_JUMP_DISTANCE = 1e-3
"""Maximum distance from a fold at which a motion jumps, relative to the frequency."""


def tip_timing(
    result: PeriodicSolution | ResponseCurve,
    tip: int | Mapping[int, float],
    *,
    probes: Sequence[float] | np.ndarray,
    tip_radius: float,
    speed: float | None = None,
    order: int | None = None,
    revolutions: int = 100,
    noise: float = 0.0,
    clock: float = 0.0,
    seed: int = 0,
) -> ArrivalTimes:
    """Compute when the tip of a vibrating blade passes stationary probes (collective).

    The blade tip is at the angle W t + u(t) / R; it passes the probe at phi in revolution n where
    that is phi + 2 pi n. This is solved to rounding, with the Fourier series of the response (Heath
    and Imregun, International Journal of Mechanical Sciences 38, 1996, 1047). At time 0 the rotor's
    angle is 0 and the load begins its period.

    A curve is a run-up, or a run-down if it was followed downwards: the speed rises at constant
    acceleration from that of its first point to that of its last one, and the vibration is taken
    to be the steady one at each speed, interpolated between the points. So it is for slow sweeps
    alone. Where the curve turns back at a fold, the motion jumps to the part that it reaches beyond
    the fold, from the last point next to it that is stable.

    Parameters
    ----------
    result : PeriodicSolution or ResponseCurve
        Vibration; also one of twice the load's period.
    tip : int or mapping of int to float
        The dof that is the blade tip's displacement in the direction of rotation; or dofs with
        factors, whose sum it is: {dof: -1.0} where the dof points against the rotation.
    probes : (n_probes,) [rad]
        Angles of the probes from the blade tip's place at time 0, in the direction of rotation;
        from 0 to 2 pi, increasing.
    tip_radius : float [m]
        Distance R of the blade tip from the axis.
    speed : float [rad/s]
        W; of a solution, where its frequency is no multiple of the speed (asynchronous).
    order : int
        In place of ``speed``: periods of the load in a revolution (engine order), W = omega /
        order; a curve needs it.
    revolutions : int
        Number of revolutions; of a run-up all together.
    noise : float [s]
        Standard deviation of normal errors added to the arrivals, not to the marks of the shaft;
        shorter than a revolution.
    clock : float [s]
        Resolution, shorter than a revolution: arrivals are rounded to its multiples; 0: none.
    seed : int
        Seed of the noise.

    Returns
    -------
    ArrivalTimes
        Revolution by probe [s].

    Raises
    ------
    InputError
        A value cannot be used; the blade tip moves backwards and would pass a probe twice; the
        curve does not go from one speed to another, or is unstable on the way.

    Examples
    --------
    >>> arrivals = fc.tip_timing(
    ...     solution, tip, probes=[0.1, 0.5, 1.3, 3.1], tip_radius=0.4, order=6)
    """
    angles = np.atleast_1d(numbers(probes))
    check_probes(angles)
    factors = tip if isinstance(tip, Mapping) else {tip: 1.0} if isinstance(tip, Integral) else {}
    if not factors:
        raise InputError("tip", tip, "a dof, or dofs with their factors")
    for dof, factor in factors.items():
        check_number(f"tip[{dof!r}]", factor)
    check_number("tip_radius", tip_radius, 0.0, excludes_bound=True)
    check_count("revolutions", revolutions, 1)
    if revolutions * len(angles) > MOST_PASSAGES:
        raise InputError("revolutions", revolutions, f"fewer: {MOST_PASSAGES:.0e} passages at most")
    check_number("noise", noise, 0.0)
    check_number("clock", clock, 0.0)
    check_count("seed", seed, 0)
    result.structure.whole.check_dofs(list(factors))

    motion = _build_motion(result, factors, speed, order, revolutions)
    time = _compute_arrival_times(motion, angles, tip_radius)
    marks = motion.time(2.0 * np.pi * np.arange(revolutions + 1))
    min_duration = float(np.diff(marks).min())
    for key, value in (("noise", noise), ("clock", clock)):
        if value >= min_duration:
            raise InputError(key, value, f"less than a revolution takes, {min_duration:.3g} s")
    if noise:
        time = time + noise * np.random.default_rng(seed).standard_normal(time.shape)
    if clock:
        time = clock * np.round(time / clock)
    return ArrivalTimes(time, marks, angles, float(tip_radius))


def _compute_arrival_times(
    motion: _TipMotion, probe_angles: np.ndarray, radius: float
) -> np.ndarray:
    """Compute arrival times at the probes: (revolutions, probes) [s]."""
    backward_ratio = motion.bound_backward_rate() / radius
    targets = 2.0 * np.pi * np.arange(motion.revolutions)[:, None] + probe_angles
    parts = np.array_split(targets.ravel(), -(-targets.size // 2**15))  # for the memory
    rotor_angles = np.concatenate([_solve_passing_angles(motion, part, radius) for part in parts])
    if backward_ratio >= 1.0 or np.any(np.isnan(rotor_angles)):
        requirement = (
            "so large that the blade tip never moves backwards, past a probe a second time: its "
            f"vibration reaches {backward_ratio:.3g} of the speed of rotation"
        )
        raise InputError("tip_radius", radius, requirement)
    return motion.time(rotor_angles).reshape(targets.shape)


def _build_motion(
    result: PeriodicSolution | ResponseCurve,
    factors: Mapping[int, float],
    speed: float | None,
    order: int | None,
    revolutions: int,
) -> _TipMotion:
    """Return the motion of the blade tip (collective).

    Raise InputError unless exactly one of ``speed`` and ``order`` is given; of a curve, ``order``.
    """
    if order is not None:
        check_count("order", order, 1)
    if speed is not None:
        check_number("speed", speed, 0.0, excludes_bound=True)
    if isinstance(result, ResponseCurve):
        if speed is not None:
            raise InputError("speed", speed, "left out with a curve, which is a run-up; give order")
        if order is None:
            raise InputError("order", order, "given with a curve: periods of the load in a turn")
        return _build_run_up(result, factors, order, revolutions)
    if (speed is None) == (order is None):
        raise InputError("speed, order", (speed, order), "one of them")
    rotor_speed = float(speed or result.omega / (order or 1))
    series = result.coefficients_at(list(factors)) @ np.array(list(factors.values()), dtype=float)
    speeds = np.array([rotor_speed, 2.0 * rotor_speed])
    harmonics = np.tile(to_complex(series), (2, 1))
    response_order = result.base_omega / rotor_speed
    return _TipMotion((rotor_speed, rotor_speed), revolutions, speeds, harmonics, response_order)


def _build_run_up(
    curve: ResponseCurve, factors: Mapping[int, float], order: int, revolutions: int
) -> _TipMotion:
    """Return the motion of the blade tip along a run-up or run-down."""
    first_omega, last_omega = float(curve.omega[0]), float(curve.omega[-1])
    if first_omega == last_omega:
        raise InputError("result", f"a curve over {curve.parameter}", "one over the load frequency")
    indices, unstable_index = run_up_points(curve)
    if unstable_index is not None:
        omega = float(curve.omega[unstable_index])
        requirement = "stable along the run-up, or a part that is, or "
        raise InputError("result", f"unstable at {omega:.6g} rad/s", f"{requirement}its branch")
    series = sum(float(factor) * curve.coefficients_at(dof) for dof, factor in factors.items())
    speeds, harmonics = curve.omega[indices] / order, to_complex(np.asarray(series)[indices].T).T
    if last_omega < first_omega:
        speeds, harmonics = speeds[::-1], harmonics[::-1]
    end_speeds = first_omega / order, float(curve.omega[indices][-1]) / order
    return _TipMotion(end_speeds, revolutions, speeds, harmonics, order / curve.subharmonic)


def run_up_points(curve: ResponseCurve) -> tuple[np.ndarray, int | None]:
    """Find the points of a curve that a run-up passes.

    Returns their indices (k,), up to the first unstable or irregular point, and the index of that
    point: None without such a point, or if the stability is not known.
    """
    signed_omega = np.sign(curve.omega[-1] - curve.omega[0]) * curve.omega
    max_previous_omega = np.concatenate([[-np.inf], np.maximum.accumulate(signed_omega)[:-1]])
    is_passed = signed_omega > max_previous_omega
    if curve.multipliers is None:
        return np.flatnonzero(is_passed), None
    is_passed &= ~_find_jumped_points(signed_omega, is_passed, curve.verdicts != "stable")
    indices = np.flatnonzero(is_passed)
    unstable_indices = indices[np.isin(curve.verdicts[indices], ("unstable", "irregular"))]
    return (
        (indices[indices < unstable_indices[0]], int(unstable_indices[0]))
        if len(unstable_indices)
        else (indices, None)
    )


def _find_jumped_points(
    signed_omega: np.ndarray, is_passed: np.ndarray, is_doubtful: np.ndarray
) -> np.ndarray:
    """Find points before folds that a jump leaves out: (n,) bool.

    ``signed_omega``: the frequency, negative in a run-down; ``is_passed``: points of the run-up;
    ``is_doubtful``: points not known to be stable. The motion jumps before the row of doubtful
    points that ends at a fold, if they are near.
    """
    is_jumped = np.zeros(len(signed_omega), dtype=bool)
    for fold_index in np.flatnonzero(is_passed[:-1] & ~is_passed[1:]):
        distances = signed_omega[fold_index] - signed_omega[: fold_index + 1]
        can_jump = is_doubtful[: fold_index + 1] & (
            distances < MAX_JUMP_DISTANCE * abs(signed_omega[fold_index])
        )
        is_jumped[: fold_index + 1] |= np.logical_and.accumulate(can_jump[::-1])[::-1]
    return is_jumped


# --- passages -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _TipMotion:
    """Tangential displacement of a blade tip over the angle of its rotor.

    The rotor turns at constant acceleration, from angle 0 at time 0.

    Attributes
    ----------
    end_speeds : (float, float) [rad/s]
        Speed of the rotor at the beginning, and after all revolutions.
    revolutions : int
        Number of revolutions.
    speeds : (n,) [rad/s]
        Speeds at which the vibration is known, increasing; between them it is interpolated.
    harmonics : (n, H+1) complex [m]
        U_k at these speeds.
    order : float
        Periods of the response in a revolution, q.
    """

    end_speeds: tuple[float, float]
    revolutions: int
    speeds: np.ndarray
    harmonics: np.ndarray
    order: float

    @property
    def acceleration(self) -> float:
        """Return the acceleration of the rotor [rad/s^2]."""
        begin, end = self.end_speeds
        return (end - begin) * (end + begin) / (4.0 * np.pi * self.revolutions)

    def speed(self, angle: np.ndarray) -> np.ndarray:
        """Return the rotor's speed [rad/s] at angles [rad]."""
        return np.asarray(np.sqrt(self.end_speeds[0] ** 2 + 2.0 * self.acceleration * angle))

    def time(self, angle: np.ndarray) -> np.ndarray:
        """Return the time [s] at angles [rad], without cancellation at small accelerations."""
        return np.asarray(2.0 * angle / (self.end_speeds[0] + self.speed(angle)))

    def bound_backward_rate(self) -> float:
        """Return an upper bound of -du/dalpha [m] at all speeds.

        The largest of samples over a period, and its possible change between two samples.
        """
        orders = np.arange(self.harmonics.shape[1])[:, None]
        derivatives = 1j * self.order * orders * self.harmonics.T
        n_samples = max(1024, 64 * len(derivatives))
        change_bounds = (
            (2.0 * np.pi / n_samples) ** 2 / 8.0 * (orders**2 * np.abs(derivatives)).sum(axis=0)
        )
        return float(
            (change_bounds - sample_period(from_complex(derivatives), n_samples).min(axis=0)).max()
        )

    def evaluate(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return u [m] and du/dalpha [m] at rotor angles (n,) [rad]."""
        phase_factor = np.exp(1j * self.order * angle)
        speed = self.speed(angle)
        lower_indices = np.clip(np.searchsorted(self.speeds, speed) - 1, 0, len(self.speeds) - 2)
        width = self.speeds[lower_indices + 1] - self.speeds[lower_indices]
        fraction = np.clip((speed - self.speeds[lower_indices]) / width, 0.0, 1.0)
        increments = (self.harmonics[lower_indices + 1] - self.harmonics[lower_indices]).T
        harmonics = self.harmonics[lower_indices].T + fraction * increments
        derivatives = 1j * self.order * np.arange(len(harmonics))[:, None] * harmonics
        is_between = (speed > self.speeds[0]) & (speed < self.speeds[-1])
        derivatives += np.where(is_between, self.acceleration / (speed * width), 0.0) * increments
        return (
            polyval(phase_factor, harmonics, tensor=False).real,
            polyval(phase_factor, derivatives, tensor=False).real,
        )


def _solve_passing_angles(motion: _TipMotion, targets: np.ndarray, radius: float) -> np.ndarray:
    """Find the rotor angles at which the tip has the target angles.

    Solves alpha + u(alpha) / R = targets (n,) [rad] to rounding; nan if the tip moves backwards.
    """
    reach = np.abs(motion.harmonics).sum(axis=1).max() / radius * (1.0 + 1e-12)
    reach = reach + 4.0 * np.spacing(np.abs(targets))
    min_angle, max_angle, angle = targets - reach, targets + reach, targets.copy()
    last_step, slope = max_angle - min_angle, np.ones_like(targets)
    for _ in range(200):  # more than bisection needs
        displacement, rate = motion.evaluate(angle)
        excess, slope = angle - targets + displacement / radius, 1.0 + rate / radius
        max_angle = np.where(excess >= 0.0, angle, max_angle)
        min_angle = np.where(excess <= 0.0, angle, min_angle)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = -excess / slope
        bisection_step = 0.5 * (min_angle + max_angle) - angle
        is_inside = (angle + step >= min_angle) & (angle + step <= max_angle)
        step = np.where(is_inside & (np.abs(step) <= 0.5 * last_step), step, bisection_step)
        angle, last_step = angle + step, np.abs(step)
        if np.all(last_step <= 2.0 * np.spacing(np.abs(targets) + reach)):
            break
    return np.where(slope > 0.0, angle, np.nan)
