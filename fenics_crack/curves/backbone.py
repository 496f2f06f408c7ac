"""Nonlinear normal modes: free periodic motions followed over their energy.

    M u'' + K u + B lambda(g) = 0,      g = B^T u - g0,

without load and damping; clearance and preload stay. Time can be reversed, so a motion at rest at
t = 0 is a cosine series about the equilibrium u_e. In modal coordinates, u = u_e + Phi q,

    q_j(t) = a sum_{k=0}^{H} (z_jk / omega_j) cos(k w t),      a^2 = 2 E,

    (omega_j^2 - (k w)^2) a z_jk / omega_j + phi_j^T B (b_k(g) - b_k(g_e)) = 0,

b_k the cosine coefficients of the contact force. The unknowns are z and w; the parameter is ln E,
E the energy of the motion, by one more equation at t = 0, where nothing moves:

    1/2 |sum_k a z_k|^2 + sum over pairs int_{g_e}^{g(0)} (lambda - lambda_e) dg = E.

Unlike the compliance R, displacements stay finite in resonance, and that is where these motions
live. Contact couples the z_jk through few pairs only: the Jacobian is diagonal plus low rank. All
entries are eliminated but those with k w close to omega_j; what is left is a dense system in the
gaps, these entries and w, whose size does not depend on the number of dofs.

Where a multiple of w meets another mode's frequency, two pieces of the family end in that mode's
motion, from either side: a tongue. Newton's method at the next energy passes over a narrow one,
for the motion found there has the same shape but for the entry in resonance, whose sign is the
opposite; det J changes its sign.

Source: Kerschen, Peeters, Golinval, Vakakis, Mechanical Systems and Signal Processing 23 (2009)
170-194; Krack, Gross, Harmonic Balance for Nonlinear Vibration Problems, 2019, section 2.6.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
from tqdm import tqdm

from fenics_crack.balance.arclength import follow_path
from fenics_crack.balance.contact_integrals import ContactIntegrals, contact_integrals
from fenics_crack.balance.error_report import ErrorReport, mean_square
from fenics_crack.balance.fourier import resized, to_complex
from fenics_crack.balance.search import SOFT
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.free_motion import EnergyMotion, Equilibrium, StiffnessMotion, cosine_rows
from fenics_crack.errors import ConvergenceError, InputError, check_count, check_number
from fenics_crack.model.contact import ContactLaw, check_law
from fenics_crack.model.modal import all_modes, is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.table import Tabular, counted

__all__ = ["Backbone", "follow_backbone"]


FAST = 0.5
"""Rate of the parameter along a path at which arc-length is left again."""
ELSEWHERE = "the path ended in the motion of another mode"


@dataclass(frozen=True, repr=False)
class Backbone(Tabular):
    """Free periodic motions of one mode, in the order in which they were followed.

    Attributes
    ----------
    structure : Structure
        Whose motions they are: small or reduced. Its load and its damping take no part.
    contact : ContactLaw
        Law of all pairs.
    mode : int
        Number of the mode, from 1.
    omega : (n,) [rad/s]
        Frequencies.
    energy : (n,) [J]
        Total energy, which each motion conserves: strain and contact energy at t = 0.
    rest_energy : float [J]
        The part of it that the equilibrium holds; not 0 with preload.
    cosines : (n, H+1, n_dofs) [m]
        Coefficients of cos(k w t) of the structure's displacement.
    iterations : (n,) int
        Newton iterations of each point.
    complete : bool
        Whether the energy asked for was reached.
    status : str
        How it ended.
    jumps : (n,) bool
        Whether an internal resonance has been passed over since the point before.
    samples : int or None
        As given to :func:`follow_backbone`.
    """

    structure: Structure
    contact: ContactLaw
    mode: int
    omega: np.ndarray
    energy: np.ndarray
    rest_energy: float
    cosines: np.ndarray
    iterations: np.ndarray
    complete: bool
    status: str
    jumps: np.ndarray
    samples: int | None

    KIND: ClassVar[str] = "backbone"

    @property
    def harmonics(self) -> int:
        """H."""
        return self.cosines.shape[1] - 1

    @property
    def fundamental(self) -> np.ndarray:
        """Share of the first harmonic in the strain energies of all, the mean left out: (n,).

        Where it is small the backbone has gone over into the motion of another mode.
        """
        modes = all_modes(self.structure)
        modal = self.cosines[:, 1:] @ np.linalg.inv(modes.shapes).T
        squares = np.sum(modes.squares * modal**2, axis=2)
        return squares[:, 0] / np.sum(squares, axis=1)

    def solution(self, index: int) -> PeriodicSolution:
        """The motion at a point as a solution of the equations without load and damping.

        Of its report the residual and the truncation are estimated, the rest is nan.
        """
        shape = (2 * self.harmonics + 1, self.structure.n_dofs)
        rows = np.zeros(shape)
        rows[cosine_rows(self.harmonics)] = self.cosines[index]
        gap = self.structure.closing(rows)
        gap[0] -= self.structure.clearance
        integrals = contact_integrals(self.contact, self.harmonics, self.samples)
        return PeriodicSolution(
            self.structure,
            float(self.omega[index]),
            self.contact,
            rows,
            gap,
            integrals.force(gap),
            status="point of a backbone",
            iterations=int(self.iterations[index]),
            report=self._report(index),
        )

    def _report(self, index: int) -> ErrorReport:
        """The first Newton step with more harmonics, at the same energy."""
        rest = Equilibrium(self.structure, self.contact)
        harmonics = max(4 * self.harmonics, self.harmonics + 8)
        integrals = contact_integrals(self.contact, self.harmonics, self.samples)
        motion = EnergyMotion(rest, integrals.widened(harmonics), float(self.omega[index]))
        motion.energy = float(self.energy[index]) - self.rest_energy
        modal = np.linalg.solve(rest.modes.shapes, self.cosines[index].T).T
        modal[0] -= rest.modal
        start = np.append(np.zeros((harmonics + 1) * len(rest.modes.squares)), 1.0)
        z = start[:-1].reshape(harmonics + 1, -1)
        z[: self.harmonics + 1] = modal * rest.frequencies / motion.amplitude
        motion.linearise(start)
        wave = np.zeros((2 * harmonics + 1, self.structure.n_pairs))
        wave[cosine_rows(harmonics)] = z @ motion.gap_rows
        size = mean_square(wave)
        missing = motion.residual(start)
        blocks = missing[:-1].reshape(harmonics + 1, -1)
        known = np.append(blocks[: self.harmonics + 1].ravel(), missing[-1])
        blocks[: self.harmonics + 1] = 0.0
        missing[-1] = 0.0
        step = motion.solve_jacobian(missing)[:-1].reshape(harmonics + 1, -1)
        wave[cosine_rows(harmonics)] = step @ motion.gap_rows
        truncation = math.sqrt(mean_square(wave) / size) if size > 0.0 else 0.0
        residual = float(np.linalg.norm(known) / np.linalg.norm(start))
        return ErrorReport(residual, truncation, math.nan, math.nan, math.nan)

    def amplitude(self, dof: int) -> np.ndarray:
        """Half the peak-to-peak displacement of a dof at every point: (n,) [m], of 256 instants."""
        points, terms, dofs = self.cosines.shape
        values = self.structure.values_at(self.cosines.reshape(-1, dofs), [dof])
        phase = 2.0 * np.pi * np.arange(256) / 256
        waves = values.reshape(points, terms) @ np.cos(np.outer(np.arange(terms), phase))
        return np.ptp(waves, axis=1) / 2.0

    # --- shown ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every motion."""
        return {
            "omega": self.omega.tolist(),
            "energy": self.energy.tolist(),
            "iterations": self.iterations.tolist(),
            "jump": self.jumps.tolist(),
        }

    def _title(self) -> str:
        parts = [
            f"mode {self.mode}",
            f"{self.omega[0]:.6g} to {self.omega[-1]:.6g} rad/s",
            f"{self.energy[0]:.3g} to {self.energy[-1]:.3g} J",
            counted(len(self.omega), "point"),
            f"H = {self.harmonics}",
        ]
        return ", ".join([*parts, "complete" if self.complete else "NOT COMPLETE"])


