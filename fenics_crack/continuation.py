"""Response curves: solutions followed over the load's frequency, through resonances and folds.

Pseudo-arc-length continuation (:mod:`arclength`) of the condensed equations

    F(g, w) = g - g_lin(w) + R(w) b(g) = 0

with the parameter p = (w - w_start) / (w_end - w_start). Only the small or reduced structure is
touched at a point, in closed form: a curve costs the same on any mesh.
"""

from __future__ import annotations

import math
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy.optimize
from tqdm import tqdm

from fenics_crack.arclength import PathPoint, follow_path, step_along
from fenics_crack.compliance import dynamic_compliance, is_small
from fenics_crack.condensed import CondensedSystem
from fenics_crack.contact import ContactLaw, check_law
from fenics_crack.contact_integrals import contact_integrals
from fenics_crack.error_report import estimate_errors
from fenics_crack.errors import (
    ConvergenceError,
    InputError,
    check_count,
    check_number,
    check_omega,
)
from fenics_crack.family import FrequencyFamily
from fenics_crack.harmonic_balance import solve_harmonic_balance
from fenics_crack.reduction import reduce_structure
from fenics_crack.solution import PeriodicSolution
from fenics_crack.stability import PiecewiseFlow
from fenics_crack.structure import Structure

__all__ = ["Bifurcation", "ResponseCurve", "continue_frequency"]


@dataclass(frozen=True)
class Bifurcation:
    """A special point of a curve.

    Attributes
    ----------
    kind : str
        "fold": the curve turns back in frequency; "branch_point": another branch crosses;
        "period_doubling": a multiplier leaves the unit circle through -1; "neimark_sacker": a pair
        of them leaves it anywhere else. The last two only with ``stability=True``.
    omega : float [rad/s]
        Where.
    gap_coefficients : (2H+1, n_pairs) [m]
        The solution there.
    solution : PeriodicSolution
        The same, with its displacement and error report.
    """

    kind: str
    omega: float
    gap_coefficients: np.ndarray
    solution: PeriodicSolution


