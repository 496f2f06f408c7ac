"""Arrival times of the tip of a vibrating blade, from a periodic solution or a response curve.

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

JUMP = 1e-3
"""Maximum relative distance in frequency at which a motion may jump before a fold."""


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
    shares = tip if isinstance(tip, Mapping) else {tip: 1.0} if isinstance(tip, Integral) else {}
    if not shares:
        raise InputError("tip", tip, "a dof, or dofs with their factors")
    for dof, share in shares.items():
        check_number(f"tip[{dof!r}]", share)
    check_number("tip_radius", tip_radius, 0.0, above=True)
    check_count("revolutions", revolutions, 1)
    if revolutions * len(angles) > MOST_PASSAGES:
        raise InputError("revolutions", revolutions, f"fewer: {MOST_PASSAGES:.0e} passages at most")
    check_number("noise", noise, 0.0)
    check_number("clock", clock, 0.0)
    check_count("seed", seed, 0)
    result.structure.whole.check_dofs(list(shares))

    motion = _motion(result, shares, speed, order, revolutions)
    time = _arrivals(motion, angles, tip_radius)
    marks = motion.time(2.0 * np.pi * np.arange(revolutions + 1))
    turn = float(np.diff(marks).min())
    for key, value in (("noise", noise), ("clock", clock)):
        if value >= turn:
            raise InputError(key, value, f"less than a revolution takes, {turn:.3g} s")
    if noise:
        time = time + noise * np.random.default_rng(seed).standard_normal(time.shape)
    if clock:
        time = clock * np.round(time / clock)
    return ArrivalTimes(time, marks, angles, float(tip_radius))


def _arrivals(motion: _TipMotion, angles: np.ndarray, radius: float) -> np.ndarray:
    """Return the times at which the blade tip passes the probes: (revolutions, probes) [s]."""
    backwards = motion.fastest_backwards() / radius
    targets = 2.0 * np.pi * np.arange(motion.revolutions)[:, None] + angles
    parts = np.array_split(targets.ravel(), -(-targets.size // 2**15))  # for the memory
    passed = np.concatenate([_passing_angles(motion, part, radius) for part in parts])
    if backwards >= 1.0 or np.any(np.isnan(passed)):
        allowed = (
            "so large that the blade tip never moves backwards, past a probe a second time: its "
            f"vibration reaches {backwards:.3g} of the speed of rotation"
        )
        raise InputError("tip_radius", radius, allowed)
    return motion.time(passed).reshape(targets.shape)


def _motion(
    result: PeriodicSolution | ResponseCurve,
    shares: Mapping[int, float],
    speed: float | None,
    order: int | None,
    revolutions: int,
) -> _TipMotion:
    """Return the motion of the blade tip, at one speed or in a run-up (collective); raise
    InputError unless the speed of rotation is known, once."""
    if order is not None:
        check_count("order", order, 1)
    if speed is not None:
        check_number("speed", speed, 0.0, above=True)
    if isinstance(result, ResponseCurve):
        if speed is not None:
            raise InputError("speed", speed, "left out with a curve, which is a run-up; give order")
        if order is None:
            raise InputError("order", order, "given with a curve: periods of the load in a turn")
        return _run_up(result, shares, order, revolutions)
    if (speed is None) == (order is None):
        raise InputError("speed, order", (speed, order), "one of them")
    turning = float(speed or result.omega / (order or 1))
    waves = result.coefficients_at(list(shares)) @ np.array(list(shares.values()), dtype=float)
    speeds, harmonics = np.array([turning, 2.0 * turning]), np.tile(to_complex(waves), (2, 1))
    periods = result.base_omega / turning
    return _TipMotion((turning, turning), revolutions, speeds, harmonics, periods)


def _run_up(
    curve: ResponseCurve, shares: Mapping[int, float], order: int, revolutions: int
) -> _TipMotion:
    """Return the motion of the blade tip along a curve whose load frequency rises, or falls."""
    begin, end = float(curve.omega[0]), float(curve.omega[-1])
    if begin == end:
        raise InputError("result", f"a curve over {curve.parameter}", "one over the load frequency")
    kept, lost = run_up_points(curve)
    if lost is not None:
        at, allowed = float(curve.omega[lost]), "stable along the run-up, or a part that is, or "
        raise InputError("result", f"unstable at {at:.6g} rad/s", f"{allowed}its branch")
    waves = sum(float(share) * curve.coefficients_at(dof) for dof, share in shares.items())
    speeds, harmonics = curve.omega[kept] / order, to_complex(np.asarray(waves)[kept].T).T
    if end < begin:
        speeds, harmonics = speeds[::-1], harmonics[::-1]
    ends = begin / order, float(curve.omega[kept][-1]) / order
    return _TipMotion(ends, revolutions, speeds, harmonics, order / curve.subharmonic)


def run_up_points(curve: ResponseCurve) -> tuple[np.ndarray, int | None]:
    """Return points of a curve that its run-up passes, (k,), up to the first one that is unstable
    or irregular; and that one, None if there is none or the stability is not known."""
    rising = np.sign(curve.omega[-1] - curve.omega[0]) * curve.omega
    before = np.concatenate([[-np.inf], np.maximum.accumulate(rising)[:-1]])
    kept = rising > before
    if curve.multipliers is None:
        return np.flatnonzero(kept), None
    kept &= ~_next_to_folds(rising, kept, curve.verdicts != "stable")
    points = np.flatnonzero(kept)
    lost = points[np.isin(curve.verdicts[points], ("unstable", "irregular"))]
    return (points[points < lost[0]], int(lost[0])) if len(lost) else (points, None)


def _next_to_folds(rising: np.ndarray, kept: np.ndarray, doubtful: np.ndarray) -> np.ndarray:
    """Return points not known to be stable next to where the curve turns back, before which the
    motion jumps: (n,) bool.

    ``rising``: the frequency, rising along the run-up; ``kept``: points that it passes.
    """
    folds = np.zeros(len(rising), dtype=bool)
    for fold in np.flatnonzero(kept[:-1] & ~kept[1:]):
        below = rising[fold] - rising[: fold + 1]
        near = doubtful[: fold + 1] & (below < JUMP * abs(rising[fold]))
        folds[: fold + 1] |= np.logical_and.accumulate(near[::-1])[::-1]
    return folds


# --- passages -------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _TipMotion:
    """Tangential displacement of the blade tip over the angle of a rotor, which turns at constant
    acceleration, from angle 0 at time 0.

    Attributes
    ----------
    ends : (float, float) [rad/s]
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

    ends: tuple[float, float]
    revolutions: int
    speeds: np.ndarray
    harmonics: np.ndarray
    order: float

    @property
    def acceleration(self) -> float:
        """Of the rotor [rad/s^2]."""
        begin, end = self.ends
        return (end - begin) * (end + begin) / (4.0 * np.pi * self.revolutions)

    def speed(self, angle: np.ndarray) -> np.ndarray:
        """Return the rotor's speed [rad/s] at angles [rad]."""
        return np.asarray(np.sqrt(self.ends[0] ** 2 + 2.0 * self.acceleration * angle))

    def time(self, angle: np.ndarray) -> np.ndarray:
        """Return the time [s] at angles [rad], without cancellation at small accelerations."""
        return np.asarray(2.0 * angle / (self.ends[0] + self.speed(angle)))

    def fastest_backwards(self) -> float:
        """Return a bound of -du/dalpha [m], at all speeds: the largest of samples over a period,
        and its possible change between them."""
        orders = np.arange(self.harmonics.shape[1])[:, None]
        rates = 1j * self.order * orders * self.harmonics.T
        count = max(1024, 64 * len(rates))
        between = (2.0 * np.pi / count) ** 2 / 8.0 * (orders**2 * np.abs(rates)).sum(axis=0)
        return float((between - sample_period(from_complex(rates), count).min(axis=0)).max())

    def at(self, angle: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return u [m] and du/dalpha [m] at rotor angles (n,) [rad]."""
        turn = np.exp(1j * self.order * angle)
        speed = self.speed(angle)
        left = np.clip(np.searchsorted(self.speeds, speed) - 1, 0, len(self.speeds) - 2)
        width = self.speeds[left + 1] - self.speeds[left]
        share = np.clip((speed - self.speeds[left]) / width, 0.0, 1.0)
        steps = (self.harmonics[left + 1] - self.harmonics[left]).T
        here = self.harmonics[left].T + share * steps
        rates = 1j * self.order * np.arange(len(here))[:, None] * here
        inside = (speed > self.speeds[0]) & (speed < self.speeds[-1])
        rates += np.where(inside, self.acceleration / (speed * width), 0.0) * steps
        return (polyval(turn, here, tensor=False).real, polyval(turn, rates, tensor=False).real)


def _passing_angles(motion: _TipMotion, targets: np.ndarray, radius: float) -> np.ndarray:
    """Return rotor angles alpha with alpha + u(alpha) / R = targets (n,) [rad], to rounding:
    (n,) [rad]; nan where the blade tip moves backwards."""
    reach = np.abs(motion.harmonics).sum(axis=1).max() / radius * (1.0 + 1e-12)
    reach = reach + 4.0 * np.spacing(np.abs(targets))
    low, high, angle = targets - reach, targets + reach, targets.copy()
    last, slope = high - low, np.ones_like(targets)
    for _ in range(200):  # more than bisection needs
        value, rate = motion.at(angle)
        excess, slope = angle - targets + value / radius, 1.0 + rate / radius
        high, low = np.where(excess >= 0.0, angle, high), np.where(excess <= 0.0, angle, low)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = -excess / slope
        middle = 0.5 * (low + high) - angle
        inside = (angle + step >= low) & (angle + step <= high)
        step = np.where(inside & (np.abs(step) <= 0.5 * last), step, middle)
        angle, last = angle + step, np.abs(step)
        if np.all(last <= 2.0 * np.spacing(np.abs(targets) + reach)):
            break
    return np.where(slope > 0.0, angle, np.nan)
