"""Arrival times of the tip of a vibrating blade, from a periodic solution or a response curve."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from numbers import Integral

import numpy as np

from fenics_crack.arrivals.arrival_times import MOST_PASSAGES, ArrivalTimes, check_probes
from fenics_crack.arrivals.passages import Rotor, TipMotion, passing_angles
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.errors import InputError, check_count, check_number
from fenics_crack.model.matrices import numbers
from fenics_crack.numerics.fourier import to_complex

__all__ = ["tip_timing"]

JUMP = 1e-3
"""Of the frequency, relative: so near to a fold the motion may jump before it is reached."""


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

    The tip is at the angle W t + u(t) / R; it passes the probe at phi in revolution n where that
    is phi + 2 pi n. This is solved to rounding, with the Fourier series of the response (Heath and
    Imregun, International Journal of Mechanical Sciences 38, 1996, 1047); what answers contact
    forces at once, in lips without mass, is in it with its H harmonics. At time 0 the rotor's angle
    is 0 and the load begins its period.

    A curve is a run-up, or a run-down if it was followed downwards: the speed rises at constant
    acceleration from that of its first point to that of its last one, and the vibration is taken
    to be the steady one at each speed, interpolated between the points (of a curve over the load
    frequency :func:`refine_curve` makes more of them). So it is for slow sweeps alone. Where the
    curve turns back at a fold, the motion jumps to the part that it reaches beyond the fold, from
    the last point next to it that is stable.

    Parameters
    ----------
    result : PeriodicSolution or ResponseCurve
        The vibration; also one of twice the load's period.
    tip : int or mapping of int to float
        The dof that is the tip's displacement in the direction of rotation; or dofs with factors,
        whose sum it is: {dof: -1.0} where the dof points against the rotation.
    probes : (n_probes,) [rad]
        Angles of the probes from the tip's place at time 0, in the direction of rotation; from 0
        to 2 pi, increasing.
    tip_radius : float [m]
        R, distance of the tip from the axis.
    speed : float [rad/s]
        W; of a solution, where its frequency is no multiple of the speed (asynchronous).
    order : int
        In place of ``speed``: periods of the load in a revolution (engine order), W = omega /
        order; a curve needs it.
    revolutions : int
        How many; of a run-up all together.
    noise : float [s]
        Standard deviation of normal errors added to the arrivals, not to the marks of the shaft;
        shorter than a revolution.
    clock : float [s]
        Resolution, shorter than a revolution: arrivals are rounded to its multiples; 0: none.
    seed : int
        Of the noise.

    Returns
    -------
    ArrivalTimes
        Revolution by probe [s].

    Raises
    ------
    InputError
        A value cannot be used; the tip moves backwards and would pass a probe twice; the curve does
        not go from one speed to another, or is unstable on the way.

    Examples
    --------
    >>> arrivals = fc.tip_timing(
    ...     solution, tip, probes=[0.1, 0.5, 1.3, 3.1], tip_radius=0.4, order=6)
    """
    angles, shares = _places(probes, tip)
    check_number("tip_radius", tip_radius, 0.0, above=True)
    check_count("revolutions", revolutions, 1)
    if revolutions * len(angles) > MOST_PASSAGES:
        raise InputError("revolutions", revolutions, f"fewer: {MOST_PASSAGES:.0e} passages at most")
    check_number("noise", noise, 0.0)
    check_number("clock", clock, 0.0)
    check_count("seed", seed, 0)
    _check_speed(result, speed, order)
    result.structure.whole.check_dofs(list(shares))

    motion = _motion(result, shares, speed, order, revolutions)
    time = _arrivals(motion, angles, tip_radius)
    marks = motion.rotor.time(2.0 * np.pi * np.arange(revolutions + 1))
    turn = float(np.diff(marks).min())
    for key, value in (("noise", noise), ("clock", clock)):
        if value >= turn:
            raise InputError(key, value, f"less than a revolution takes, {turn:.3g} s")
    return ArrivalTimes(_measured(time, noise, clock, seed), marks, angles, float(tip_radius))


def _measured(time: np.ndarray, noise: float, clock: float, seed: int) -> np.ndarray:
    """Times [s] with normal errors, rounded to multiples of the clock's period."""
    if noise:
        time = time + noise * np.random.default_rng(seed).standard_normal(time.shape)
    return clock * np.round(time / clock) if clock else time


