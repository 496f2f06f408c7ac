"""Arrival times of a blade tip, from a periodic solution or response curve.

The tip's angle is the rotor's angle alpha plus the vibration's angle (Heath and Imregun,
International Journal of Mechanical Sciences 38, 1996, 1047, solve this for arrival times):

    theta(alpha) = alpha + u(alpha) / R,     u(alpha) = Re sum_k U_k exp(i k q alpha)

U_k are the harmonics of the tip's tangential displacement, positive in the direction of rotation. R
is the tip radius, and q the periods of the response in a revolution. The tip passes a probe at phi
in revolution n if theta = phi + 2 pi n. As |u| <= sum |U_k|, each root lies within sum |U_k| / R of
that angle. Newton's method finds all roots at once. A step that leaves the root's bracket, or is
more than half as long as the previous one, is replaced by bisection. There is one root as long as
the tip moves forwards: theta' > 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from numbers import Integral

import numpy as np
from numpy.polynomial.polynomial import polyval

from fenics_crack.arrivals.arrival_times import (
    MAX_TIP_PASSAGES_IN_RECORD,
    ArrivalTimes,
    check_probe_angles,
)
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import InputError, check_count, check_number
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.model.matrices import floats_or_single_nan
from fenics_crack.numerics.fourier import from_complex, sample_period, to_complex

MAX_RELATIVE_JUMP_DISTANCE_BEFORE_FOLD = 1e-3
"""Maximum distance before a fold at which a run-up may jump off the curve.