@dataclass(frozen=True)
class ResponseCurve:
    """Solutions along a curve, in the order in which it was followed.

    Attributes
    ----------
    structure : Structure
        Whose solutions they are: small or reduced.
    contact : ContactLaw
        Law of all pairs.
    omega : (n,) [rad/s]
        Load frequencies.
    gap_coefficients : (n, 2H+1, n_pairs) [m]
        Closing of the pairs.
    iterations : (n,) int
        Newton iterations of each point.
    bifurcations : tuple of Bifurcation
        Special points, in order along the curve.
    complete : bool
        Whether the curve reached the end that was asked for.
    status : str
        How it ended.
    samples, subharmonic : int or None, int
        As given to :func:`continue_frequency`.
    multipliers : (n, 2 n_dofs) complex or None
        Floquet multipliers, largest first; with ``stability=True``.
    """

    structure: Structure
    contact: ContactLaw
    omega: np.ndarray
    gap_coefficients: np.ndarray
    iterations: np.ndarray
    bifurcations: tuple[Bifurcation, ...]
    complete: bool
    status: str
    samples: int | None
    subharmonic: int
    multipliers: np.ndarray | None = None

    @property
    def stable(self) -> np.ndarray:
        """Whether the largest multiplier lies within the unit circle: (n,) bool.

        Raises
        ------
        InputError
            The curve was followed without ``stability=True``.
        """
        if self.multipliers is None:
            raise InputError("stability", False, "True when the curve is followed")
        return np.abs(self.multipliers[:, 0]) < 1.0

    @property
    def harmonics(self) -> int:
        """H."""
        return self.gap_coefficients.shape[1] // 2

    def solution(self, index: int) -> PeriodicSolution:
        """The solution at a point, with its displacement and error report."""
        return _solution(
            self.structure,
            float(self.omega[index]),
            self.contact,
            self.gap_coefficients[index],
            self.samples,
            self.subharmonic,
        )

    @property
    def solutions(self) -> list[PeriodicSolution]:
        """The solutions at all points."""
        return [self.solution(index) for index in range(len(self.omega))]

    def save(self, path: str | Path) -> None:
        """Write the curve to a NumPy archive (.npz): numbers and words only, nothing executable."""
        parts: dict[str, Any] = {
            "omega": self.omega,
            "gap_coefficients": self.gap_coefficients,
            "iterations": self.iterations,
            "kinds": np.array([b.kind for b in self.bifurcations], dtype="U32"),
            "bifurcation_omega": np.array([b.omega for b in self.bifurcations]),
            "bifurcation_gaps": np.array([b.gap_coefficients for b in self.bifurcations]),
            "complete": np.array(self.complete),
            "status": np.array(self.status),
            "samples": np.array(self.samples or 0),
            "subharmonic": np.array(self.subharmonic),
        }
        if self.multipliers is not None:
            parts["multipliers"] = self.multipliers
        np.savez_compressed(path, **parts)

    @classmethod
    def load(cls, path: str | Path, structure: Structure, contact: ContactLaw) -> ResponseCurve:
        """Read a curve written by :meth:`save`; nothing is solved again.

        Parameters
        ----------
        path : str or Path
            The file.
        structure, contact : Structure, ContactLaw
            Those with which the curve was followed.

        Raises
        ------
        InputError
            The file is not one of :meth:`save`, or the structure has other pairs.
        """
        try:
            with np.load(path, allow_pickle=False) as archive:
                parts = {name: archive[name] for name in archive.files}
            gaps = parts["gap_coefficients"]
            samples = int(parts["samples"]) or None
            subharmonic = int(parts["subharmonic"])
            special = list(
                zip(
                    parts["kinds"],
                    parts["bifurcation_omega"],
                    parts["bifurcation_gaps"],
                    strict=True,
                )
            )
            omega, iterations = parts["omega"], parts["iterations"]
            complete, status = bool(parts["complete"]), str(parts["status"])
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise InputError("path", str(path), f"a curve written by save ({error})") from None
        if gaps.ndim != 3 or gaps.shape[2] != structure.n_pairs:
            raise InputError(
                "structure", f"{structure.n_pairs} pairs", f"one with {gaps.shape[-1]} pairs"
            )
        return cls(
            structure,
            contact,
            omega,
            gaps,
            iterations,
            tuple(
                Bifurcation(
                    str(kind),
                    float(at),
                    gap,
                    _solution(structure, float(at), contact, gap, samples, subharmonic),
                )
                for kind, at, gap in special
            ),
            complete,
            status,
            samples,
            subharmonic,
            parts.get("multipliers"),
        )

    def amplitude(self, dof: int) -> np.ndarray:
        """Half the peak-to-peak displacement of a dof at every point: (n,) [m], of 256 instants."""
        integrals = contact_integrals(self.contact, self.harmonics, self.samples, self.subharmonic)
        phase = 2.0 * np.pi * np.arange(256) / 256
        order = np.arange(1, self.harmonics + 1)
        basis = np.ones((len(phase), 2 * self.harmonics + 1))
        basis[:, 1::2] = np.cos(np.outer(phase, order))
        basis[:, 2::2] = np.sin(np.outer(phase, order))
        found = np.empty(len(self.omega))
        for index, (omega, gap) in enumerate(zip(self.omega, self.gap_coefficients, strict=True)):
            compliance = dynamic_compliance(
                self.structure, omega / self.subharmonic, self.harmonics, self.subharmonic
            )
            rows = compliance.displacement(integrals.force(gap))
            found[index] = np.ptp(basis @ self.structure.values_at(rows, [dof])[:, 0]) / 2.0
        return found


