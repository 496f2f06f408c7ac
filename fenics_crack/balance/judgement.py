"""What the exact flow says of a wave: the orbit next to it, and how far away that is.

An orbit is the wave's own where it is no farther away than three times what one step of Newton's
method predicts (:mod:`fenics_crack.motion.orbit`), by its gaps and, beyond 1 %, by its state, as
pairs may hardly see a mode; and this step is short: then the distance is the error, and the orbit's
multipliers are the motion's. On 510 waves of 128 plates this was so for every one with its own
orbit, and for none of 26 next to another one.

Where the step is long the orbit is the wave's own if its motion, balanced with as many harmonics,
is the wave, to which Newton's method leads from the orbit's Fourier series, and none other is found
from the state behind the step. Where it leads elsewhere, or is far away, the wave is balanced with
twice the harmonics, from there on with twice as many again: the first of these waves that has its
own orbit decides for all, as far as that is within three times the error predicted of each, and
nearer than one that was found first. An orbit that is farther away, though no farther than 10 %, is
the wave's own where twice the harmonics leave no more than a third of the distance to it: next to
grazing one step predicts too little. It tells the error, and no verdict.

What the modes that a reduction leaves out change of an exact motion is told by the reference of the
structure, which has them (:mod:`fenics_crack.model.reduction`). The motion is one of
the reference, too; modes that lips without mass leave out begin as their statics have them,

    Lambda q = f - P lambda,

where the gaps are those known. One step of Newton's method of the whole motion on the reference's
flow tells by how much these change; its orbit from there, exactly.
"""

from __future__ import annotations

from dataclasses import fields
from functools import cached_property

import numpy as np

from fenics_crack.balance.contact_integrals import CoupledIntegrals
from fenics_crack.balance.contact_system import Wave
from fenics_crack.balance.problem import Problem
from fenics_crack.errors import MOST_HARMONICS
from fenics_crack.model.modal import is_small
from fenics_crack.model.modes import NEGLIGIBLE, times
from fenics_crack.model.reduced import ReducedStructure, massless
from fenics_crack.model.structure import Structure
from fenics_crack.motion.flow import ContactFlow, Samples, flow_of
from fenics_crack.motion.orbit import (
    FLOWS,
    FORMED,
    INSTANTS,
    KNOWN,
    PeriodicOrbit,
    Prediction,
    affordable,
    eigenvalues,
    predicted,
    too_slow,
)
from fenics_crack.motion.shooting import PARTS, Patience, orbit_next_to, wave_states
from fenics_crack.numerics.fourier import waves
from fenics_crack.numerics.newton import relative_to_motion
from fenics_crack.table import percent

BELIEVED, FARTHEST, FAR = 3.0, 0.1, 0.3
"""Times what the linearised motion predicts, beyond which a motion is another one; the distance and
the prediction beyond which it is not taken for the same without more; and from where on it is no
wonder if no orbit is found, and none decides: there may be several as near."""
NO_DOUBT = 0.01
"""Distance of an orbit's gaps from those of its wave at which nothing else is asked; its square, of
their states: gaps are some per cent of what a plate moves."""
UNKNOWN = 1.0
"""An error that is not known."""