def follow_backbone(
    structure: Structure,
    contact: ContactLaw,
    mode: int,
    energy_start: float,
    energy_end: float,
    *,
    harmonics: int = 10,
    samples: int | None = None,
    initial: PeriodicSolution | None = None,
    internal_resonances: bool = False,
    longest_step: float = 0.2,
    most_points: int = 2000,
    progress: bool = False,
    throw: bool = True,
) -> Backbone:
    """Follow a nonlinear normal mode over its energy: the backbone of its resonance.

    The linear mode of the structure without contact is followed in ln k, the contact stiffness, at
    ``energy_start``, and from there in ln E: by steps in the parameter, and by arc-length, through
    folds, where there is no motion of the same shape a step further.

    Where a multiple of the frequency meets that of another mode (an internal resonance), the
    backbone goes over into the motion of that mode, and on the other side another piece of it comes
    from there. Without damping there are many such tongues, most of them narrow. They are passed
    over where a motion of the same shape is found beyond; else they are followed. Broad ones,
    with stiff contact, many modes and many harmonics, can end the path: fewer harmonics, or a
    structure reduced to fewer modes, have fewer of them.
    At the start, a motion whose first harmonic is small is taken for another mode's, and refused;
    on the way, :attr:`Backbone.fundamental` tells it. Next to a tongue, and where one was passed
    over, another motion of the same energy may exist.

    Where all clearances are zero, the penalty law makes the equations homogeneous: a motion times
    any positive factor is a motion, and the frequency does not depend on the energy. The backbone
    is then a straight line, one motion at growing energies.

    Parameters
    ----------
    structure : Structure
        What vibrates; its load, mean load included, and its damping are left out. One with many
        dofs is reduced first (:func:`reduce_structure`, its default).
    contact : ContactLaw
        Law of all pairs. With preload, contact grows about the equilibrium held fixed.
    mode : int
        Number of the linear mode, 1 the lowest.
    energy_start, energy_end : float
        Energy of the motion [J], above that of the equilibrium; the end is above the start.
    harmonics, samples : int, int or None
        As in :func:`solve_harmonic_balance`.
    initial : PeriodicSolution, optional
        Start from the motion next to this solution, scaled to ``energy_start``, and not from the
        linear mode: for example from a peak of the response with little damping.
    internal_resonances : bool
        Follow all tongues that the steps resolve; a path need not come out of them again.
    longest_step : float
        Longest step, relative to the size of the motion's shape and in ln E.
    most_points : int
        Give up after so many.
    progress : bool
        Show a progress bar.
    throw : bool
        Raise if the end is not reached; else return what was found, ``complete`` being False.
        Ctrl-C always returns what was found.

    Returns
    -------
    Backbone
        At t = 0 and after half a period nothing moves; at the start, t = 0 is where the pairs are
        further open.

    Raises
    ------
    InputError
        An argument cannot be used, or the structure can move as a rigid body.
    ConvergenceError
        No equilibrium or no first motion was found, or the end was not reached.

    Notes
    -----
    Source: Kerschen, Peeters, Golinval, Vakakis, Mechanical Systems and Signal Processing 23 (2009)
    170-194.
    """
    check_number("energy_start", energy_start, 0.0, above=True)
    check_number("energy_end", energy_end, energy_start, above=True)
    check_number("longest_step", longest_step, 0.0, above=True)
    check_count("most_points", most_points, 1)
    check_count("harmonics", harmonics, 1)
    if samples is not None:
        check_count("samples", samples, 4 * harmonics + 1)
    check_law(structure, contact)
    check_count("mode", mode, 1)
    if not is_small(structure):
        structure = reduce_structure(structure)
    if mode > structure.n_dofs:
        raise InputError("mode", mode, f"at most {structure.n_dofs}, the number of dofs")
    rest = Equilibrium(structure, contact)
    integrals = contact_integrals(contact, harmonics, samples)
    family = EnergyMotion(rest, integrals, float(rest.frequencies[mode - 1]))
    if initial is None:
        unknown = _first_motion(rest, integrals, mode, energy_start)
    else:
        unknown = _next_to(family, structure, initial, mode, energy_start)
    start, end = math.log(energy_start), math.log(energy_end)
    found = [_Motion(unknown, start)]
    status, complete = "the steps became too short", False
    hidden = not progress or structure.whole.comm.rank != 0
    bar = tqdm(total=100.0, desc="backbone", unit="%", disable=hidden, bar_format="{l_bar}{bar}")
    try:
        for motion in _follow(family, found[0], longest_step, most_points, not internal_resonances):
            if motion.parameter >= end:
                landed = _land(family, found[-1], motion, end)
                status = "no motion at the very end"
                if landed is not None:
                    found.append(landed)
                    complete = family.fundamental(landed.unknown) > family.least_fundamental
                    status = "reached the end" if complete else ELSEWHERE
                break
            found.append(motion)
            share = (motion.parameter - start) / (end - start)
            bar.update(max(0.0, 100.0 * share - bar.n))
            if motion.parameter < start - 0.02:
                status = "the backbone turned back past its start"
                break
        else:
            if len(found) > most_points:
                status = f"{most_points} points were not enough"
    except KeyboardInterrupt:
        status, throw = "interrupted", False
    except ConvergenceError as error:
        status = str(error)
    finally:
        bar.close()
    unknowns = np.array([motion.unknown for motion in found])
    energy = np.exp([motion.parameter for motion in found])
    modal = unknowns[:, :-1].reshape(len(found), harmonics + 1, -1) / rest.frequencies
    modal *= np.sqrt(2.0 * energy)[:, None, None]
    modal[:, 0] += rest.modal
    backbone = Backbone(
        structure,
        contact,
        mode,
        unknowns[:, -1] * family.reference,
        rest.energy + energy,
        rest.energy,
        modal @ rest.modes.shapes.T,
        np.array([motion.iterations for motion in found]),
        complete,
        status,
        np.array([motion.jump for motion in found]),
        samples,
    )
    if throw and not complete:
        raise ConvergenceError(
            f"backbone of mode {mode} from {energy_start:g} to {energy_end:g} J: {status} at "
            f"{energy[-1]:g} J after {len(energy)} points"
        )
    return backbone


