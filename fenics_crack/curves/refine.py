"""Many more points on a curve in frequency, all at once.

Between the points that were followed one by one, others are interpolated by a cubic spline over the
distance along the curve, whose error falls like the fourth power of the distance. From there
Newton's method in the plane across the curve (:mod:`bordered`) makes a few steps, for hundreds of
points in the same calls of NumPy and LAPACK: a point costs a small part of one that is followed,
and half of it or more where the kernel follows (:mod:`fenics_crack.balance.compiled`).
Most points need one step or two. Those that are not solutions after a fixed number of steps are
left out. Where pairs are seen through a static compliance, which couples them, the same is done
point by point.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.interpolate import CubicSpline

from fenics_crack.balance.contact_integrals import contact_integrals, respond_to_columns
from fenics_crack.balance.family import FrequencyFamily
from fenics_crack.balance.problem import Problem
from fenics_crack.curves.bifurcations import attainable
from fenics_crack.curves.curve import ResponseCurve
from fenics_crack.curves.exact import verified
from fenics_crack.errors import ConvergenceError, InputError, check_count
from fenics_crack.model.contact import repeated
from fenics_crack.model.modal import all_modes
from fenics_crack.numerics.bordered import Tangent, solve_in_plane, step_in_plane
from fenics_crack.numerics.fourier import from_complex, to_complex
from fenics_crack.numerics.rounding import least_residual

__all__ = ["filled", "refine_curve"]

TOLERANCE = 1e-9
STEPS, MAX_BETWEEN = 4, 1000
PICTURE = 0.025
"""Largest distance between neighbours in a picture, relative to the range of the frequencies and to
the size of the solutions there."""
MAX_NUMBERS = 4_000_000
"""In the Jacobians of the points that are treated together."""


def filled(curve: ResponseCurve) -> ResponseCurve:
    """A curve for a picture: with the points of :func:`refine_curve`, or as it is where that cannot
    put any, and where each of them would ask for its stability."""
    if curve.multipliers is not None:
        return curve
    try:
        return refine_curve(curve)
    except (InputError, ConvergenceError):
        return curve


def refine_curve(curve: ResponseCurve, between: int | None = None) -> ResponseCurve:
    """Return a curve in frequency with more points between each two; judged if it was.

    Parameters
    ----------
    curve : ResponseCurve
        In the parameter "omega", with at least four points.
    between : int, optional
        Points to put between each two; default: as many as a picture needs, few or none where the
        curve has been followed by short steps. Those that Newton's method does not reach at once
        are left out.

    Raises
    ------
    InputError
        The curve is in another parameter, is too short, or its law differs from pair to pair and
        is not one of this package.
    ConvergenceError
        A point lies at an undamped resonance that the load drives.
    """
    if between is not None:
        check_count("between", between, 1)
        if between > MAX_BETWEEN:
            raise InputError("between", between, f"at most {MAX_BETWEEN}")
    if curve.parameter != "omega":
        raise InputError("curve", f"in {curve.parameter!r}", "in 'omega'")
    if len(curve) < 4:
        raise InputError("curve", f"{len(curve)} points", "at least 4")
    span = float(np.ptp(curve.omega)) or 1.0
    flat = curve.unknowns.reshape(len(curve), -1)
    size = float(np.linalg.norm(flat, axis=1).mean()) or 1.0
    place = np.hstack([flat / size, curve.omega[:, None] / span])
    # Equal neighbours would have no distance.
    distance = np.maximum(np.linalg.norm(np.diff(place, axis=0), axis=1), 1e-12)
    along = np.concatenate([[0.0], np.cumsum(distance)])
    added = np.full(len(distance), between or 0)
    if between is None:
        added = np.minimum(_for_a_picture(flat, curve.omega / span), MAX_BETWEEN)
    gap = np.repeat(np.arange(len(added)), added)
    number = np.arange(1, len(gap) + 1) - (np.cumsum(added) - added)[gap]
    wanted = along[gap] + number / (added[gap] + 1) * distance[gap]
    counts = np.maximum(curve.harmonics[:-1], curve.harmonics[1:])[gap]

    spline, pairs = CubicSpline(along, place), curve.unknowns.shape[2]
    unknowns = np.zeros((curve.unknowns.shape[1], len(wanted), pairs))
    omegas, iterations = np.empty(len(wanted)), np.zeros(len(wanted), dtype=int)
    for count in np.unique(counts):
        rows = 2 * int(count) + 1
        chunk = max(1, MAX_NUMBERS // (rows * pairs) ** 2)
        problem = curve.problem.with_harmonics(int(count))
        coupled = problem.residual is not None
        system = (_OneByOne if coupled else _Together)(problem, span)
        chosen = np.flatnonzero(counts == count)
        for some in np.array_split(chosen, -(-len(chosen) // chunk)):
            guess, slope = (
                _split(spline(wanted[some], order), size, pairs, rows) for order in (0, 1)
            )
            plane = Tangent(*slope, size**-2)  # of many points
            found = system.correct(*guess, plane)
            unknowns[:rows, some], omegas[some], iterations[some] = found
    new = unknowns.transpose(1, 0, 2)
    return _merged(curve, (along, wanted), new, omegas, counts, iterations)


def _for_a_picture(flat: np.ndarray, parameter: np.ndarray) -> np.ndarray:
    """How many points a picture needs between each two of n: (n-1,)."""
    lengths = np.linalg.norm(flat, axis=1)
    sizes = np.maximum(np.maximum(lengths[1:], lengths[:-1]), 1e-300)
    change = np.linalg.norm(np.diff(flat, axis=0), axis=1) / sizes
    distance = np.hypot(change, np.diff(parameter))
    return np.maximum(np.ceil(distance / PICTURE).astype(int) - 1, 0)


def _split(place: np.ndarray, size: float, pairs: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns (2H+1, n, n_pairs) [m] and parameters (n, 1) of places along the spline."""
    unknown = size * place[:, :-1].reshape(len(place), -1, pairs)[:, :rows]
    return unknown.transpose(1, 0, 2), place[:, -1:]


