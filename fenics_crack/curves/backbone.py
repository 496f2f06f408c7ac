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

Where a multiple of w meets another mode's frequency (an internal resonance), two pieces of the
family end in that mode's motion, from either side: a tongue. Newton's method at the next energy
passes over a narrow one, for the motion found there has the same shape but for the entry in
resonance, whose sign is the opposite; det J changes its sign. Where no motion of the same shape is
found beyond, the tongue is followed. Broad ones, with stiff contact, many modes and many harmonics,
can end the path; where the path from the linear mode ends, it is gone with fewer harmonics, and the
others are added at its end. At the start, a motion whose first harmonic is small is another mode's,
and refused; on the way, :attr:`Backbone.fundamental` reports it.

Source: Kerschen, Peeters, Golinval, Vakakis, Mechanical Systems and Signal Processing 23 (2009)
170-194; Krack, Gross, Harmonic Balance for Nonlinear Vibration Problems, 2019, section 2.6.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from tqdm import tqdm

from fenics_crack.balance.contact_integrals import contact_integrals
from fenics_crack.balance.error_report import ErrorReport, mean_square, moving_mean_square
from fenics_crack.balance.more_modes import UNKNOWN
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.basics.errors import (
    INTERRUPTED,
    ConvergenceError,
    InputError,
    check_count,
    check_number,
)
from fenics_crack.basics.tables import TURN, Tabular, counted, hertz_of, with_frequency
from fenics_crack.curves.curve import PARTS
from fenics_crack.curves.free_motion import (
    HELPS,
    Equilibrium,
    FreeMotion,
    MotionPath,
    cosine_rows,
    first_motion,
)
from fenics_crack.model.contact import ContactLaw, check_law
from fenics_crack.model.modal import SMALL, all_modes, is_small
from fenics_crack.model.reduction import reduce_structure
from fenics_crack.model.structure import Structure
from fenics_crack.numerics.extremes import half_range
from fenics_crack.numerics.newton import PathPoint, solve_at

