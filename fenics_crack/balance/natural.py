"""Natural frequencies about the state of rest, and the one at which a load is to find a resonance.

At rest a pair is pressed by the mean load, open, or touches without a force. Under a small load
pressed pairs stay bonded, through the springs of their law, and open ones stay open: the structure
is linear. Pairs that touch without a force breathe under any load, at the bilinear frequency 2 w1
w2 / (w1 + w2) of the mode with these pairs open and of the one most like it with them bonded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fenics_crack.balance.compliance import ModalCompliance
from fenics_crack.balance.problem import Problem
from fenics_crack.basics.errors import InputError
from fenics_crack.model.contact import solve_complementarity, springs_of
from fenics_crack.model.modal import all_modes
from fenics_crack.model.structure import Structure
from fenics_crack.model.wheel import Wheel
from fenics_crack.numerics.equations import LOCATED


@dataclass(frozen=True)
class Drive:
    """The harmonic of a load that excites.

    Attributes
    ----------
    harmonic : int
        k.
    rows : (2, n_dofs) [N]
        Its cosine and sine parts; of a wheel those on the watched blade.
    """

    harmonic: int
    rows: np.ndarray

    @classmethod
    def of(cls, structure: Structure, harmonic: int) -> Drive:
        """That of a structure."""
        part, whole = slice(2 * harmonic - 1, 2 * harmonic + 1), structure.whole
        if not isinstance(whole, Wheel):
            return cls(harmonic, structure.force[part])
        numbers = whole.own_numbers(whole.first)
        dofs = numbers[(numbers >= 0) & np.any(whole.force[part, numbers], axis=0)]
        blade = structure.values_at(np.eye(structure.n_dofs), dofs.tolist())
        return cls(harmonic, whole.force[part, dofs] @ blade.T)

    def power(self, waves: np.ndarray) -> complex:
        """P = f^H u [N m] of the coefficients (2H+1, 2) of both rows' products with u."""
        cosine, sine = waves[2 * self.harmonic - 1], waves[2 * self.harmonic]
        return complex(cosine[0] + sine[1], cosine[1] - sine[0])


@dataclass(frozen=True)
class NaturalResonance:
    """A resonance as the natural frequencies about the state of rest have it.

    Attributes
    ----------
    omega, width : float [rad/s]
        Load frequency, and half-power width.
    drive : Drive
        What excites it.
    """

    omega: float
    width: float
    drive: Drive


def nearest_mode(problem: Problem, omega: float) -> NaturalResonance:
    """The resonance nearest to a load frequency of those that show in the phase at the load: there
    the mode itself answers by more than twice what all others do.

    Raises
    ------
    InputError
        No damped mode answers to the load.
    """
    modes, structure = all_modes(problem.structure), problem.structure
    pressed, touching = pairs_at_rest(problem)
    natural, shapes = _modes_with(problem, pressed)
    bonded, others = _modes_with(problem, touching)
    partner = bonded[np.argmax((shapes.T @ others) ** 2, axis=1)]
    breathing = 2.0 * natural * partner / np.maximum(natural + partner, LOCATED)
    rates = (modes.damping if modes.damping.ndim == 1 else np.diag(modes.damping)) @ shapes**2
    found: list[NaturalResonance] = []
    for harmonic in range(1, len(structure.force) // 2 + 1):
        drive = Drive.of(structure, harmonic)
        cosine, sine = structure.force[2 * harmonic - 1 : 2 * harmonic + 1] @ modes.shapes @ shapes
        first, second = drive.rows @ modes.shapes @ shapes
        work = (cosine - 1j * sine) * (first + 1j * second)
        for mode in np.flatnonzero((work != 0.0) & (natural > 0.0) & (rates > 0.0)).tolist():
            square = natural**2 - natural[mode] ** 2
            answers = work / (square + 1j * natural[mode] * rates)
            if abs(answers.sum() - answers[mode]) <= 0.5 * abs(answers[mode]):
                place, width = breathing[mode] / harmonic, rates[mode] / harmonic
                found.append(NaturalResonance(float(place), float(width), drive))
    if not found:
        raise InputError("load", "no mode answers to it", "one that moves a damped mode")
    return min(found, key=lambda one: abs(one.omega - omega))


def pairs_at_rest(problem: Problem) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of a small structure that its mean load presses, and those that touch, with a force or
    without: (n_pairs,) of bool each."""
    structure = problem.structure
    springs = springs_of(problem.contact, structure.n_pairs)
    compliance = ModalCompliance(structure, 0.0, structure.force)
    static, gap = compliance.matrices[0].real + np.diag(springs), compliance.linear_gap
    rounding, force = LOCATED * float(np.abs(gap[1:]).max(initial=0.0)), np.zeros_like(gap[0])
    if np.any(gap[0] > rounding):
        force = solve_complementarity(static, gap[0])
    return force > 0.0, static @ force - gap[0] <= rounding


def _modes_with(problem: Problem, bonded: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Natural frequencies (n,) [rad/s], and shapes in modal coordinates (n_modes, n), with some
    pairs bonded."""
    modes = all_modes(problem.structure)
    give, tie = np.diag(springs_of(problem.contact, len(bonded))), modes.pairs[:, bonded]
    if modes.residual is not None:
        give = give + modes.residual
    between = np.linalg.pinv(give[np.ix_(bonded, bonded)])
    squares, shapes = np.linalg.eigh(np.diag(modes.squares) + tie @ between @ tie.T)
    return np.sqrt(np.maximum(squares, 0.0)), shapes