class _Motion(NamedTuple):
    """A point of a path."""

    unknown: np.ndarray
    parameter: float
    iterations: int = 0
    jump: bool = False


def _follow(
    family: StiffnessMotion | EnergyMotion,
    here: _Motion,
    longest_step: float,
    most_steps: int,
    pass_over: bool,
) -> Iterator[_Motion]:
    """Yield the points that follow a solution.

    Steps in the parameter itself pass over tongues; where there is none to a motion of the same
    shape, arc-length leads on.
    """
    count, step = 0, 0.2 * longest_step
    while count < most_steps:
        ahead = _step(family, here, step, longest_step) if pass_over else None
        if ahead is not None:
            count += 1
            step = ahead.parameter - here.parameter
            step = min(longest_step, (1.7 if ahead.iterations <= 4 else 1.0) * step)
            here = ahead
            yield here
            continue
        path = follow_path(
            family,
            here.unknown,
            here.parameter,
            step=0.2 * longest_step,
            longest_step=longest_step,
            most_steps=most_steps - count,
            tolerance=1e-10,
            shortest_step=1e-10,
            least_cosine=0.85,
            rounding=family.rounding,
        )
        for point in path:
            count += 1
            motion = _Motion(point.unknown, point.parameter, point.iterations, point.crosses_branch)
            yield motion
            outside = point.tangent.p > FAST and motion.parameter > here.parameter
            if (
                pass_over
                and outside
                and family.fundamental(point.unknown) > family.least_fundamental
            ):
                here = motion
                break
        else:
            return


