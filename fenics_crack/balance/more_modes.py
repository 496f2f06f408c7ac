"""What the modes that a reduction leaves out change of an exact motion.

The reference of the structure has them (:mod:`fenics_crack.model.reduction`). The motion is one of
the reference, too; modes that lips without mass leave out begin as their statics have them,

    Lambda q = f - P lambda,

where the gaps are those known. One step of Newton's method of the whole motion on the reference's
flow tells by how much these change; its orbit from there, exactly.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from fenics_crack.balance.coupled_integrals import CoupledIntegrals
from fenics_crack.balance.judgement import Judgement, relative
from fenics_crack.balance.nearby import PARTS, orbit_next_to, predicted
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import times
from fenics_crack.model.reduced import ReducedStructure, massless
from fenics_crack.motion.flow import ContactFlow, flow_of
from fenics_crack.motion.orbit import INSTANTS, PeriodicOrbit, Prediction, affordable
from fenics_crack.numerics.fourier import waves

__all__ = ["MoreModes", "more_modes"]

NODES = PARTS // 2
"""Of the period, whose starts' states are corrected together: of an exact orbit fewer do than of a
wave, and their derivatives with twice the modes take long."""


def more_modes(judged: Judgement) -> MoreModes | None:
    """What the reference of a judged motion's structure makes of it; None where there is none
    whose flow is known."""
    structure, contact = judged.wave.structure, judged.wave.contact
    reference = structure.reference if isinstance(structure, ReducedStructure) else None
    if judged.flow is None or contact is None or reference is None or not is_small(reference):
        return None
    flow = flow_of(reference, contact)
    return None if flow is None else MoreModes(judged, flow)


class MoreModes:
    """A judged motion on the flow of more modes.

    Attributes
    ----------
    flow : ContactFlow
    """

    def __init__(self, judged: Judgement, flow: ContactFlow) -> None:
        self.flow, self._judged = flow, judged

    @property
    def affordable(self) -> bool:
        """Whether Newton's step does not take long."""
        wave = self._judged.wave
        return affordable(self.flow, wave.omega, wave.subharmonic)

    @cached_property
    def _states(self) -> np.ndarray | None:
        """At equal parts of the period: of the orbit, where it is known, else of the wave behind
        its own step; None where that is not known."""
        judged, wave = self._judged, self._judged.wave
        orbit, every = judged.orbit, slice(None, None, INSTANTS // NODES)
        time = wave.period / INSTANTS * np.arange(INSTANTS)
        if orbit is not None and judged.accepted:
            few, force = orbit.sampled.states[every], orbit.sampled.force
        elif judged.predicted is not None:
            few = judged.predicted.states[:: PARTS // NODES]
            force = wave.contact_force(time)
        else:
            return None
        shape, speed = np.split(few, 2, axis=1)
        if massless(wave.structure) is None:
            return self._expanded(shape, speed)
        static = self._static(time, force, shape.shape[1])
        rate = (np.roll(static, -1, axis=0) - np.roll(static, 1, axis=0)) / (2.0 * time[1])
        return np.hstack([shape, static[every], speed, rate[every]])

    def _expanded(self, shape: np.ndarray, speed: np.ndarray) -> np.ndarray:
        """States of the reference of modal ones of a structure with mass."""
        structure, reference = self._judged.wave.structure, self.flow.structure
        assert isinstance(structure, ReducedStructure) and isinstance(reference, ReducedStructure)
        whole, flow = structure.whole, self._judged.flow
        assert flow is not None
        moved = times(whole.mass, structure.basis)
        map_to = whole.sum_over_ranks(reference.basis.T @ moved) @ flow.modes.shapes
        return self.flow.state(shape @ map_to.T, speed @ map_to.T)

    def _static(self, time: np.ndarray, force: np.ndarray, kept: int) -> np.ndarray:
        """The new modes under the load and contact forces at times."""
        modes = self.flow.modes
        loads = self._waves(time) @ self.flow.force[:, kept:] - force @ modes.pairs[kept:].T
        found: np.ndarray = loads / modes.squares[kept:]
        return found

    def _gap(self, states: np.ndarray) -> np.ndarray:
        """g of states at equal parts of the period: (n, n_pairs) [m]."""
        flow = self.flow
        slow = states[:, : flow.size // 2] @ flow.modes.pairs + self._waves(self._time) @ flow.gap
        if not np.any(flow.residual):
            return slow
        integrals = CoupledIntegrals(flow.contact, 1, residual=flow.residual)
        return slow - integrals.forces(slow) @ flow.residual

    def _waves(self, time: np.ndarray) -> np.ndarray:
        """Of the load: mean, cosine and sine."""
        return waves(self._judged.wave.omega * time)

    @property
    def _time(self) -> np.ndarray:
        return self._judged.wave.period / NODES * np.arange(NODES)

    @cached_property
    def predicted(self) -> Prediction | None:
        """One step of Newton's method; None where the motion is not followed."""
        if self._states is None:
            return None
        wave = self._judged.wave
        return predicted(self.flow, wave.omega, self._states, wave.subharmonic)

    @property
    def changes(self) -> tuple[float, float] | None:
        """Of the gap, and of the displacement at the load, by that step; None where the motion is
        not followed."""
        if self.predicted is None:
            return None
        wave, states = self._judged.wave, self._states
        assert states is not None
        gap = self._gap(states)
        moved = (self.predicted.states - states)[:, : self.flow.size // 2] @ self.flow.force.T
        known = wave.coordinates(self._time) @ wave.structure.force.T
        return self._of_gap(self._gap(self.predicted.states) - gap, gap), relative(moved, known)

    def _of_gap(self, change: np.ndarray, gap: np.ndarray) -> float:
        """A change relative to B^T u; 0 where that is rounding."""
        clearance = self._judged.wave.structure.clearance
        return 0.0 if self._judged.still else relative(change, gap + clearance)

    @cached_property
    def orbit(self) -> PeriodicOrbit | None:
        """Next to the motion; None where none is found."""
        if self._states is None:
            return None
        wave = self._judged.wave
        return orbit_next_to(self.flow, wave.omega, self._states[0], wave.subharmonic)

    @property
    def distances(self) -> tuple[float, float] | None:
        """Of the gap, and of the displacement at the load, between the orbits with these modes and
        without them; None where one is not known."""
        few, many = self._judged.orbit, self.orbit
        if few is None or many is None:
            return None
        gap = few.sampled.gap
        moved, more = (
            orbit.sampled.displacement @ orbit.flow.structure.force.T for orbit in (few, many)
        )
        return self._of_gap(many.sampled.gap - gap, gap), relative(more - moved, moved)
