"""Periodic orbits of a flow as a system of equations: z(T) = z(0).

In x = z / |z_0| and p = w / w_0, z_0 and w_0 those of a motion nearby, an orbit solves

    F(x, p) = z(T; x, p) / |z_0| - x = 0,        T = 2 pi m / w,

z the state at phase zero, m the periods of the load in the response's; dF/dx = M - I with the
monodromy matrix M. The orbit next to a balanced wave begins from the wave's states, whose error
one Newton step on the flow predicts.

From any state a path leads to an orbit (:class:`Homotopy`),

    p (z(T) - a) - (z - a) = 0,    from z = a at p = 0 to an orbit at p = 1,

through folds: damping lets no solution for p <= 1 go far, and at p = 0 there is no other. How long
the path is nobody knows.

Source: Chow, Mallet-Paret and Yorke, Mathematics of Computation 32 (1978) 887-899.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice

import numpy as np

from fenics_crack.errors import ConvergenceError
from fenics_crack.kernel import Struct, kernel, owned, pointer
from fenics_crack.motion.flow import Budget, ContactFlow, Motion
from fenics_crack.motion.orbit import (
    FLOWS,
    FORMED,
    INSTANTS,
    KNOWN,
    Inverse,
    PeriodicOrbit,
    find_orbit,
)
from fenics_crack.numerics.equations import LOCATED, DenseLinearisation, Equations
from fenics_crack.numerics.fourier import derivative, evaluate
from fenics_crack.numerics.newton import PathPoint, point_on_path, solve_in_plane
from fenics_crack.numerics.path import NARROW, Path, Target
from fenics_crack.stages import begin
from fenics_crack.table import counted, percent

PARTS = 32
"""Of the period, whose starts' states are corrected together."""
WANDERING, PASSED, SETTLING, LATER = 1000, 100, 60, 8
"""Periods that a motion is followed for, its nearest recurrences from which an orbit is sought, the
periods of large states' motions, and those after which it may be where it was."""
PACE = 200
"""Pieces a period in a motion that is followed for all of them; one with more, for fewer."""
SETTLED = 1e-3
"""How near a motion comes to where it was before, relative, that has settled."""
FEW = 24
"""Numbers of a state up to which all those are tried; beyond, fewer, as each takes longer."""


class OrbitPoint(DenseLinearisation):
    """The equations of periodic orbits at a state and a frequency.

    Attributes
    ----------
    events, pieces : int
        Switching instants in the period, and pieces of the Taylor series.
    """

    def __init__(
        self,
        unknown: np.ndarray,
        residual: np.ndarray,
        monodromy: Callable[[], np.ndarray],
        by_parameter: Callable[[], np.ndarray],
        events: int,
        pieces: int,
    ) -> None:
        self.unknown, self.residual = unknown, residual
        self.events, self.pieces = events, pieces
        self._monodromy, self._slope = monodromy, by_parameter

    @cached_property
    def monodromy(self) -> np.ndarray:
        """M = dz(T)/dz: (2n, 2n)."""
        return self._monodromy()

    @cached_property
    def jacobian(self) -> np.ndarray:
        """M - I."""
        return self.monodromy - np.eye(len(self.monodromy))

    @cached_property
    def by_parameter(self) -> np.ndarray:
        return self._slope()


def recurrences(passed: Sequence[np.ndarray] | np.ndarray, count: int) -> list[int]:
    """Where orbits are sought in a motion, of states (n, ...) a period apart: the last of them, and
    those from which the motion came nearest to where it had been, the nearest first."""
    apart = np.linalg.norm(np.diff(passed, axis=0), axis=1)
    return [-1, *map(int, np.argsort(apart, kind="stable")[:count])]