def _step(
    family: StiffnessMotion | EnergyMotion, here: _Motion, step: float, longest_step: float
) -> _Motion | None:
    """A motion of the same shape further on, about a step away; None where there is none.

    The sign of det J changes where an odd number of tongues has been passed.
    """
    family.set_parameter(here.parameter)
    family.linearise(here.unknown)
    sign = family.determinant_sign()
    slope = -family.solve_jacobian(family.parameter_derivative(here.unknown))
    near = family.near(here.unknown)
    # What grows on this side of a resonance has the opposite sign on the other one.
    across = np.where(near & (slope * here.unknown > 0.0), -here.unknown, here.unknown)
    slope[near] = 0.0
    steepness = math.sqrt(float(slope @ slope) / float(here.unknown @ here.unknown))
    step = min(step, longest_step / math.hypot(1.0, steepness))
    trials = (
        *((here.unknown, factor, 0.99) for factor in (1.0, 0.5, 0.25)),
        *((across, factor, 0.95) for factor in (0.25, 0.5, 1.0, 2.0, 4.0)),
        *((here.unknown, factor, 0.99) for factor in (0.1, 0.03, 0.01)),
    )
    for base, factor, cosine in trials:
        ahead, guess = here.parameter + factor * step, base + factor * step * slope
        family.set_parameter(ahead)
        unknown, iterations = family.newton(guess)
        if unknown is None or family.fundamental(unknown) < family.least_fundamental:
            continue
        if _alike(unknown, guess, cosine):
            family.linearise(unknown)
            return _Motion(unknown, ahead, iterations, family.determinant_sign() != sign)
    return None