class _OneByOne:
    """The equations of pairs seen through a static compliance, p = w / span, point by point."""

    def __init__(self, problem: Problem, span: float) -> None:
        self._family = FrequencyFamily(problem, problem.omega, problem.omega + span)
        self._sharp = attainable(self._family, 0.5, TOLERANCE)

    def correct(
        self, unknown: np.ndarray, parameter: np.ndarray, plane: Tangent
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """As :meth:`_Together.correct`."""
        family, unknown, places = self._family, unknown.copy(), parameter[:, 0]
        omega, count = np.full(len(places), np.nan), np.full(len(places), STEPS)
        first = family.start / (family.end - family.start)
        slopes = np.ravel(plane.p)
        for number, place in enumerate(places):
            across = Tangent(plane.x[:, number], float(slopes[number]), plane.weight)
            found = solve_in_plane(
                family, unknown[:, number], float(place) - first, across,
                tolerance=self._sharp, iterations=STEPS,
            )  # fmt: skip
            if found is not None:
                unknown[:, number], count[number] = found.unknown, found.iterations
                omega[number] = family.value(found.parameter)
        return unknown, omega, count


class _Together:
    """F(g, p) = 0 at many points at once: gaps (2H+1, n, n_pairs), p = w / span (n, 1)."""

    def __init__(self, problem: Problem, span: float) -> None:
        self.problem, self.span = problem, span
        self.modes = all_modes(problem.structure)
        self.order = np.arange(problem.harmonics + 1.0)
        self.load = to_complex(problem.load @ self.modes.shapes)[:, None]

    def correct(
        self, gap: np.ndarray, parameter: np.ndarray, plane: Tangent
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gaps and frequencies (n,) after a few steps, nan where these did not do; their number."""
        gap, parameter = gap.copy(), parameter.copy()
        count, left = np.full(len(parameter), STEPS), np.arange(len(parameter))
        for step in range(STEPS + 1):
            at = _Points(self, gap[:, left], self.span * parameter[left, 0])
            count[left[at.good]] = step
            left = left[~at.good]
            if not len(left) or step == STEPS:
                break
            across = Tangent(plane.x[:, left], plane.p[left], plane.weight)  # type: ignore[index]
            change, shift = at.step(across)
            gap[:, left] += change
            parameter[left] += shift
        parameter[left] = np.nan
        return gap, self.span * parameter[:, 0], count


class _Points:
    """The equations at points, whether they hold, and a step for those where they do not."""

    def __init__(self, system: _Together, gap: np.ndarray, omega: np.ndarray) -> None:
        problem, modes = system.problem, system.modes
        structure, pairs = problem.structure, gap.shape[2]
        self._system, self._base = system, omega / problem.subharmonic
        frequency = np.multiply.outer(system.order, self._base)
        loaded = np.broadcast_to(system.load != 0.0, (*frequency.shape, len(modes.squares)))
        receptance = modes.receptance(
            frequency.ravel(), loaded=loaded.reshape(-1, len(modes.squares))
        )
        self._receptance = receptance.reshape(*frequency.shape, *receptance.shape[1:])
        self._matrices = modes.seen_by_pairs(self._receptance)
        law = repeated(problem.contact, len(omega))
        integrals = contact_integrals(law, problem.harmonics, problem.samples, problem.subharmonic)
        found = integrals.linearise(gap.reshape(len(gap), -1))
        self._tangent = found.tangent.reshape(len(omega), pairs, len(gap), len(gap))
        drive = to_complex(found.force.reshape(gap.shape)) @ modes.pairs.T - system.load
        self._moved = modes.respond(self._receptance, drive)
        self._residual = gap + from_complex(self._moved @ modes.pairs)
        self._residual[0] += structure.clearance
        rounding = np.abs(self._matrices).sum(axis=-1).max() * np.max(law.stiffness)
        tolerance = max(TOLERANCE, least_residual(4.0 * float(rounding)))
        self.good = np.linalg.norm(self._residual, axis=(0, 2)) <= tolerance * np.linalg.norm(
            gap, axis=(0, 2)
        )

    def step(self, plane: Tangent) -> tuple[np.ndarray, np.ndarray]:
        """Newton's step (dg, dp) in the planes of the points that are not good."""
        rest = ~self.good
        residual = self._residual[:, rest]
        matrices = self._matrices[:, rest].swapaxes(0, 1)
        jacobian = respond_to_columns(matrices, self._tangent[rest])
        diagonal = np.arange(jacobian.shape[-1])
        jacobian[:, diagonal, diagonal] += 1.0
        both = np.stack([residual, self._by_parameter(rest)], axis=-1).swapaxes(0, 1)
        found = np.linalg.solve(jacobian, -both.reshape(*jacobian.shape[:2], 2))
        change, slope = found.reshape(both.shape).swapaxes(0, 1).transpose(3, 0, 1, 2)
        return step_in_plane(plane, change, slope, _inner)

    def _by_parameter(self, rest: np.ndarray) -> np.ndarray:
        """dF/dp, as :meth:`ModalCompliance.frequency_derivative`."""
        system, modes = self._system, self._system.modes
        order, moved = system.order[:, None, None], self._moved[:, rest]
        damped = modes.damped(moved)
        rate = order * (1j * damped - 2.0 * order * self._base[rest, None] * moved)
        change = modes.respond(self._receptance[:, rest], rate)
        scale = -system.span / system.problem.subharmonic
        return scale * from_complex(change @ modes.pairs)


def _inner(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Inner product of the gaps of each point: (n, 1)."""
    return np.einsum("rnp,rnp->n", first, second)[:, None]


def _merged(
    curve: ResponseCurve,
    along: tuple[np.ndarray, np.ndarray],
    unknowns: np.ndarray,
    omegas: np.ndarray,
    counts: np.ndarray,
    iterations: np.ndarray,
) -> ResponseCurve:
    """The old and the new points in order; ``along``: where they lie."""
    good = np.isfinite(omegas)
    order = np.argsort(np.concatenate([along[0], along[1][good]]), kind="stable")

    def both(old: np.ndarray, new: np.ndarray) -> np.ndarray:
        return np.concatenate([old, new])[order]

    omega = both(curve.omega, omegas[good])
    merged = replace(
        curve,
        values=omega,
        omega=omega,
        unknowns=both(curve.unknowns, unknowns[good]),
        harmonics=both(curve.harmonics, counts[good]),
        iterations=both(curve.iterations, iterations[good]),
        truncation=both(curve.truncation, np.full(good.sum(), np.nan)),
        multipliers=None,
        undecided=None,
    )
    return merged if curve.multipliers is None else verified(merged)