The distance is in load frequency, relative to the frequency at the fold.
"""


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

    The blade tip is at the angle W t + u(t) / R, with rotor speed W, tip radius R, and displacement
    u in the direction of rotation. The tip passes the probe at phi in revolution n when this angle
    is phi + 2 pi n. The equation is solved to rounding, with the Fourier series of the response
    (Heath and Imregun, International Journal of Mechanical Sciences 38, 1996, 1047). At time 0 the
    rotor's angle is 0 and the load begins its period.

    A curve is a run-up, or a run-down if its load frequency falls. The speed changes at constant
    acceleration from the first point to the last. At each speed the vibration is steady,
    interpolated between the points; this holds for slow sweeps alone. If the curve turns back at a
    fold, the motion jumps beyond the fold, from the last stable point before the fold.

    Parameters
    ----------
    result : PeriodicSolution or ResponseCurve
        Vibration, with the load's period or twice this period.
    tip : int or mapping of int to float
        Dof of the blade tip's displacement in the direction of rotation; or dofs and factors, with
        the displacement as the sum of products: {dof: -1.0} if the dof points against the rotation.
    probes : (n_probes,) [rad]
        Angles of the probes from the blade tip at time 0, in the direction of rotation; from 0 to 2
        pi, increasing.
    tip_radius : float [m]
        Distance R of the blade tip from the rotor axis.
    speed : float [rad/s]
        Rotor speed W, if the load frequency is no multiple of the speed (asynchronous).
    order : int
        Periods of the load in a revolution (engine order), instead of ``speed``: W = omega / order,
        with the load frequency omega. A curve requires the order.
    revolutions : int
        Number of revolutions, for a run-up in total.
    noise : float [s]
        Standard deviation of normal errors in the arrivals; shorter than a revolution. The
        once-per-revolution times of the shaft have no errors.
    clock : float [s]
        Resolution: arrivals are rounded to multiples of this time, shorter than a revolution; 0: no
        rounding.
    seed : int
        Seed of the random errors.

    Returns
    -------
    ArrivalTimes
        Arrival times (revolutions, probes) [s], and the times of the revolutions.

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
    probe_angles = np.atleast_1d(floats_or_single_nan(probes))
    check_probe_angles(probe_angles)
    factor_by_dof = (
        tip if isinstance(tip, Mapping) else {tip: 1.0} if isinstance(tip, Integral) else {}
    )
    if not factor_by_dof:
        raise InputError("tip", tip, "the number of a dof, or a dict of dofs and their factors")
    for dof, factor in factor_by_dof.items():
        check_number(f"tip[{dof!r}]", factor)
    check_number("tip_radius", tip_radius, 0.0, excludes_bound=True)
    check_count("revolutions", revolutions, 1)
    if revolutions * len(probe_angles) > MAX_TIP_PASSAGES_IN_RECORD:
        raise InputError(
            "revolutions",
            revolutions,
            f"at most {MAX_TIP_PASSAGES_IN_RECORD // len(probe_angles)}, since "
            f"{MAX_TIP_PASSAGES_IN_RECORD:.0e} passages of probes are the limit",
        )
    check_number("noise", noise, 0.0)
    check_number("clock", clock, 0.0)
    check_count("seed", seed, 0)
    result.structure.whole.as_dof_numbers(list(factor_by_dof))

    tip_motion = _build_motion(result, factor_by_dof, speed, order, revolutions)
    arrival_times = _compute_arrival_times(tip_motion, probe_angles, tip_radius)
    revolution_times = tip_motion.compute_times_of_rotor_angles(
        2.0 * np.pi * np.arange(revolutions + 1)
    )
    shortest_revolution_duration = float(np.diff(revolution_times).min())
    for argument_name, argument_value in (("noise", noise), ("clock", clock)):
        if argument_value >= shortest_revolution_duration:
            raise InputError(
                argument_name,
                argument_value,
                f"less than the duration of a revolution, {shortest_revolution_duration:.3g} s",
            )
    if noise:
        arrival_times = arrival_times + noise * np.random.default_rng(seed).standard_normal(
            arrival_times.shape
        )
    if clock:
        arrival_times = clock * np.round(arrival_times / clock)
    return ArrivalTimes(arrival_times, revolution_times, probe_angles, float(tip_radius))


def _compute_arrival_times(
    tip_motion: _TipMotionOverRotorAngle, probe_angles: np.ndarray, tip_radius: float
) -> np.ndarray:
    """Compute the times at which a blade tip passes the probes.

    Parameters
    ----------
    tip_motion : _TipMotionOverRotorAngle
        Displacement of the tip, and rotor speed.
    probe_angles : (probes,) [rad]
        Probe angles from the tip at time 0.
    tip_radius : float [m]
        Distance of the blade tip from the rotor axis.

    Returns
    -------
    (revolutions, probes) [s]
        Arrival times.

    Raises
    ------
    InputError
        The tip moves backwards at some time.
    """
    backward_ratio = tip_motion.bound_backward_slope() / tip_radius
    target_angles = 2.0 * np.pi * np.arange(tip_motion.n_revolutions)[:, None] + probe_angles
    target_angle_batches = np.array_split(
        target_angles.ravel(), -(-target_angles.size // 2**15)
    )  # batches limit the memory
    rotor_angles = np.concatenate(
        [
            _solve_passing_angles_or_nan(tip_motion, target_angle_batch, tip_radius)
            for target_angle_batch in target_angle_batches
        ]
    )
    if backward_ratio >= 1.0 or np.any(np.isnan(rotor_angles)):
        requirement_text = (
            "so large that the tip always moves forwards; its vibration has up to "
            f"{backward_ratio:.3g} times the velocity of the rotation: check the units, or lower "
            "the load"
        )
        raise InputError("tip_radius", tip_radius, requirement_text)
    return tip_motion.compute_times_of_rotor_angles(rotor_angles).reshape(target_angles.shape)


def _build_motion(
    result: PeriodicSolution | ResponseCurve,
    factor_by_dof: Mapping[int, float],
    speed: float | None,
    order: int | None,
    n_revolutions: int,
) -> _TipMotionOverRotorAngle:
    """Return the motion of a blade tip over the rotor angle (collective).

    Parameters
    ----------
    result : PeriodicSolution or ResponseCurve
        Steady vibration, or a curve that is a run-up.
    factor_by_dof : dict of int to float
        Dofs and their factors; the sum of factors times dofs is the tip's displacement in the
        direction of rotation.
    speed : float or None [rad/s]
        Rotor speed; None if ``order`` is given.
    order : int or None
        Load periods in a revolution; None if ``speed`` is given. A curve needs the order.
    n_revolutions : int
        Number of revolutions.

    Raises
    ------
    InputError
        Speed and order are both missing or both given, or a curve cannot be a run-up.
    """
    if order is not None:
        check_count("order", order, 1)
    if speed is not None:
        check_number("speed", speed, 0.0, excludes_bound=True)
    if isinstance(result, ResponseCurve):
        if speed is not None:
            raise InputError(
                "speed", speed, "left out with a curve, which is a run-up; give order instead"
            )
        if order is None:
            raise InputError(
                "order", order, "given with a curve: the periods of the load in a revolution"
            )
        return _build_run_up_motion(result, factor_by_dof, order, n_revolutions)
    if (speed is None) == (order is None):
        raise InputError(
            "speed, order", (speed, order), "given one at a time: either speed or order"
        )
    rotor_speed = float(speed or result.omega / (order or 1))
    tip_fourier_coefficients = result.coefficients_at(list(factor_by_dof)) @ np.array(
        list(factor_by_dof.values()), dtype=float
    )
    return _TipMotionOverRotorAngle(
        first_and_last_rotor_speed=(rotor_speed, rotor_speed),
        n_revolutions=n_revolutions,
        speeds_with_known_vibration=np.array([rotor_speed, 2.0 * rotor_speed]),
        tip_harmonics=np.tile(to_complex(tip_fourier_coefficients), (2, 1)),
        periods_per_revolution=result.base_omega / rotor_speed,
    )


def _build_run_up_motion(
    curve: ResponseCurve, factor_by_dof: Mapping[int, float], order: int, n_revolutions: int
) -> _TipMotionOverRotorAngle:
    """Return a blade tip's motion in a run-up or run-down along a curve.

    Parameters
    ----------
    curve : ResponseCurve
        Curve over the load frequency.
    factor_by_dof : dict of int to float
        Dofs and their factors; the sum of factors times dofs is the tip's displacement in the
        direction of rotation.
    order : int
        Load periods in a revolution.
    n_revolutions : int
        Number of revolutions in total.

    Raises
    ------
    InputError
        The curve has one load frequency only, or an unstable or irregular point on the way.
    """
    first_omega, last_omega = float(curve.omega[0]), float(curve.omega[-1])
    if first_omega == last_omega:
        raise InputError(
            "result", f"a curve over {curve.parameter}", "a curve over the load frequency"
        )
    passed_curve_point_indices, unstable_index = find_run_up_point_indices(curve)
    if unstable_index is not None:
        omega_of_unstable_point = float(curve.omega[unstable_index])
        requirement_text = (
            f"stable along the run-up, but it is unstable at {omega_of_unstable_point:.6g} "
            "rad/s: give "
            "its points before, curve.part(...), or the stable branch"
        )
        raise InputError("result", repr(curve), requirement_text)
    tip_fourier_coefficients = sum(
        float(factor) * curve.coefficients_at(dof) for dof, factor in factor_by_dof.items()
    )
    tip_harmonics = to_complex(np.asarray(tip_fourier_coefficients)[passed_curve_point_indices].T).T
    slice_to_rising_speeds = slice(None, None, -1 if last_omega < first_omega else 1)
    return _TipMotionOverRotorAngle(
        first_and_last_rotor_speed=(
            first_omega / order,
            float(curve.omega[passed_curve_point_indices][-1]) / order,
        ),
        n_revolutions=n_revolutions,
        speeds_with_known_vibration=(curve.omega[passed_curve_point_indices] / order)[
            slice_to_rising_speeds
        ],
        tip_harmonics=tip_harmonics[slice_to_rising_speeds],
        periods_per_revolution=order / curve.subharmonic,
    )


def find_run_up_point_indices(curve: ResponseCurve) -> tuple[np.ndarray, int | None]:
    """Find the points of a curve that a run-up or run-down passes.

    A point is passed if its load frequency lies beyond all previous points. The motion may jump
    from the last stable point before a fold; the points between are left out.

    Returns
    -------
    (k,)
        Indices of the passed points, up to the first unstable or irregular point.
    int or None
        Index of this unstable or irregular point. None if there is none, or if the curve's
        stability is unknown.
    """
    signed_omega = np.sign(curve.omega[-1] - curve.omega[0]) * curve.omega
    highest_previous_omega = np.concatenate([[-np.inf], np.maximum.accumulate(signed_omega)[:-1]])
    is_passed = signed_omega > highest_previous_omega
    if curve.multipliers is None:
        return np.flatnonzero(is_passed), None
    is_passed &= ~_mark_jumped_points(signed_omega, is_passed, curve.verdicts != "stable")
    passed_curve_point_indices = np.flatnonzero(is_passed)
    unstable_indices = passed_curve_point_indices[
        np.isin(curve.verdicts[passed_curve_point_indices], ("unstable", "irregular"))
    ]
    return (
        (
            passed_curve_point_indices[passed_curve_point_indices < unstable_indices[0]],
            int(unstable_indices[0]),
        )
        if len(unstable_indices)
        else (passed_curve_point_indices, None)
    )


def _mark_jumped_points(
    signed_omega: np.ndarray, is_passed: np.ndarray, is_doubtful: np.ndarray
) -> np.ndarray:
    """Mark the points just before folds that a jump leaves out: (n,) bool.

    A fold is a point at which the load frequency turns back. The motion may jump a little before
    the fold. A point is left out if both conditions hold:

    - All points from this point to the fold are doubtful.
    - The load frequency is below the fold's by less than 1e-3 times the fold's.

    Parameters
    ----------
    signed_omega : (n,) [rad/s]
        Load frequency of all points, times -1 in a run-down.
    is_passed : (n,) bool
        True for points beyond all previous load frequencies.
    is_doubtful : (n,) bool
        True for points that are not known to be stable.
    """
    is_jumped = np.zeros(len(signed_omega), dtype=bool)
    for fold_index in np.flatnonzero(is_passed[:-1] & ~is_passed[1:]):
        fold_distances = signed_omega[fold_index] - signed_omega[: fold_index + 1]
        can_jump_before = is_doubtful[: fold_index + 1] & (
            fold_distances < MAX_RELATIVE_JUMP_DISTANCE_BEFORE_FOLD * abs(signed_omega[fold_index])
        )
        is_jumped[: fold_index + 1] |= np.logical_and.accumulate(can_jump_before[::-1])[::-1]
    return is_jumped


# --- passages -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _TipMotionOverRotorAngle:
    """Displacement u of a blade tip over the rotor angle alpha, along the rotation.

    With q periods of the response in a revolution, and H harmonics, the displacement is

        u(alpha) = Re sum_k U_k exp(i k q alpha), k = 0 to H.

    The rotor turns at constant acceleration, from the angle alpha = 0 at time 0.

    Attributes
    ----------
    first_and_last_rotor_speed : (float, float) [rad/s]
        Rotor speed at the beginning, and after all revolutions.
    n_revolutions : int
        Number of revolutions.
    speeds_with_known_vibration : (n,) [rad/s]
        Increasing speeds with known vibration. The harmonics U_k are linear between two speeds, and
        constant outside all speeds.
    tip_harmonics : (n, H+1) complex [m]
        Harmonics U_k at these speeds.
    periods_per_revolution : float
        Periods q of the response in a revolution.
    """

    first_and_last_rotor_speed: tuple[float, float]
    n_revolutions: int
    speeds_with_known_vibration: np.ndarray
    tip_harmonics: np.ndarray
    periods_per_revolution: float

    @property
    def angular_acceleration(self) -> float:
        """Return the constant acceleration of the rotor [rad/s^2]; < 0 in a run-down."""
        begin_speed, end_speed = self.first_and_last_rotor_speed
        return (
            (end_speed - begin_speed)
            * (end_speed + begin_speed)
            / (4.0 * np.pi * self.n_revolutions)
        )

    def compute_rotor_speeds(self, rotor_angles: np.ndarray) -> np.ndarray:
        """Return rotor speeds [rad/s] at rotor angles [rad]."""
        return np.asarray(
            np.sqrt(
                self.first_and_last_rotor_speed[0] ** 2
                + 2.0 * self.angular_acceleration * rotor_angles
            )
        )

    def compute_times_of_rotor_angles(self, rotor_angles: np.ndarray) -> np.ndarray:
        """Return the times [s] at which the rotor has given angles [rad].

        The time at the angle alpha is 2 alpha / (W_0 + W(alpha)), with the rotor speeds W_0 at time
        0 and W(alpha). This formula has no cancellation at small accelerations.
        """
        return np.asarray(
            2.0
            * rotor_angles
            / (self.first_and_last_rotor_speed[0] + self.compute_rotor_speeds(rotor_angles))
        )

    def bound_backward_slope(self) -> float:
        """Return an upper bound of -du/dalpha [m] at all speeds with known vibration.

        A tip at radius R moves forwards if the bound is below R. -du/dalpha is sampled over a
        period. The bound is the largest sample, plus the largest possible change between two
        samples.
        """
        harmonic_orders = np.arange(self.tip_harmonics.shape[1])[:, None]
        harmonics_of_slope_by_angle = (
            1j * self.periods_per_revolution * harmonic_orders * self.tip_harmonics.T
        )
        n_samples = max(1024, 64 * len(harmonics_of_slope_by_angle))
        change_between_samples_bounds = (
            (2.0 * np.pi / n_samples) ** 2
            / 8.0
            * (harmonic_orders**2 * np.abs(harmonics_of_slope_by_angle)).sum(axis=0)
        )
        return float(
            (
                change_between_samples_bounds
                - sample_period(from_complex(harmonics_of_slope_by_angle), n_samples).min(axis=0)
            ).max()
        )

    def evaluate_displacement_and_slope(
        self, rotor_angles: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return displacements u and slopes du/dalpha [m] at rotor angles (n,) [rad].

        The slope includes the change of the harmonics with the speed.
        """
        phase_factors = np.exp(1j * self.periods_per_revolution * rotor_angles)
        speeds_at_rotor_angles = self.compute_rotor_speeds(rotor_angles)
        lower_speed_indices = np.clip(
            np.searchsorted(self.speeds_with_known_vibration, speeds_at_rotor_angles) - 1,
            0,
            len(self.speeds_with_known_vibration) - 2,
        )
        speed_interval_widths = (
            self.speeds_with_known_vibration[lower_speed_indices + 1]
            - self.speeds_with_known_vibration[lower_speed_indices]
        )
        speed_interval_fractions = np.clip(
            (speeds_at_rotor_angles - self.speeds_with_known_vibration[lower_speed_indices])
            / speed_interval_widths,
            0.0,
            1.0,
        )
        harmonic_changes_between_speeds = (
            self.tip_harmonics[lower_speed_indices + 1] - self.tip_harmonics[lower_speed_indices]
        ).T
        interpolated_harmonics = (
            self.tip_harmonics[lower_speed_indices].T
            + speed_interval_fractions * harmonic_changes_between_speeds
        )
        harmonics_of_slope_by_angle = (
            1j
            * self.periods_per_revolution
            * np.arange(len(interpolated_harmonics))[:, None]
            * interpolated_harmonics
        )
        is_between_known_speeds = (speeds_at_rotor_angles > self.speeds_with_known_vibration[0]) & (
            speeds_at_rotor_angles < self.speeds_with_known_vibration[-1]
        )
        harmonics_of_slope_by_angle += (
            np.where(
                is_between_known_speeds,
                self.angular_acceleration / (speeds_at_rotor_angles * speed_interval_widths),
                0.0,
            )
            * harmonic_changes_between_speeds
        )
        return (
            polyval(phase_factors, interpolated_harmonics, tensor=False).real,
            polyval(phase_factors, harmonics_of_slope_by_angle, tensor=False).real,
        )