def continue_frequency(
    structure: Structure,
    omega_start: float,
    omega_end: float,
    contact: ContactLaw,
    *,
    harmonics: int = 5,
    samples: int | None = None,
    subharmonic: int = 1,
    initial: PeriodicSolution | None = None,
    stability: bool = False,
    longest_step: float = 0.05,
    most_points: int = 20000,
    progress: bool = False,
    throw: bool = True,
) -> ResponseCurve:
    """Follow the response from one load frequency to another, through resonances and folds.

    Parameters
    ----------
    structure : Structure
        What vibrates. One with many dofs is reduced first (:func:`reduce_structure`, its default).
    omega_start, omega_end : float
        Load frequencies [rad/s]; the end may be below the start.
    contact : ContactLaw
        Law of all pairs.
    harmonics, samples, subharmonic, initial
        As in :func:`solve_harmonic_balance`; ``initial`` is where to start at ``omega_start``.
    stability : bool
        Compute Floquet multipliers at every point, and locate where stability changes.
    longest_step : float
        Longest step, relative to the range of frequencies and to the size of the solution.
    most_points : int
        Give up after so many.
    progress : bool
        Show a progress bar.
    throw : bool
        Raise if the end is not reached; else return what was found, ``complete`` being False.
        Ctrl-C always returns what was found.

    Raises
    ------
    InputError
        An argument cannot be used.
    ConvergenceError
        No first point, or the end was not reached.
    """
    check_omega(omega_start, "omega_start")
    check_omega(omega_end, "omega_end")
    if omega_start == omega_end:
        raise InputError("omega_end", omega_end, "different from omega_start")
    check_number("longest_step", longest_step, 0.0, above=True)
    check_count("most_points", most_points, 1)
    check_law(structure, contact)
    if not is_small(structure):
        structure = reduce_structure(structure)
    first = solve_harmonic_balance(
        structure,
        omega_start,
        contact,
        harmonics=harmonics,
        samples=samples,
        subharmonic=subharmonic,
        initial=initial,
    )
    family = FrequencyFamily(
        structure, omega_start, omega_end, contact, first.harmonics, samples, subharmonic
    )
    gaps, omegas, counts = [first.gap_coefficients], [omega_start], [first.iterations]
    special: list[tuple[str, PathPoint]] = []
    flow = PiecewiseFlow(structure, contact) if stability else None
    multipliers: list[np.ndarray] = []
    if flow is not None:
        multipliers.append(flow.multipliers(first.gap_coefficients, first.base_omega))
    status, complete = "the steps became too short", False
    before: PathPoint | None = None
    hidden = not progress or structure.whole.comm.rank != 0
    bar = tqdm(total=100.0, desc="curve", unit="%", disable=hidden, bar_format="{l_bar}{bar}")
    try:
        for point in follow_path(
            family,
            first.gap_coefficients,
            0.0,
            step=0.2 * longest_step,
            longest_step=longest_step,
            most_steps=most_points,
            tolerance=1e-9,
            shortest_step=1e-10,
            least_cosine=0.85,
        ):
            if point.crosses_branch:
                special.append(("branch_point", point))
            if before is not None and point.tangent.p * before.tangent.p < 0.0:
                fold = _locate(family, before, point, lambda at: at.tangent.p)
                special.append(("fold", fold))
            if point.parameter >= 1.0:
                landed = family.land(point, before)
                if landed is None:
                    status = "no solution at the very end"
                    break
                point, complete, status = landed, True, "reached the end"
            if flow is not None:
                multipliers.append(flow.multipliers(point.unknown, family.base(point.parameter)))
                if before is not None:
                    special += _changes(family, flow, before, point, multipliers[-2:])
            gaps.append(point.unknown)
            omegas.append(family.omega(point.parameter))
            counts.append(point.iterations)
            before = point
            bar.update(max(0.0, 100.0 * min(1.0, point.parameter) - bar.n))
            if complete:
                break
            if point.parameter < -0.02:
                status = "the curve turned back past its start"
                break
        else:
            if len(gaps) > most_points:
                status = f"{most_points} points were not enough"
    except KeyboardInterrupt:
        status, throw = "interrupted", False
    except ConvergenceError as error:
        status = str(error)
    finally:
        bar.close()
    curve = ResponseCurve(
        structure,
        contact,
        np.array(omegas),
        np.array(gaps),
        np.array(counts),
        tuple(
            Bifurcation(
                kind,
                family.omega(at.parameter),
                at.unknown,
                _solution(
                    structure,
                    family.omega(at.parameter),
                    contact,
                    at.unknown,
                    samples,
                    subharmonic,
                ),
            )
            for kind, at in special
        ),
        complete,
        status,
        samples,
        subharmonic,
        np.array(multipliers) if stability else None,
    )
    if throw and not complete:
        raise ConvergenceError(
            f"curve from {omega_start:g} to {omega_end:g} rad/s: {status} at "
            f"{omegas[-1]:g} rad/s after {len(omegas)} points"
        )
    return curve


