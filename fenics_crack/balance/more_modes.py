"""Change of an exact motion due to the modes that a reduction truncates.

The reference of a reduced structure has more modes (:mod:`fenics_crack.model.reduction`). Those
that crack faces without mass leave out begin as their statics have them, Lambda q = f - P lambda.
One step of Newton's method of the whole motion on the reference's flow estimates the change of the
gaps; the orbit that is found from there gives it exactly. The reference has a share of what is left
out, so that

    e = |f - f_ref| / share.

What answers quasi-statically has no damping. By Rayleigh's a M + b K it would dissipate, in a
period, b times the integral of c'^T S c', c the coordinates without mass and S their stiffness: the
reference has its share of that, too, as so much more damping of its modes.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fenics_crack.balance.contact_system import Wave
from fenics_crack.balance.friction_integrals import coupled_integrals
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import NEGLIGIBLE, times
from fenics_crack.model.reduced import ReducedStructure, massless
from fenics_crack.model.structure import RayleighDamping, Structure
from fenics_crack.motion.flow import ContactFlow, Samples, flow_of
from fenics_crack.motion.orbit import (
    FLOWS,
    INSTANTS,
    KNOWN,
    PeriodicOrbit,
    Prediction,
    affordable,
    find_orbit,
    predicted,
    predicted_with_more_modes,
)
from fenics_crack.motion.search import SEGMENTS
from fenics_crack.numerics.fourier import waves_of
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


def reference_flow(wave: Wave) -> ContactFlow | None:
    """The flow of the reference of a solution's reduced structure; None where there is none, or a
    step on it would take long."""
    reference = reference_of(wave)
    if reference is None or wave.contact is None or not is_small(reference):
        return None
    flow = flow_of(reference, wave.contact)
    known = flow is not None and affordable(flow, wave.omega, wave.subharmonic, FLOWS)
    return flow if known else None


@dataclass(frozen=True)
class MoreModes:
    """The motion of a solution on the flow of more modes."""

    flow: ContactFlow
    """Flow with more modes."""
    wave: Wave
    """Harmonic-balance solution."""
    fewer: ContactFlow
    """Flow of the solution's own structure."""
    step: Prediction | None
    """Newton step of the solution on that flow; not needed where its orbit is accepted."""
    nearest: PeriodicOrbit | None
    """Nearest periodic orbit of that flow."""
    accepted: bool
    """True if that orbit is accepted for the solution."""

    @cached_property
    def _states(self) -> np.ndarray | None:
        """At equal parts of the period: of the orbit, where it is the solution's own, else of the
        solution behind its own step; None where that is not known."""
        wave = self.wave
        time = wave.period / INSTANTS * np.arange(INSTANTS)
        every = slice(None, None, INSTANTS // SEGMENTS)
        if self.accepted:
            assert self.nearest is not None
            sampled = self.nearest.sampled
            few, force = sampled.whole_states[every], sampled.forces
        elif self.step is not None:
            few, force = self.step.states, wave.gaps_and_forces(time)[1]
        else:
            return None
        count = self.fewer.count
        shape, speed, places = np.split(few, [count, 2 * count], axis=1)
        if massless(wave.structure) is None:
            return self._expanded(shape, speed, places)
        static = self._static(time, force, shape.shape[1])
        rate = (np.roll(static, -1, axis=0) - np.roll(static, 1, axis=0)) / (2.0 * time[1])
        return np.hstack([shape, static[every], speed, rate[every], places])

    def _expanded(self, shape: np.ndarray, speed: np.ndarray, places: np.ndarray) -> np.ndarray:
        """States of the reference of modal ones of a structure with mass."""
        structure, reference = self.wave.structure, self.flow.structure
        assert isinstance(structure, ReducedStructure) and isinstance(reference, ReducedStructure)
        whole = structure.whole
        moved = times(whole.mass, structure.basis)
        map_to = whole.sum_over_ranks(reference.basis.T @ moved) @ self.fewer.modes.shapes
        return self.flow.state(shape @ map_to.T, speed @ map_to.T, places)

    def _static(self, time: np.ndarray, force: np.ndarray, kept: int) -> np.ndarray:
        """The new modes under the load and contact forces at times."""
        modes = self.flow.modes
        loads = self._waves(time) @ self.flow.force[:, kept:] - force @ modes.pairs[kept:].T
        found: np.ndarray = loads / modes.squares[kept:]
        return found

    def _gap(self, states: np.ndarray) -> np.ndarray:
        """g of states at equal parts of the period: (n, n_pairs) [m]."""
        flow = self.flow
        slow = states[:, : flow.count] @ flow.modes.pairs + self._waves(self._time) @ flow.gap
        if not np.any(flow.residual):
            return slow
        integrals = coupled_integrals(flow.contact, 1, flow.residual)
        return slow - integrals.forces(slow) @ flow.residual

    def _waves(self, time: np.ndarray) -> np.ndarray:
        """Return the load's time functions: mean, cosines and sines."""
        return waves_of(self.flow.force, self.wave.omega * time)

    @property
    def _time(self) -> np.ndarray:
        return self.wave.period / SEGMENTS * np.arange(SEGMENTS)

    @cached_property
    def prediction(self) -> Prediction | None:
        """One step of Newton's method; None where the motion is not followed."""
        wave, states = self.wave, self._states
        if states is None:
            return None
        flow, omega, periods = self.flow, wave.omega, wave.subharmonic
        few = self.nearest if self.accepted else self.step
        lips = massless(wave.structure)
        if few is None or lips is None:
            return predicted(flow, omega, states, periods)
        return predicted_with_more_modes(flow, omega, states, few.inverse, lips.n_modes, periods)

    @cached_property
    def changes(self) -> Errors:
        """Errors by that step; :data:`UNKNOWN` where the time integration fails."""
        if self.prediction is None:
            return UNKNOWN, UNKNOWN
        wave, states, ahead = self.wave, self._states, self.prediction.states
        assert states is not None
        gaps, moved = self._gap(states), wave.coordinates(self._time)
        more = (ahead - states)[:, : self.flow.count] @ self.flow.modes.shapes.T
        at_load = loaded(wave.structure, moved)
        better = at_load + loaded(self.flow.structure, more)
        return self._errors(gaps, self._gap(ahead), at_load, better)

    @property
    def distances(self) -> Errors:
        """The same by the orbits with these modes and without them, where that without them is the
        solution's own and both are known."""
        few, many = self.nearest, self.orbit if self.accepted else None
        if few is None or many is None:
            return self.changes
        moved = (loaded(one.flow.structure, one.sampled.displacement) for one in (few, many))
        return self._errors(few.sampled.gaps, many.sampled.gaps, *moved)

    def _errors(
        self, gap: np.ndarray, better: np.ndarray, at_load: np.ndarray, better_at_load: np.ndarray
    ) -> Errors:
        """Errors by changes of the gaps and of the displacement at the load over the period; that
        of the gaps is 0 where they move by rounding."""
        still = self.nearest is not None and is_still(self.nearest.sampled)
        of_gap = relative_to_motion(better - gap, gap + self.wave.seen.clearance)
        of_load = relative_to_motion(better_at_load - at_load, at_load)
        return left_out(self.wave.structure, (0.0 if still else of_gap, of_load))

    @cached_property
    def orbit(self) -> PeriodicOrbit | None:
        """Next to the motion; None where none is found."""
        if self._states is None:
            return None
        wave = self.wave
        return find_orbit(self.flow, wave.omega, self._states[0], subharmonic=wave.subharmonic)

    def contradicts(self, verdict: str) -> str:
        """Return in words how the orbit with these modes contradicts a verdict on stability; ""
        where it agrees, or is not known."""
        if verdict not in ("stable", "unstable") or self.orbit is None:
            return ""
        size = float(abs(self.orbit.multipliers[0]))
        other = "stable" if size < 1.0 else "unstable"
        if other == verdict or abs(size - 1.0) <= KNOWN:
            return ""
        many = len(self.flow.modes.squares)
        return f"with {many} modes the orbit is {other} (largest multiplier {size:.6g})"


def is_still(samples: Samples) -> bool:
    """Return True if crack faces, which the load presses together, move by rounding only."""
    slow = samples.states[:, : samples.flow.count] @ samples.flow.modes.pairs
    moved = samples.gaps + samples.flow.clearance
    return bool(np.linalg.norm(moved) <= NEGLIGIBLE * np.linalg.norm(slow))


def loaded(structure: Structure, motion: np.ndarray) -> np.ndarray:
    """Return a motion (n, n_local) at the load, in the direction of each of its parts that vibrate,
    or of its mean if none does: (n, n_parts) (collective)."""
    seen = structure.sum_over_ranks(np.sum(structure.force**2, axis=1)) > 0.0
    seen[0] &= not seen[1:].any()
    return structure.sum_over_ranks(motion @ structure.force[seen].T)