class FlowOrbits(Equations):
    """F(x, p) of the exact flow, in the kernel, x = w z / |w z_0| with 1 / w the modes' frequencies
    where z are velocities: by the amplitude. dF/dx = M - I and dF/dp are exact
    (``kernel/shooting.h``).

    Attributes
    ----------
    flow : ContactFlow
    omega : float
        omega_0, of the load [rad/s].
    subharmonic : int
        Its periods in one of the orbit.
    budget : Budget
        Of each motion.
    scale : (2 n_modes,)
        x / z.
    start : (2 n_modes,)
        x of the state nearby, at p = 1.
    """

    def __init__(
        self,
        flow: ContactFlow,
        omega: float,
        state: np.ndarray,
        subharmonic: int = 1,
        budget: Budget | None = None,
    ) -> None:
        self.flow, self.omega, self.shape = flow, omega, state.shape
        self.subharmonic, self.budget = subharmonic, budget or Budget()
        weights = flow.weights(omega / subharmonic)
        weights /= np.tile(weights[: flow.size // 2], 2)
        self.scale = weights / (float(np.linalg.norm(weights * state)) or 1.0)
        self.start = self.scale * state
        given = Struct(
            "shooting_equations", flow=flow.handle, modes=flow.size // 2,
            pairs=len(flow.softness), omega=omega, turns=2.0 * np.pi * subharmonic,
            scale=self.scale, pieces=self.budget.pieces, intervals=self.budget.intervals,
        )  # fmt: skip
        self._point = owned(kernel.new_shooting_point(given.at), kernel.free_shooting_point)
        self.table = kernel.equations_of_shooting(self._point)

    def linearise(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        """The equations at a point.

        Raises
        ------
        ConvergenceError
            The motion takes more than the budget allows, or is not finite.
        """
        self._evaluate(unknown, parameter)
        return self.found(unknown, parameter)

    def state(self, unknown: np.ndarray) -> np.ndarray:
        """z of x: (2n,)."""
        return np.asarray(unknown / self.scale)

    def unknown(self, state: np.ndarray) -> np.ndarray:
        """x of z: (2n,)."""
        return np.asarray(self.scale * state)

    def of_unknowns(self, monodromy: np.ndarray) -> np.ndarray:
        """dx(T)/dx of M = dz(T)/dz: (2n, 2n)."""
        return np.asarray(self.scale[:, None] * monodromy / self.scale)

    def unknown_of(self, displacement: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """x of other motions at phase zero, (..., n_dofs) each."""
        return self.unknown(self.flow.state(displacement, velocity))

    def moved(self, unknown: np.ndarray, parameter: float) -> np.ndarray:
        """x after a period."""
        self._evaluate(unknown, parameter)
        return unknown + self._residual()

    @property
    def pieces(self) -> int:
        """Of the Taylor series in the motion last followed."""
        return int(kernel.pieces_of(self._point))

    def followed(self, periods: int) -> np.ndarray:
        """The start after some periods of the response, nearer to what attracts it: (2n,)."""
        state = self.start
        for _ in range(periods):
            state = self.moved(state, 1.0)
        return state

    def gap(self, unknown: np.ndarray, parameter: float, count: int = INSTANTS) -> np.ndarray:
        """g at equally spaced instants of a period: (count, n_pairs) [m]."""
        return self._motion(unknown, parameter, np.arange(count) / count).samples.gap

    def orbit(self, found: PathPoint) -> PeriodicOrbit:
        """The orbit of a solution of the equations."""
        motion = self._motion(found.unknown, found.parameter, np.zeros(0))
        size = float(np.linalg.norm(found.unknown))
        off = float(np.linalg.norm(self.unknown(motion.state) - found.unknown))
        return PeriodicOrbit(
            self.flow, found.parameter * self.omega, self.subharmonic, motion,
            self.state(found.unknown), off / size if size > 0.0 else 0.0, found.iterations + 1,
        )  # fmt: skip

    def _motion(self, unknown: np.ndarray, parameter: float, instants: np.ndarray) -> Motion:
        """Over a period, sampled at parts of it."""
        omega = parameter * self.omega
        period = 2.0 * np.pi * self.subharmonic / omega
        return self.flow.advance(
            self.state(unknown), omega, period, instants=instants * period, budget=self.budget
        )

    def _evaluate(self, unknown: np.ndarray, parameter: float) -> None:
        assert unknown.shape == self.shape
        given = pointer(np.ascontiguousarray(unknown, dtype=float))
        if not self.check(self.run(self.table.evaluate, given, parameter)):
            raise ConvergenceError("orbits: the motion over a period cannot be followed")

    def _residual(self) -> np.ndarray:
        """F where it was evaluated last."""
        residual = np.empty(self.shape)
        self.table.residual(self.table, pointer(residual))
        return residual

    def found(self, unknown: np.ndarray, parameter: float) -> OrbitPoint:
        residual = self._residual()
        events = int(kernel.switches_of(self._point))

        def return_there() -> None:
            if self._last is None or self._last is not known():
                self._evaluate(unknown, parameter)
                self._last = known()

        def monodromy() -> np.ndarray:
            found = np.empty(2 * self.shape)
            return_there()
            kernel.tangent_of(self._point, pointer(found))
            return found

        def by_parameter() -> np.ndarray:
            slope = np.empty(self.shape)
            return_there()
            self.table.by_parameter(self.table, pointer(slope))
            return slope

        found = OrbitPoint(unknown, residual, monodromy, by_parameter, events, self.pieces)
        known = weakref.ref(found)
        self._last = found
        return found


class _HomotopyPoint(DenseLinearisation):
    """The homotopy's equations at a point."""

    def __init__(self, at: OrbitPoint, parameter: float, start: np.ndarray) -> None:
        self._at, self._parameter, self.unknown = at, parameter, at.unknown
        self._moved = at.unknown + at.residual - start
        self.residual = parameter * self._moved - (at.unknown - start)

    @cached_property
    def jacobian(self) -> np.ndarray:
        """p M - I."""
        monodromy = self._at.monodromy
        return self._parameter * monodromy - np.eye(len(monodromy))

    @property
    def by_parameter(self) -> np.ndarray:
        return self._moved


class Homotopy:
    """p (z(T) - a) - (z - a) = 0 in the unknowns x of some orbits, from their starts a.

    Attributes
    ----------
    left : int
        Pieces that motions may still have, from all starts together: some seconds.
    """

    def __init__(self, orbits: FlowOrbits) -> None:
        self._orbits, self.shape = orbits, orbits.shape
        self._start, self._at = orbits.start, 1.0
        self.left = int(_share(orbits) * PACE * WANDERING)

    def linearise(self, unknown: np.ndarray, parameter: float) -> _HomotopyPoint:
        """The equations at a point; raises as :meth:`FlowOrbits.linearise`, and where no pieces
        are left."""
        if self.left <= 0:
            raise ConvergenceError("orbits: the homotopy takes too long")
        at = self._orbits.linearise(unknown, self._at)
        self.left -= at.pieces
        return _HomotopyPoint(at, parameter, self._start)

    def end(self, start: np.ndarray, parameter: float) -> np.ndarray | None:
        """Where the path from a start leads, with the orbits' own parameter; None where it is lost,
        or that takes too long."""
        self._start, self._at = start, parameter
        options = replace(NARROW, max_steps=Budget.pieces)
        try:
            met = Path(self, point_on_path(self, start, 0.0), options, [Target(1.0)]).run()
        except (ConvergenceError, np.linalg.LinAlgError):
            return None
        return None if met is None else met.unknown


def wave_states(flow: ContactFlow, displacement: np.ndarray, base_omega: float) -> np.ndarray:
    """States at equal parts of the period of a wave of the displacement, given by its coefficients
    (2H+1, n_dofs) [m]: (32, 2 n_modes)."""
    time = 2.0 * np.pi / base_omega / PARTS * np.arange(PARTS)
    rate = derivative(displacement, base_omega)
    return flow.state(evaluate(displacement, base_omega, time), evaluate(rate, base_omega, time))


@dataclass
class Patience:
    """That of searches, perhaps of several together."""

    left: int
    """Homotopies that may still be followed."""
    paths: float = math.inf
    """Likewise paths to more harmonics."""


def orbit_next_to(
    flow: ContactFlow,
    omega: float,
    start: np.ndarray,
    subharmonic: int = 1,
    *,
    patience: Patience | None = None,
    inverse: Inverse | None = None,
    added: np.ndarray | None = None,
) -> PeriodicOrbit | None:
    """The orbit next to a state: by Newton's method, from the state, or from there with what is
    ``added``; or else, unless ``patience`` is at its end, where the homotopy from the state leads,
    where M is formed; None where these lead to none. Newton's method may begin with the inverse of
    a motion nearby.

    Where stiff pairs open and close many times, Newton's method finds an orbit only from very near.
    """
    orbit = find_orbit(flow, omega, start, subharmonic=subharmonic, inverse=inverse)
    if orbit is None and added is not None:
        orbit = find_orbit(flow, omega, start + added, subharmonic=subharmonic)
    patience = patience or Patience(1)
    if orbit is not None or not patience.left or flow.size > FORMED:
        return orbit
    patience.left -= 1
    return _by_homotopy(FlowOrbits(flow, omega, start, subharmonic))


def _by_homotopy(orbits: FlowOrbits) -> PeriodicOrbit | None:
    """The orbit to which the path from the start of some leads; None where that takes too long."""
    try:
        # M - I may be singular where the motion closes: next to a resonance without damping.
        closed = solve_in_plane(orbits, orbits.start, 1.0, None, tolerance=LOCATED, iterations=1)
    except (ConvergenceError, np.linalg.LinAlgError):
        return None
    if closed is not None:
        return orbits.orbit(closed)
    end = Homotopy(orbits).end(orbits.start, 1.0)
    if end is None:
        return None
    state = orbits.state(end)
    return find_orbit(orbits.flow, orbits.omega, state, subharmonic=orbits.subharmonic)


def recurring(
    flow: ContactFlow, omega: float, start: np.ndarray, subharmonic: int = 1
) -> tuple[PeriodicOrbit | None, str]:
    """An orbit that the motion from a state settles to, or passes on its way; None where none is
    found. And what the motion does, in words.

    Where no orbit attracts it the motion wanders, and passes near orbits that it leaves again, at
    times when it nearly repeats itself: from there Newton's method finds one.

    Source: Auerbach et al., Physical Review Letters 58 (1987) 2387-2389.
    """
    orbits = FlowOrbits(flow, omega, start, subharmonic)
    share = _share(orbits)
    periods = max(int(share * WANDERING), SETTLING)
    begin(f"the exact motion over up to {periods} periods, and orbits that it passes")
    passed = np.array([orbits.start, *_followed(orbits, orbits.start, periods)])
    count = share * min(PASSED, PACE / max(1, orbits.pieces) * WANDERING / FLOWS)
    for place in recurrences(passed, int(np.ceil(count))):
        orbit = find_orbit(flow, omega, orbits.state(passed[place]), subharmonic=subharmonic)
        # Where M is huge a step may be short and the motion does not close.
        if orbit is not None and orbit.residual <= KNOWN:
            return orbit, "exact orbit, by following the motion"
    return None, _comes_back(passed, subharmonic)


@dataclass(frozen=True, repr=False)
class Attractor:
    """Where a motion goes in the long run.

    Attributes
    ----------
    orbit : PeriodicOrbit or None
        The stable orbit to which it settles, perhaps one of several periods; None where it has not.
    told : str
        What it does, in words.
    periods : int
        Of the load, that it was followed for.
    orbits : FlowOrbits
        Of its flow and period.
    last : (2 n_modes,)
        The state x to which it was followed.
    """

    orbit: PeriodicOrbit | None
    told: str
    periods: int
    orbits: FlowOrbits
    last: np.ndarray

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.told})"

    def amplitudes(self, dof: int | None = None) -> np.ndarray:
        """Half the peak-to-peak displacement of a dof, or of the watched one, in each period of the
        orbit, or in 100 more where the motion does not settle: (n,) [m] (collective).

        Raises
        ------
        ConvergenceError
            It cannot be followed that long.
        """
        flow, omega = self.orbits.flow, self.orbits.omega
        period = 2.0 * np.pi * self.orbits.subharmonic / omega
        state, count = self.orbits.state(self.last), PASSED
        if self.orbit is not None:
            state, count = self.orbit.state, self.orbit.subharmonic // self.orbits.subharmonic
        time = np.arange(count * INSTANTS) * period / INSTANTS
        found = flow.advance(state, omega, count * period, instants=time).samples.displacement
        values = flow.structure.values_at(found, [dof]).reshape(count, INSTANTS)
        return np.asarray(np.ptp(values, axis=1) / 2.0)


def in_the_long_run(orbits: FlowOrbits, start: np.ndarray, most: int | None = None) -> Attractor:
    """What the exact motion from a state x does after many periods: it is followed until it has
    settled, or for ``most``, by default 1,000; with more than 24 modes or many events, which take
    longer, for fewer."""
    if most is None:
        most = int(min(1.0, 2.0 * FEW / orbits.flow.size) * WANDERING)
    most = max(LATER + 1, most)
    begin(f"the exact motion over up to {most} periods")
    passed, ahead = start[None], _followed(orbits, start, most)
    while more := list(islice(ahead, len(passed) - 1 + LATER)):
        passed = np.concatenate([passed, more])
        last = passed[-1]
        changes = np.linalg.norm(passed[-2 : -LATER - 2 : -1] - last, axis=1)
        size = np.linalg.norm(last)
        for several in np.flatnonzero(changes <= SETTLED * size):
            turns = int(1 + several) * orbits.subharmonic
            orbit = find_orbit(orbits.flow, orbits.omega, orbits.state(last), subharmonic=turns)
            if orbit is None:
                continue
            decays = 1.0 - abs(orbit.multipliers[0])
            off = np.linalg.norm(orbits.unknown(orbit.state) - last)
            # What decays by |mu| a period and is off by d changes by no less than (1 - |mu|) d.
            if decays > 0.0 and decays * off <= 2.0 * changes[several] + LOCATED * size:
                after = f"one that repeats itself after {turns} periods of the load"
                does = f"settles to {after if several else 'an orbit'}"
                return Attractor(orbit, does, (len(passed) - 1) * orbits.subharmonic, orbits, last)
    does = f"does not settle: {_comes_back(passed, orbits.subharmonic, 'it')}"
    return Attractor(None, does, (len(passed) - 1) * orbits.subharmonic, orbits, passed[-1])


def _share(orbits: FlowOrbits) -> float:
    """Of what a small structure's motion is followed, and of its recurrences that are tried."""
    return min(1.0, (FEW / orbits.flow.size) ** 2)


def _followed(orbits: FlowOrbits, state: np.ndarray, periods: int) -> Iterator[np.ndarray]:
    """States x a period apart of the motion from a state, after the first period and later ones; as
    far as it can be followed, and in as many pieces as there is time for."""
    left = PACE * periods
    with suppress(ConvergenceError):  # pairs that chatter without end
        for _ in range(periods):
            if left <= 0:
                return
            state = orbits.moved(state, 1.0)
            left -= orbits.pieces
            yield state


def _comes_back(passed: np.ndarray, subharmonic: int, motion: str = "the exact motion") -> str:
    """How near a motion, of states so many periods of the load apart (n, 2 n_modes), came to where
    it had been."""
    found = []
    for later in range(1, min(LATER, len(passed) - 1) + 1):
        sizes = np.linalg.norm(passed[later:], axis=1)
        apart = np.linalg.norm(passed[later:] - passed[:-later], axis=1)
        found.append(float(np.min(apart / np.maximum(sizes, 1e-300))))
    if not found:
        return f"{motion} cannot be followed for a period"
    nearest = int(np.argmin(found))
    followed, after = (one * subharmonic for one in (len(passed) - 1, nearest + 1))
    return (
        f"followed for {counted(followed, 'period')} of the load, {motion} comes back to within "
        f"{percent(found[nearest])} of where it was at best, after {counted(after, 'period')}"
    )