def _places(
    probes: Sequence[float] | np.ndarray, tip: int | Mapping[int, float]
) -> tuple[np.ndarray, Mapping[int, float]]:
    """Angles of the probes, and the dofs of the tip with their factors; checked."""
    angles = np.atleast_1d(numbers(probes))
    check_probes(angles)
    shares = tip if isinstance(tip, Mapping) else {tip: 1.0} if isinstance(tip, Integral) else {}
    if not shares:
        raise InputError("tip", tip, "a dof, or dofs with their factors")
    for dof, share in shares.items():
        check_number(f"tip[{dof!r}]", share)
    return angles, shares


def _arrivals(motion: TipMotion, angles: np.ndarray, radius: float) -> np.ndarray:
    """Times at which the tip passes the probes: (revolutions, probes) [s]."""
    backwards = motion.fastest_backwards() / radius
    targets = 2.0 * np.pi * np.arange(motion.rotor.revolutions)[:, None] + angles
    passed = passing_angles(motion, targets.ravel(), radius)
    if backwards >= 1.0 or np.any(np.isnan(passed)):
        allowed = (
            "so large that the tip never moves backwards, past a probe a second time: its "
            f"vibration reaches {backwards:.3g} of the speed of rotation"
        )
        raise InputError("tip_radius", radius, allowed)
    return motion.rotor.time(passed).reshape(targets.shape)


def _check_speed(
    result: PeriodicSolution | ResponseCurve, speed: float | None, order: int | None
) -> None:
    """Raise InputError unless the speed of rotation is known, once."""
    if isinstance(result, ResponseCurve):
        if speed is not None:
            raise InputError("speed", speed, "left out with a curve, which is a run-up; give order")
        if order is None:
            raise InputError("order", order, "given with a curve: periods of the load in a turn")
    elif (speed is None) == (order is None):
        raise InputError("speed, order", (speed, order), "one of them")
    if order is not None:
        check_count("order", order, 1)
    if speed is not None:
        check_number("speed", speed, 0.0, above=True)


def _motion(
    result: PeriodicSolution | ResponseCurve,
    shares: Mapping[int, float],
    speed: float | None,
    order: int | None,
    revolutions: int,
) -> TipMotion:
    """The tip's motion, at one speed or in a run-up (collective)."""
    if isinstance(result, ResponseCurve):
        assert order is not None
        return _run_up(result, shares, order, revolutions)
    turning = float(speed or result.omega / (order or 1))
    waves = result.coefficients_at(list(shares)) @ np.array(list(shares.values()), dtype=float)
    return TipMotion(
        Rotor(turning, turning, revolutions),
        np.array([turning]),
        to_complex(waves)[None],
        result.base_omega / turning,
    )


def _run_up(
    curve: ResponseCurve, shares: Mapping[int, float], order: int, revolutions: int
) -> TipMotion:
    """The tip's motion along a curve whose load frequency rises, or falls."""
    begin, end = float(curve.omega[0]), float(curve.omega[-1])
    if begin == end:
        raise InputError("result", f"a curve over {curve.parameter}", "one over the load frequency")
    rising = np.sign(end - begin) * curve.omega
    before = np.concatenate([[-np.inf], np.maximum.accumulate(rising)[:-1]])
    kept = rising > before
    if curve.multipliers is not None:
        kept &= ~_next_to_folds(rising, kept, curve.verdicts != "stable")
    if curve.multipliers is not None and np.any(curve.verdicts[kept] == "unstable"):
        at = float(curve.omega[kept & (curve.verdicts == "unstable")][0])
        allowed = "stable along the run-up, or a part that is, or its branch"
        raise InputError("result", f"unstable at {at:.6g} rad/s", allowed)
    waves = sum(float(share) * curve.coefficients_at(dof) for dof, share in shares.items())
    speeds, harmonics = curve.omega[kept] / order, to_complex(np.asarray(waves)[kept].T).T
    if end < begin:
        speeds, harmonics = speeds[::-1], harmonics[::-1]
    rotor = Rotor(begin / order, float(curve.omega[kept][-1]) / order, revolutions)
    return TipMotion(rotor, speeds, harmonics, order / curve.subharmonic)


def _next_to_folds(rising: np.ndarray, kept: np.ndarray, doubtful: np.ndarray) -> np.ndarray:
    """Points not known to be stable next to where the curve turns back, before which the motion
    jumps: (n,) bool.

    ``rising``: the frequency, rising along the run-up; ``kept``: points that it passes.
    """
    found = np.zeros(len(rising), dtype=bool)
    for fold in np.flatnonzero(kept[:-1] & ~kept[1:]):
        place = int(fold)
        while (
            place >= 0
            and doubtful[place]
            and rising[fold] - rising[place] < JUMP * abs(rising[fold])
        ):
            found[place] = True
            place -= 1
    return found