class Judgement:
    """The exact flow's judgement of a wave, each part found when it is first asked for.

    Attributes
    ----------
    wave : Wave
    of_orbit : bool
        Whether the wave was taken from its orbit.
    """

    def __init__(
        self, wave: Wave, orbit: PeriodicOrbit | None = None, flow: ContactFlow | None = None,
        *, patience: Patience | None = None, added: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        """With the orbit that a wave was taken from, if it was, and the flow, if it is known;
        ``patience`` as :func:`orbit_next_to`; and what had to be added to the state of a wave
        beside it for its orbit's."""
        self.wave, self.of_orbit, self._patience = wave, orbit is not None, patience
        self._added = added
        if orbit is not None:
            vars(self).update(near=orbit, flow=orbit.flow)
        elif flow is not None:
            vars(self).update(flow=flow)

    def is_of(self, other: Wave) -> bool:
        """Whether another wave is the same one, so that this is its judgement."""
        pairs = [(getattr(self.wave, one.name), getattr(other, one.name)) for one in fields(Wave)]
        return all(
            mine is its or (isinstance(mine, int | float) and mine == its) for mine, its in pairs
        )

    @cached_property
    def flow(self) -> ContactFlow | None:
        """Of the structure; None where none is known."""
        wave = self.wave
        if wave.contact is None or not wave.structure.n_pairs:
            return None
        return flow_of(wave.structure, wave.contact)

    @cached_property
    def predicted(self) -> Prediction | None:
        """One step of Newton's method of the whole wave; None where its motion is not followed."""
        flow, wave = self.flow, self.wave
        return None if flow is None else predicted(flow, wave.omega, self.states, wave.subharmonic)

    @property
    def prediction(self) -> float:
        """The error predicted; infinite where it is not known."""
        return np.inf if self.predicted is None else self.predicted.error

    @cached_property
    def near(self) -> PeriodicOrbit | None:
        """The orbit next to it; None where none is found, or the step or a period is too long to
        look for one."""
        if self.predicted is None or not self.prediction < UNKNOWN or self.too_slow:
            return None
        assert self.flow is not None
        omega, periods = self.wave.omega, self.wave.subharmonic
        patience = self._patience if self.prediction < FAR else Patience(0)
        return orbit_next_to(
            self.flow, omega, self.states[0], periods, patience=patience,
            inverse=self.predicted.inverse, added=self._added,
        )  # fmt: skip

    @cached_property
    def finer(self) -> Judgement | None:
        """That of the same motion with twice the harmonics; None where these are too many, or do
        not lead to one."""
        wave = self.wave
        most = MOST_HARMONICS * wave.subharmonic
        if self.predicted is None or 2 * wave.harmonics > most or self.too_slow:
            return None
        assert wave.contact is not None
        problem = Problem(
            wave.structure, wave.omega, wave.contact, 2 * wave.harmonics,
            subharmonic=wave.subharmonic,
        )  # fmt: skip
        found = problem.next_to(wave, self._patience)
        return None if found is None else Judgement(found, flow=self.flow, patience=self._patience)

    @cached_property
    def decisive(self) -> Judgement | None:
        """The judgement with the fewest harmonics, these or more, whose orbit is next to it beyond
        doubt; None where none is."""
        if self.of_orbit:
            return self
        believed = self.believes(self._to_near)
        if near := self._to_near <= FARTHEST:
            assert self.near is not None
            near = not self.leads_elsewhere(_apart(self, self.near.state))
        short = self.prediction <= FARTHEST
        beyond_doubt = short and self._to_near <= NO_DOUBT
        only = believed and near and (beyond_doubt or self._is_only())
        if only and (short or _leads_back(self.near, self.wave)):
            return self
        if self.finer is None:
            return None
        if (believed or self._leaves_it_behind) and alike(self.near, self.finer.near):
            return self
        found = self.finer.decisive
        if found is None or not believed or alike(self.near, found.near):
            return found
        return found if self.to(found.near) < self._to_near else None  # the first is the nearer one

    @property
    def _leaves_it_behind(self) -> bool:
        """Whether twice the harmonics leave no more than a third of a distance that is too long for
        what was predicted: next to grazing one step predicts too little, of both waves."""
        assert self.finer is not None
        return BELIEVED * self.finer._to_near <= self._to_near <= FARTHEST

    @cached_property
    def orbit(self) -> PeriodicOrbit | None:
        """The orbit that decides, or else the nearest one known, if any is."""
        if self.decisive is not None:
            return self.decisive.near
        known = self.near, None if self.finer is None else self.finer.orbit
        return min((one for one in known if one is not None), key=self.to, default=None)

    def _is_only(self) -> bool:
        """Whether no other orbit as near is found from the state behind the wave's step."""
        other = self._ahead
        return other is None or alike(self.near, other) or not self.believes(self.to(other))

    def _has_none_nearer(self, distance: float) -> bool:
        """Whether an orbit so far away is as near as was predicted, or that which is found from the
        state behind the wave's step is no nearer."""
        if distance <= max((1.0 + FARTHEST) * self.prediction, NO_DOUBT) or self._ahead is None:
            return True
        return not self.to(self._ahead) < (1.0 - FARTHEST) * distance

    @cached_property
    def _ahead(self) -> PeriodicOrbit | None:
        """The orbit found from the state behind the wave's step."""
        if (step := self.predicted) is None or self.flow is None:
            return None
        wave, start = self.wave, step.states[0]
        return orbit_next_to(self.flow, wave.omega, start, wave.subharmonic, patience=Patience(0))

    @cached_property
    def states(self) -> np.ndarray:
        """Of the wave at equal parts of its period: (32, 2 n_modes)."""
        assert self.flow is not None
        displacement = self.wave.displacement_coefficients
        return wave_states(self.flow, displacement, self.wave.base_omega)

    @cached_property
    def distance(self) -> float:
        """Of the gaps of the wave and the orbit over the period, relative to what moves of B^T u;
        nan without an orbit."""
        return self._to_near if self.orbit is self.near else self.to(self.orbit)

    @cached_property
    def _to_near(self) -> float:
        return self.to(self.near)

    def to(self, orbit: PeriodicOrbit | None) -> float:
        """The distance to an orbit; nan without one."""
        if orbit is None or _still(orbit.sampled):
            return np.nan if orbit is None else 0.0
        samples, wave = orbit.sampled, self.wave
        moved = samples.gap + wave.structure.clearance
        return relative_to_motion(samples.gap - wave.gap(samples.time), moved)

    @property
    def still(self) -> bool:
        """Whether the orbit's lips, which the load presses together, move by rounding only."""
        return self.orbit is not None and _still(self.orbit.sampled)

    @property
    def accepted(self) -> bool:
        """Whether the orbit is the wave's own."""
        decisive = self.decisive
        own = decisive is self or (decisive is not None and self.believes(self.distance))
        return self.of_orbit or (own and self.distance <= FAR)

    @property
    def expected(self) -> bool:
        """Whether the orbit is as near as was predicted: one that is accepted, though it is not,
        tells the error and no verdict."""
        return self.of_orbit or self.believes(self.distance)

    def believes(self, distance: float) -> bool:
        """Whether an orbit so far away may be the wave's own."""
        near = distance <= max(BELIEVED * self.prediction, KNOWN)
        return near or distance <= 2.0 * _unsolved(self.wave)

    def leads_elsewhere(self, away: float) -> bool:
        """Whether an orbit whose state is so far away is another one, though gaps are near: pairs
        may hardly see a mode."""
        step = self.predicted
        return away > NO_DOUBT and (step is None or away > BELIEVED * _apart(self, step.states[0]))

    def admits(self, distance: float, away: float, orbit: PeriodicOrbit | None) -> bool:
        """Whether an orbit so far away, by its gaps and by its state, is the wave's own: a near
        one, or, at the wave's frequency, where it is given, one that leads back to it or that more
        harmonics confirm."""
        if max(distance, self.prediction) <= FARTHEST and not self.leads_elsewhere(away):
            return self.believes(distance) and self._has_none_nearer(distance)
        if orbit is None:
            return False
        if self.prediction < UNKNOWN:
            vars(self).setdefault("near", orbit)
        return self.accepted and self.expected and abs(distance / self.distance - 1.0) <= FARTHEST

    def suggest(self, orbit: PeriodicOrbit) -> None:
        """Take an orbit for the one next to the wave, unless it may be another one's."""
        vars(self).setdefault("flow", orbit.flow)
        if self.believes(distance := self.to(orbit)) and distance <= FARTHEST:
            vars(self)["near"] = orbit

    @property
    def affordable(self) -> bool:
        """Whether there is a flow whose orbits are not sought for long: an error report is asked
        for each solution."""
        flow, wave = self.flow, self.wave
        return flow is not None and affordable(flow, wave.omega, wave.subharmonic)

    @property
    def too_slow(self) -> bool:
        """Whether the load is too slow for exact motions of small states."""
        flow, wave = self.flow, self.wave
        return flow is not None and too_slow(flow, wave.omega, wave.subharmonic)

    def errors(self, *, search: bool = True) -> tuple[float, float]:
        """Of the gap, and of the displacement at the load in the direction of each of its parts:
        the distance to the wave's own orbit; what is predicted where none is looked for; else
        :data:`UNKNOWN`, which is also the most. A search that fails contradicts the one step that
        predicts: next to grazing the orbit may be 15 times as far away."""
        if search and (self.accepted or self.believes(self.distance)):
            return min(self.distance, UNKNOWN), min(_away_at_load(self), UNKNOWN)
        if self.prediction < UNKNOWN and not (search and self.prediction < FAR):
            return self.prediction, min(_predicted_at_load(self), UNKNOWN)
        return UNKNOWN, UNKNOWN

    @cached_property
    def larger(self) -> MoreModes | None:
        """What the reference of the structure makes of the motion; None where there is none whose
        flow is known."""
        structure, contact = self.wave.structure, self.wave.contact
        reference = structure.reference if isinstance(structure, ReducedStructure) else None
        if self.flow is None or contact is None or reference is None or not is_small(reference):
            return None
        flow = flow_of(reference, contact)
        return None if flow is None else MoreModes(self, flow)

    @property
    def reason(self) -> str:
        """Why no orbit is accepted; "" where one is."""
        return "" if self.accepted else _reason(self)


def farther(judged: Judgement) -> str:
    """How far away an orbit is that is not as near as predicted, in words."""
    return (
        f"the exact orbit next to it is {percent(judged.distance)} away where "
        f"{percent(judged.prediction)} were predicted"
    )


def _reason(judged: Judgement) -> str:
    """Why no orbit is accepted for a wave."""
    if judged.too_slow:
        assert judged.flow is not None
        turns = judged.flow.fastest * judged.wave.period / (2.0 * np.pi)
        return (
            f"the load is so slow that the highest modes turn {turns / 1e3:.0f} thousand times "
            "in a period, too often for exact motions to be followed; keep fewer modes"
        )
    if judged.flow is None:
        return "its law or its structure has no exact flow"
    if judged.predicted is None:
        return "its pairs open and close too often to be followed; lips without mass do less so"
    if judged.orbit is None and judged.prediction < FAR:
        return "no exact orbit was found next to it; with more harmonics one may be"
    if judged.orbit is None:
        known = judged.prediction < UNKNOWN
        size = percent(judged.prediction) if known else "more than its size"
        return f"the harmonics left out change it by {size}; take more"
    if judged.believes(judged.distance):
        return (
            f"the exact orbit next to it, {percent(judged.distance)} away, may be another "
            "motion's; take more harmonics"
        )
    return f"{farther(judged)}, another one; more harmonics tell these apart"


def _apart(judged: Judgement, state: np.ndarray) -> float:
    """How far a state at phase zero is from the wave's, by amplitudes."""
    assert judged.flow is not None
    weights, own = judged.flow.weights(judged.wave.base_omega), judged.states[0]
    return relative(weights * (state - own), weights * own)


def _unsolved(wave: Wave) -> float:
    """How far the gaps of a wave are from those of its displacement, relative: its equations are
    solved to a part of all its motion, the means with it, of which what moves may be little."""
    time = wave.period / INSTANTS * np.arange(INSTANTS)
    moved = wave.structure.apply_bt(wave.coordinates(time))
    return relative_to_motion(moved - wave.structure.clearance - wave.gap(time), moved)


def _leads_back(orbit: PeriodicOrbit | None, wave: Wave) -> bool:
    """Whether the motion of an orbit, balanced with as many harmonics as a wave has, is the
    wave."""
    assert wave.contact is not None and orbit is not None
    problem = Problem(
        wave.structure, wave.omega, wave.contact, wave.harmonics, subharmonic=wave.subharmonic,
        static_above=wave.static_above,
    )  # fmt: skip
    known = orbit.coefficients(wave.harmonics)
    return problem.left(wave, known.gap, known.force) <= FARTHEST


def alike(one: PeriodicOrbit | None, other: PeriodicOrbit | None) -> bool:
    """Whether two orbits are the same."""
    if one is None or other is None:
        return False
    weights = one.flow.weights(one.omega / one.subharmonic)
    return relative(weights * (one.state - other.state), weights * one.state) <= KNOWN


def _still(samples: Samples) -> bool:
    """Whether lips move by rounding only."""
    slow = samples.states[:, : samples.flow.size // 2] @ samples.flow.modes.pairs
    moved = samples.gap + samples.flow.structure.clearance
    return bool(np.linalg.norm(moved) <= NEGLIGIBLE * np.linalg.norm(slow))


def seen_parts(structure: Structure) -> np.ndarray:
    """By which parts of the load the displacement at it is seen: (3,) bool; those that vibrate, if
    there are some (collective)."""
    found = structure.sum_over_ranks(np.sum(structure.force**2, axis=1)) > 0.0
    found[0] &= not found[1:].any()
    return np.asarray(found)


def relative(change: np.ndarray, whole: np.ndarray) -> float:
    """Size of a change relative to that of the whole."""
    size = float(np.linalg.norm(whole))
    return float(np.linalg.norm(change)) / size if size > 0.0 else 0.0


def _predicted_at_load(judged: Judgement) -> float:
    assert judged.flow is not None and judged.predicted is not None
    wave, flow, count = judged.wave, judged.flow, judged.flow.size // 2
    change = (judged.predicted.states - judged.states)[:, :count] @ flow.modes.shapes.T
    time = np.arange(len(change)) * wave.period / len(change)
    force = wave.structure.force[seen_parts(wave.structure)].T
    return relative_to_motion(change @ force, wave.coordinates(time) @ force)


def _away_at_load(judged: Judgement) -> float:
    assert judged.orbit is not None
    samples, structure = judged.orbit.sampled, judged.wave.structure
    force, moved = structure.force[seen_parts(structure)].T, samples.displacement
    change = moved - judged.wave.coordinates(samples.time)
    return relative_to_motion(change @ force, moved @ force)


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
        return affordable(self.flow, wave.omega, wave.subharmonic, FLOWS)

    @property
    def too_slow(self) -> bool:
        """Whether the load is too slow for its exact motions."""
        wave = self._judged.wave
        return too_slow(self.flow, wave.omega, wave.subharmonic)

    @cached_property
    def _states(self) -> np.ndarray | None:
        """At equal parts of the period: of the orbit, where it is known, else of the wave behind
        its own step; None where that is not known."""
        judged, wave = self._judged, self._judged.wave
        orbit, every = judged.orbit, slice(None, None, INSTANTS // PARTS)
        time = wave.period / INSTANTS * np.arange(INSTANTS)
        if orbit is not None and judged.accepted:
            few, force = orbit.sampled.states[every], orbit.sampled.force
        elif judged.predicted is not None:
            few = judged.predicted.states
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
        return self._judged.wave.period / PARTS * np.arange(PARTS)

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
        seen, half = seen_parts(wave.structure), self.flow.size // 2
        moved = (self.predicted.states - states)[:, :half] @ self.flow.force[seen].T
        at_load = relative_to_motion(
            moved, wave.coordinates(self._time) @ wave.structure.force[seen].T
        )
        return self._of_gap(self._gap(self.predicted.states) - gap, gap), at_load

    def _of_gap(self, change: np.ndarray, gap: np.ndarray) -> float:
        """A change relative to what moves of B^T u; 0 where that is rounding."""
        clearance = self._judged.wave.structure.clearance
        return 0.0 if self._judged.still else relative_to_motion(change, gap + clearance)

    @cached_property
    def orbit(self) -> PeriodicOrbit | None:
        """Next to the motion; None where none is found."""
        if self._states is None or self.too_slow:
            return None
        wave = self._judged.wave
        return orbit_next_to(self.flow, wave.omega, self._states[0], wave.subharmonic)

    def contradicts(self, verdict: str, *, quick: bool = False) -> str:
        """What the orbit with these modes says against a verdict on stability, in words; "" where
        it says the same, or is not known. With ``quick`` it is asked where M along the motion says
        so already, and found from the state behind its step."""
        if verdict not in ("stable", "unstable") or not self.affordable:
            return ""
        orbit = self._foreseen(verdict) if quick else self.orbit
        size = 1.0 if orbit is None else float(abs(orbit.multipliers[0]))
        other = "stable" if size < 1.0 else "unstable"
        if other == verdict or abs(size - 1.0) <= KNOWN:
            return ""
        many = len(self.flow.modes.squares)
        return f"with {many} modes the orbit is {other} (largest multiplier {size:.6g})"

    def _foreseen(self, verdict: str) -> PeriodicOrbit | None:
        """The orbit ahead of the motion; None where M along that is on the side of the verdict."""
        wave, step = self._judged.wave, self.predicted
        if step is None or self.too_slow or self.flow.size > FORMED:
            return None
        if (abs(eigenvalues(step.monodromy)[0]) < 1.0) == (verdict == "stable"):
            return None
        return orbit_next_to(
            self.flow, wave.omega, step.states[0], wave.subharmonic, patience=Patience(0),
            inverse=step.inverse,
        )  # fmt: skip

    @property
    def distances(self) -> tuple[float, float] | None:
        """Of the gap, and of the displacement at the load, between the orbits with these modes and
        without them; None where one is not known."""
        few, many = self._judged.orbit, self.orbit
        if few is None or many is None:
            return None
        gap, seen = few.sampled.gap, seen_parts(few.flow.structure)
        moved, more = (
            orbit.sampled.displacement @ orbit.flow.structure.force[seen].T for orbit in (few, many)
        )
        at_load = relative_to_motion(more - moved, moved)
        return self._of_gap(many.sampled.gap - gap, gap), at_load
