"""Change of an exact motion due to the modes that a reduction truncates.

The reference of a reduced structure has more modes (:mod:`fenics_crack.model.reduction`). Those
that crack faces without mass leave out begin as their statics have them, Lambda q = f - P lambda.
The orbit that Newton's method finds from there gives the change exactly; without one, the motion to
which one step of Newton's method for all its parts leads gives it linearly. The reference has a
share of what is left out, so that

    e = |f - f_ref| / share.

What answers quasi-statically has no damping. By Rayleigh's a M + b K it would dissipate, in a
period, b times the integral of c'^T S c', c the coordinates without mass and S their stiffness: the
reference has its share of that, too, as so much more damping of its modes.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np

from fenics_crack.balance.contact_system import Wave
from fenics_crack.model.modes import NEGLIGIBLE, times
from fenics_crack.model.reduced import ReducedStructure, massless
from fenics_crack.model.structure import RayleighDamping, Structure
from fenics_crack.motion.flow import ContactFlow, Samples
from fenics_crack.motion.orbit import (
    INSTANTS_PER_PERIOD,
    MULTIPLIER_TOLERANCE,
    Inverse,
    MotionInArcs,
    PeriodicOrbit,
    find_orbit,
    predict_motion,
    predict_orbit,
)
from fenics_crack.motion.search import SEGMENTS
from fenics_crack.numerics.equations import ROOT_TOLERANCE
from fenics_crack.numerics.fourier import fourier_basis_for
from fenics_crack.numerics.newton import relative_to_motion

UNKNOWN = 1.0
"""Relative error returned when no estimate exists."""


Errors = tuple[float, float]
"""Errors of the gap, and of the displacement at the load; at most :data:`UNKNOWN`."""


def reference_of(wave: Wave) -> ReducedStructure | None:
    """Return the reference of the reduced structure of a solution, which is damped more where what
    the modes leave out has no damping; None where there is none."""
    structure = wave.structure
    if not isinstance(structure, ReducedStructure) or structure.reference is None:
        return None
    more = structure.share * _undamped(wave)
    return structure.reference.varied(damping=1.0 + more) if more else structure.reference


def _undamped(wave: Wave) -> float:
    """Return the energy that Rayleigh damping would dissipate in what the modes leave out, relative
    to what it dissipates in these; 0 with another damping."""
    lips = massless(wave.structure)
    if lips is None or not isinstance(lips.original.damping, RayleighDamping):
        return 0.0
    rows = np.repeat(np.arange(1.0, wave.harmonics + 1), 2)[:, None]
    modal, static = np.split(rows * wave.displacement_coefficients[1:], [lips.n_modes], axis=1)
    lost = lips.original.damping.stiffness * np.sum(static @ lips.compliance * static)
    return float(lost / max(np.sum(modal**2 @ lips.rate), NEGLIGIBLE * lost, 1e-300))


def left_out(structure: Structure, changes: Errors) -> Errors:
    """Return the errors due to the modes left out, by the changes to a structure's reference."""
    share = structure.share if isinstance(structure, ReducedStructure) else 1.0
    return min(changes[0] / share, UNKNOWN), min(changes[1] / share, UNKNOWN)