def _alike(unknown: np.ndarray, other: np.ndarray, cosine: float) -> bool:
    """Whether two motions have the same shape."""
    one, two = unknown[:-1], other[:-1]
    return bool(one @ two > cosine * np.linalg.norm(one) * np.linalg.norm(two))


def _land(
    family: StiffnessMotion | EnergyMotion, first: _Motion, second: _Motion, end: float
) -> _Motion | None:
    """The motion at a parameter between those of two others; None if not found."""
    share = (end - first.parameter) / (second.parameter - first.parameter)
    between = first.unknown + share * (second.unknown - first.unknown)
    family.set_parameter(end)
    for nearby in (between, first.unknown, second.unknown):
        found, _ = family.newton(nearby)
        if found is not None and _alike(found, between, 0.9):
            return _Motion(found, end, second.iterations, second.jump)
    return None


def _next_to(
    family: EnergyMotion, structure: Structure, initial: PeriodicSolution, mode: int, energy: float
) -> np.ndarray:
    """The motion next to a solution, whose mode is made a cosine in the first harmonic."""
    if not isinstance(initial, PeriodicSolution):
        raise InputError("initial", initial, "a PeriodicSolution or None")
    rows = initial.displacement_coefficients
    if rows.shape[1:] != (structure.n_dofs,):
        raise InputError("initial", rows.shape[1:], f"of shape ({structure.n_dofs},)")
    rest, order = family.rest, np.arange(family.harmonics + 1)
    modal = to_complex(resized(rows, family.harmonics)) @ np.linalg.inv(rest.modes.shapes).T
    modal[0] -= rest.modal
    opens = rest.modes.pairs[mode - 1].sum() <= 0.0
    phase = np.angle(modal[1, mode - 1]) + (0.0 if opens else np.pi)
    z = (modal * np.exp(-1j * phase * order)[:, None]).real * rest.frequencies
    family.set_parameter(math.log(energy))
    start = np.append(z.ravel() / family.amplitude, initial.base_omega / family.reference)
    ratio = 1.0 + family.residual(start)[-1]
    if ratio > 0.0:
        start[:-1] /= math.sqrt(ratio)
        found, _ = family.newton(start)
        if found is not None and _alike(found, start, 0.7):
            return found
    raise ConvergenceError(f"backbone of mode {mode}: no motion next to the initial solution")


def _first_motion(
    rest: Equilibrium, integrals: ContactIntegrals, mode: int, energy: float
) -> np.ndarray:
    """From the linear mode without contact to the whole contact stiffness at one energy."""
    family = StiffnessMotion(rest, integrals, float(rest.frequencies[mode - 1]))
    family.energy = energy
    count = len(rest.frequencies)
    unknown = np.zeros((integrals.harmonics + 1) * count + 1)
    opens = rest.modes.pairs[mode - 1].sum() <= 0.0
    unknown[count + mode - 1], unknown[-1] = (1.0 if opens else -1.0), 1.0
    soft = min(0.0, math.log(SOFT / max(rest.stiffness, SOFT)))
    family.set_parameter(soft)
    first, _ = family.newton(unknown)
    if first is None:
        raise ConvergenceError(f"backbone of mode {mode}: no motion with soft contact")
    if soft == 0.0:
        return first
    last, furthest = _Motion(first, soft), soft
    for motion in _follow(family, last, 1.0, 400, True):
        if motion.parameter >= 0.0:
            landed = _land(family, last, motion, 0.0)
            if landed is not None:
                if family.fundamental(landed.unknown) < family.least_fundamental:
                    raise ConvergenceError(f"backbone of mode {mode}: {ELSEWHERE}")
                return landed.unknown
        if motion.parameter < soft - 5.0:
            break
        last, furthest = motion, max(furthest, motion.parameter)
    raise ConvergenceError(
        f"backbone of mode {mode}: the path in the contact stiffness came as far as "
        f"{math.exp(furthest):.2g} of it; fewer harmonics have fewer internal resonances, "
        "and a solution given as initial starts elsewhere"
    )