def _solve_passing_angles_or_nan(
    tip_motion: _TipMotionOverRotorAngle, target_angles: np.ndarray, tip_radius: float
) -> np.ndarray:
    """Find the rotor angles at which a blade tip is at given angles.

    Solve alpha + u(alpha) / R = theta to rounding, by Newton's method with bisection.

    Parameters
    ----------
    tip_motion : _TipMotionOverRotorAngle
        Motion with u(alpha).
    target_angles : (n,) [rad]
        Angles theta of the tip: probe angle plus whole turns.
    tip_radius : float [m]
        Radius R.

    Returns
    -------
    (n,) [rad]
        Rotor angles alpha; nan where the tip moves backwards.
    """
    displacement_angle_bound = (
        np.abs(tip_motion.tip_harmonics).sum(axis=1).max() / tip_radius * (1.0 + 1e-12)
    )
    displacement_angle_bound = displacement_angle_bound + 4.0 * np.spacing(np.abs(target_angles))
    lower_angle_bounds = target_angles - displacement_angle_bound
    upper_angle_bounds = target_angles + displacement_angle_bound
    rotor_angles = target_angles.copy()
    previous_step_sizes = upper_angle_bounds - lower_angle_bounds
    angle_slopes = np.ones_like(target_angles)
    for _ in range(200):  # more than bisection needs
        displacements, displacement_slopes = tip_motion.evaluate_displacement_and_slope(
            rotor_angles
        )
        angle_excesses = rotor_angles - target_angles + displacements / tip_radius
        angle_slopes = 1.0 + displacement_slopes / tip_radius
        upper_angle_bounds = np.where(angle_excesses >= 0.0, rotor_angles, upper_angle_bounds)
        lower_angle_bounds = np.where(angle_excesses <= 0.0, rotor_angles, lower_angle_bounds)
        with np.errstate(divide="ignore", invalid="ignore"):
            angle_steps = -angle_excesses / angle_slopes
        bisection_angle_steps = 0.5 * (lower_angle_bounds + upper_angle_bounds) - rotor_angles
        is_inside_bounds = (rotor_angles + angle_steps >= lower_angle_bounds) & (
            rotor_angles + angle_steps <= upper_angle_bounds
        )
        angle_steps = np.where(
            is_inside_bounds & (np.abs(angle_steps) <= 0.5 * previous_step_sizes),
            angle_steps,
            bisection_angle_steps,
        )
        rotor_angles, previous_step_sizes = rotor_angles + angle_steps, np.abs(angle_steps)
        if np.all(
            previous_step_sizes
            <= 2.0 * np.spacing(np.abs(target_angles) + displacement_angle_bound)
        ):
            break
    return np.where(angle_slopes > 0.0, rotor_angles, np.nan)