SETTLED_STEP = 0.05
"""Relative size of the second Newton step up to which an error counts as estimated."""


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
        True if the requested energy was reached.
    status : str
        Reason for the end.
    jumps : (n,) bool
        True if an internal resonance has been passed over since the point before.
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
    frequency = hertz_of()

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
        gap = self.structure.apply_bt(rows)
        gap[0] -= self.structure.clearance
        integrals = contact_integrals(self.contact, self.harmonics, self.samples)
        return PeriodicSolution(
            self.structure,
            float(self.omega[index]),
            self.contact,
            rows,
            gap,
            integrals.force(gap),
            subharmonic=1,
            status="point of a backbone",
            iterations=int(self.iterations[index]),
            estimate=partial(self._report, index),
        )

    def _report(self, index: int) -> ErrorReport:
        """Return the error as the change by Newton's method with more harmonics at this energy."""
        rest, omega = Equilibrium(self.structure, self.contact), float(self.omega[index])
        kept, harmonics = self.harmonics + 1, self._more_harmonics(omega)
        integrals = contact_integrals(self.contact, self.harmonics, self.samples)
        energy = float(self.energy[index]) - self.rest_energy
        modal = np.linalg.solve(rest.modes.shapes, self.cosines[index].T).T
        modal[0] -= rest.modal
        z = np.zeros((harmonics + 1, len(rest.frequencies)))
        z[:kept] = modal * rest.frequencies / math.sqrt(2.0 * energy)
        start, known = np.append(z, 1.0), np.append(z[:kept], 1.0)
        motion = FreeMotion(rest, integrals, omega)
        left = motion.linearise(known, math.log(energy)).residual
        wider = FreeMotion(rest, integrals.widened(harmonics), omega)
        change = wider.linearise(start, math.log(energy)).residual
        sharp = SETTLED_STEP * float(np.linalg.norm(change) / np.linalg.norm(start))
        sharp = max(sharp, wider.rounding(math.log(energy)))
        found = solve_at(wider, start, math.log(energy), tolerance=sharp)
        truncation, waves = UNKNOWN, np.zeros((2, 2 * harmonics + 1, self.structure.n_pairs))
        if found is not None:
            change = (found.unknown - start)[:-1].reshape(z.shape)
            waves[:, wider.rows] = z @ wider.gap_rows, change @ wider.gap_rows
            truncation = math.sqrt(mean_square(waves[1]) / moving_mean_square(waves[0]))
        residual = float(np.linalg.norm(left) / np.linalg.norm(known))
        return ErrorReport(residual, min(truncation, UNKNOWN), *[math.nan] * 3)

    def _more_harmonics(self, omega: float) -> int:
        """Number of harmonics that assess the truncation: four times as many, and enough for modes
        that they do not reach."""
        squares = all_modes(self.structure).squares
        reaching = int(math.sqrt(max(float(squares.max()), 0.0)) / omega) + 1
        return max(4 * self.harmonics, self.harmonics + 8, min(reaching, SMALL // len(squares)))

    def amplitude(self, dof: int | None = None) -> np.ndarray:
        """Half the peak-to-peak displacement of a dof, or of the watched one, at every point: (n,)
        [m]."""
        points, terms, dofs = self.cosines.shape
        values = self.structure.values_at(self.cosines.reshape(-1, dofs), [dof])
        waves, turns = values.reshape(points, terms, 1), TURN * np.arange(terms)
        every = [lambda parts, wave=wave: np.cos(np.outer(parts, turns)) @ wave for wave in waves]
        return np.array([half_range(at(PARTS), at)[0] for at in every])

    # --- shown ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every motion."""
        found = {"omega": self.omega.tolist(), "energy": self.energy.tolist()}
        found |= {"iterations": self.iterations.tolist(), "jump": self.jumps.tolist()}
        return with_frequency(found)

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
    most_points: int = 2000,
    progress: bool = False,
    throw: bool = True,
) -> Backbone:
    """Follow a nonlinear normal mode over its energy: the backbone of its resonance.

    The linear mode of the structure without contact is followed in ln k, the contact stiffness, at
    ``energy_start``, and from there in ln E (``docs/theory.md``, "Backbones"). Source: Kerschen and
    others, MSSP 23 (2009) 170-194.

    Parameters
    ----------
    structure : Structure
        Structure that vibrates, with mass at its crack faces; its load, mean load included, and its
        damping are left out. One with many dofs is reduced first (:func:`reduce_structure`,
        "free_interface").
    contact : ContactLaw
        Law of all pairs. With preload, contact grows about the equilibrium held fixed.
    mode : int
        Number of the linear mode, 1 the lowest.
    energy_start, energy_end : float
        Energy of the motion [J], above that of the equilibrium; the end is above the start.
    harmonics, samples : int, int or None
        As in :func:`solve_harmonic_balance`.
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
        Nothing moves at t = 0 and after half a period; at the start, pairs are further open at 0.

    Raises
    ------
    InputError
        An argument cannot be used, or the structure can move as a rigid body.
    ConvergenceError
        No equilibrium or no first motion was found, or the end was not reached.

    Examples
    --------
    >>> backbone = fc.follow_backbone(mass, fc.UnilateralPenalty(1.0), 1, 0.1, 1.0)
    """
    longest = 0.2  # relative to the size of the motion's shape, and in ln E
    check_count("most_points", most_points, 1)
    check_number("energy_start", energy_start, 0.0, above=True)
    check_number("energy_end", energy_end, energy_start, above=True)
    check_count("harmonics", harmonics, 1)
    if samples is not None:
        check_count("samples", samples, 4 * harmonics + 1)
    check_law(structure, contact)
    check_count("mode", mode, 1)
    if not is_small(structure):
        structure = reduce_structure(structure, method="free_interface")
    if mode > structure.n_dofs:
        raise InputError("mode", mode, f"at most {structure.n_dofs}, the number of dofs")
    rest = Equilibrium(structure, contact)
    integrals = contact_integrals(contact, harmonics, samples)
    family = FreeMotion(rest, integrals, float(rest.frequencies[mode - 1]))
    first, note = first_motion(family, mode, energy_start)
    path = MotionPath(
        family, first, math.log(energy_end), lowest=first.parameter - longest,
        max_step=longest, left=most_points,
    )  # fmt: skip
    found, ended = _collected(path, progress and structure.whole.comm.rank == 0)
    ended = ended or path.in_words(most_points)
    energy = np.exp([point.parameter for point in found])
    if throw and not path.complete and ended != INTERRUPTED:
        raise ConvergenceError(
            f"backbone of mode {mode} from {energy_start:g} to {energy_end:g} J: {ended}{note} "
            f"at {energy[-1]:g} J after {len(found)} points; {HELPS}"
        )
    unknowns = np.array([point.unknown for point in found])
    modal = unknowns[:, :-1].reshape(len(found), -1, len(rest.frequencies)) / rest.frequencies
    modal *= np.sqrt(2.0 * energy)[:, None, None]
    modal[:, 0] += rest.modal
    return Backbone(
        structure,
        contact,
        mode,
        unknowns[:, -1] * family.reference,
        rest.energy + energy,
        rest.energy,
        modal @ rest.modes.shapes.T,
        np.array([point.iterations for point in found]),
        path.complete,
        ended + note,
        np.array([point.crosses_branch for point in found]),
        samples,
    )


def _collected(path: MotionPath, shown: bool) -> tuple[list[PathPoint], str]:
    """The points of a path, with a progress bar if it is to be shown, and what has ended it."""
    found, start, ended = [path.last], path.last.parameter, ""
    form = "{l_bar}{bar}"
    bar = tqdm(total=100, desc="backbone", unit="%", disable=not shown, bar_format=form)
    try:
        for point in path:
            found.append(replace(point, at=None))
            share = (point.parameter - start) / (path.end - start)
            bar.update(max(0, int(100.0 * share) - bar.n))
    except KeyboardInterrupt:
        ended = INTERRUPTED
    except ConvergenceError as error:
        ended = str(error)
    finally:
        bar.close()
    return found, ended