def _changes(
    family: FrequencyFamily,
    flow: PiecewiseFlow,
    before: PathPoint,
    after: PathPoint,
    multipliers: list[np.ndarray],
) -> list[tuple[str, PathPoint]]:
    """Where multipliers cross the unit circle at -1, or as a pair, between two points."""

    def at(test: Callable[[np.ndarray], float]) -> Callable[[PathPoint], float]:
        return lambda point: test(flow.multipliers(point.unknown, family.base(point.parameter)))

    found = []
    for kind, test in (("period_doubling", _doubling), ("neimark_sacker", _pair)):
        if test(multipliers[0]) * test(multipliers[1]) < 0.0:
            found.append((kind, _locate(family, before, after, at(test))))
    return found


def _doubling(multipliers: np.ndarray) -> float:
    """det(I + M), scaled: changes its sign where a multiplier passes through -1."""
    return float(np.prod((1.0 + multipliers) / (1.0 + np.abs(multipliers))).real)


def _pair(multipliers: np.ndarray) -> float:
    """Largest modulus of the complex multipliers less one."""
    paired = multipliers[np.abs(multipliers.imag) > 1e-6 * np.abs(multipliers)]
    return float(np.abs(paired).max() - 1.0) if len(paired) else -1.0


def _locate(
    family: FrequencyFamily,
    before: PathPoint,
    after: PathPoint,
    test: Callable[[PathPoint], float],
) -> PathPoint:
    """Point between two others where a test function vanishes, by the method of Brent.

    Where that fails, the point met at which the function is smallest.
    """
    weight = before.tangent.weight
    distance = math.sqrt(
        weight * family.inner(after.unknown - before.unknown, after.unknown - before.unknown)
        + (after.parameter - before.parameter) ** 2
    )
    met = [before, after]

    def value(step: float) -> float:
        point = before if step == 0.0 else step_along(family, before, step, 1e-11)
        if point is None:
            raise ConvergenceError("curve: lost between two points")
        met.append(point)
        return test(point)

    for reach in (1.0, 1.2, 0.8, 1.5):  # along the tangent the other point is not quite as far
        try:
            scipy.optimize.brentq(value, 0.0, reach * distance, xtol=1e-12, rtol=1e-12)
            break
        except (ConvergenceError, ValueError):
            continue
    return min(met, key=lambda point: abs(test(point)))


def _solution(
    structure: Structure,
    omega: float,
    contact: ContactLaw,
    gap: np.ndarray,
    samples: int | None,
    subharmonic: int,
) -> PeriodicSolution:
    """Expand a gap to the solution that it belongs to."""
    harmonics = len(gap) // 2
    integrals = contact_integrals(contact, harmonics, samples, subharmonic)
    base = omega / subharmonic
    compliance = dynamic_compliance(structure, base, harmonics, subharmonic)
    system = CondensedSystem(compliance, integrals)
    force = integrals.force(gap)
    displacement = compliance.displacement(force)
    return PeriodicSolution(
        structure,
        omega,
        contact,
        displacement,
        gap,
        force,
        subharmonic=subharmonic,
        status="point of a curve",
        report=estimate_errors(system, gap, structure, displacement, base, subharmonic),
    )