@dataclass(frozen=True)
class MoreModes:
    """The motion of a solution on the flow of more modes."""

    flow: ContactFlow
    """Flow with more modes."""
    wave: Wave
    """Harmonic-balance solution."""
    fewer: PeriodicOrbit
    """The nearest exact orbit, with the modes of its structure."""
    inverse: Inverse | None = None
    """(I - M)^-1 of a motion nearby, with which the search begins."""

    @property
    def _states(self) -> np.ndarray:
        """States of the nearest orbit at equal parts of its period, with what new modes have of its
        load and contact forces."""
        samples, flow = self.fewer.sampled, self.flow
        count = self.fewer.flow.n_modes
        shape, speed, places = np.split(samples.whole_states, [count, 2 * count], axis=1)
        if massless(self.wave.structure) is None:
            return self._expanded(shape, speed, places)[:: INSTANTS_PER_PERIOD // SEGMENTS]
        kept = shape.shape[1]
        loads = (
            fourier_basis_for(flow.modal_load, self.wave.omega * samples.time)
            @ flow.modal_load[:, kept:]
        )
        loads = loads - samples.forces @ flow.modes.pairs[kept:].T
        static = loads / flow.modes.squares[kept:]
        rate = (np.roll(static, -1, axis=0) - np.roll(static, 1, axis=0)) / (2.0 * samples.time[1])
        return np.hstack([shape, static, speed, rate, places])[:: INSTANTS_PER_PERIOD // SEGMENTS]

    def _expanded(self, shape: np.ndarray, speed: np.ndarray, places: np.ndarray) -> np.ndarray:
        """States of the reference of modal ones of a structure with mass."""
        structure, reference = self.wave.structure, self.flow.structure
        assert isinstance(structure, ReducedStructure) and isinstance(reference, ReducedStructure)
        whole = structure.whole
        moved = times(whole.mass, structure.basis)
        map_to = whole.sum_over_ranks(reference.basis.T @ moved) @ self.fewer.flow.modes.shapes
        return self.flow.state(shape @ map_to.T, speed @ map_to.T, places)

    @property
    def orbit(self) -> PeriodicOrbit | None:
        """Next to the motion, as sharp as an estimated error takes; None where none is found."""
        return None if isinstance(self.motion, MotionInArcs) else self.motion

    @cached_property
    def motion(self) -> PeriodicOrbit | None:
        """The orbit, else the motion that one step of Newton's method leads to; None without both.

        The step is that for all parts of the nearest orbit's period together.
        """
        flow, omega, periods = self.flow, self.wave.omega, self.wave.subharmonic
        states, start_inverse = self._states, self.inverse
        search = partial(
            find_orbit, flow, omega, subharmonic=periods, step_tolerance=ROOT_TOLERANCE
        )
        orbit = search(states[0], inverse=start_inverse) or (
            search(states[0]) if start_inverse else None
        )
        if orbit is None and (step := predict_orbit(flow, omega, states, periods)):
            orbit = search(step.states[0], inverse=step.inverse)
            return orbit or predict_motion(flow, omega, step, periods)
        return orbit

    @property
    def hint(self) -> Inverse | None:
        """(I - M)^-1, for the search of a motion nearby; None where there is none."""
        with suppress(np.linalg.LinAlgError):
            return self.orbit.inverse if self.orbit else None
        return None

    @property
    def errors(self) -> Errors | None:
        """Errors by the motions with these modes and without them; None where it is not known. That
        of the gaps is 0 where they move by rounding."""
        if self.motion is None:
            return None
        few, many = self.fewer.sampled, self.motion.sampled
        of_gap = relative_to_motion(
            many.gaps - few.gaps, few.gaps + self.wave.row_structure.clearance
        )
        moved, more = (loaded(one.flow.structure, one.displacement) for one in (few, many))
        at_load = relative_to_motion(more - moved, moved)
        return left_out(self.wave.structure, (0.0 if is_still(few) else of_gap, at_load))

    def contradicts(self, verdict: str) -> str:
        """Return in words how the orbit with these modes contradicts a verdict on stability; ""
        where it agrees, or is not known."""
        if verdict not in ("stable", "unstable") or self.orbit is None:
            return ""
        size = float(abs(self.orbit.multipliers[0]))
        other = "stable" if size < 1.0 else "unstable"
        if other == verdict or abs(size - 1.0) <= MULTIPLIER_TOLERANCE:
            return ""
        many = len(self.flow.modes.squares)
        return f"with {many} modes the orbit is {other} (largest multiplier {size:.6g})"


def is_still(samples: Samples) -> bool:
    """Return True if crack faces, which the load presses together, move by rounding only."""
    slow = samples.states[:, : samples.flow.n_modes] @ samples.flow.modes.pairs
    moved = samples.gaps + samples.flow.clearance
    return bool(np.linalg.norm(moved) <= NEGLIGIBLE * np.linalg.norm(slow))


def loaded(structure: Structure, motion: np.ndarray) -> np.ndarray:
    """Return a motion (n, n_local) at the load, in the direction of each of its parts that vibrate,
    or of its mean if none does: (n, n_parts) (collective)."""
    seen = structure.sum_over_ranks(np.sum(structure.force**2, axis=1)) > 0.0
    seen[0] &= not seen[1:].any()
    return structure.sum_over_ranks(motion @ structure.force[seen].T)
