"""Campbell diagrams: natural frequencies over a rotor's speed, and the engine orders they meet.

A blade is excited at multiples of the rotor's speed, w = n W with the engine order n. Resonances
are where such a line crosses a natural frequency. Of a crack that breathes they lie near the
bilinear frequency 2 w_o w_t / (w_o + w_t), between those with the crack open and bonded
(:mod:`fenics_crack.model.modes`); where rotation or the mean load holds the crack open or shut,
at the open or the bonded one, or where some pairs are pressed and others open, at one with the
pressed ones bonded. It is held where the resonance of that state cannot change it: with the
amplitude a = |phi . f| / (2 xi w^2) of the mode, where the open pairs are open at rest by more
than a |B^T phi|, and the pressed ones are pressed by more than the force a |lambda| of the mode
with these bonded, (K - w^2 M) phi + B lambda = 0.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI
from scipy.optimize import brentq

from fenics_crack.basics.errors import InputError, check_choice, check_count
from fenics_crack.basics.report import Report
from fenics_crack.basics.tables import (
    RPM,
    Said,
    counted,
    hertz_of,
    in_unit,
    speed_axis,
    with_frequency,
)
from fenics_crack.fem.build import with_crack_length
from fenics_crack.files.saved import Saved
from fenics_crack.files.store import Stored
from fenics_crack.model.body import Body
from fenics_crack.model.matrices import numbers
from fenics_crack.model.modes import (
    FREQUENCY_KIND_NAMES,
    BilinearFrequencies,
    Modes,
    count_bonded_modes,
    find_bonded_mode_indices,
    multiply,
    solve_modes,
)
from fenics_crack.model.rotation import (
    RitzProjection,
    RunUpStructure,
    coriolis_shifts,
    static_state,
)
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.study.plausibility import coriolis_in_words, damping_ratios, remarks_on_scene
from fenics_crack.study.prepare import REFUSALS, law_of
from fenics_crack.study.resonance import NOT_SOUGHT, SOUGHT_MODES, AtLoad, at_load
from fenics_crack.study.sharing import assembled

HELD = (*FREQUENCY_KIND_NAMES[:2], "partly")
"""Kinds of frequencies of a crack that its resonance does not change."""
STATES = {
    **dict(zip(HELD, ("held open", "held shut", "held partly open"), strict=True)),
    "bilinear": "breathing",
}
"""Motion of a crack whose frequency is of a kind."""
CHANGE = 1e-4
"""Relative accuracy of the speed at which the state changes, or an order meets a mode."""
ORDERS = 8
"""Engine orders that are reported where the load has none, and drawn."""
At = Callable[[float], tuple[np.ndarray, np.ndarray]]
"""Frequencies at a speed, and by how much the crack is held: (3, count) each."""
Peaks = Callable[[Modes], np.ndarray]
"""Amplitudes of modes at their own resonances under a load."""


@dataclass(frozen=True, repr=False)
class Campbell(Saved):
    """Natural frequencies over the speed.

    Attributes
    ----------
    scene : Scene
        The blade's.
    speed : (n,) [rad/s]
        W, rising.
    omega_open, omega_tied : (n, m) [rad/s]
        With the crack open, in ascending order at each speed, and of the same shapes with it
        bonded; the same without a crack.
    omega_partly : (n, m) [rad/s]
        With the pairs bonded that are pressed at rest, of the same shapes.
    cracked : bool
        True if there are crack faces.
    kind : (n, m) of "open", "tied", "partly" or "bilinear"
        Kind of the crack's frequency at this speed, under the scene's load: it is held open,
        held shut, held with some pairs pressed and the others open, or breathes.
    changes : tuple of (mode, speed, kind)
        Where between two speeds this changes: from which speed [rad/s] on the crack is of which
        kind in which mode (from 1).
    coriolis : (m,)
        Relative changes of the open frequencies at the fastest speed by the Coriolis force of a
        solid, which is left out.
    at : function of a speed [rad/s], optional
        Frequencies held open, shut and partly open there, and by how much: (3, m) each; of a
        diagram from a file None: the blade is meshed again when it is needed.
    met : tuple of (mode, AtLoad)
        At each crossing of the load's own engine order, the resonance at the load over the speed.
    """

    scene: Scene
    speed: np.ndarray
    omega_open: np.ndarray
    omega_tied: np.ndarray
    omega_partly: np.ndarray
    cracked: bool
    kind: np.ndarray
    changes: tuple[tuple[int, float, str], ...]
    coriolis: np.ndarray
    at: At | None = None
    met: tuple[tuple[int, AtLoad], ...] = ()

    KIND: ClassVar[str] = "Campbell diagram"
    frequency_open, frequency_tied = hertz_of("omega_open"), hertz_of("omega_tied")
    frequency_partly, frequency_real = hertz_of("omega_partly"), hertz_of("omega_real")
    frequency_bilinear = hertz_of("omega_bilinear")

    @classmethod
    def of(cls, stored: Stored) -> Campbell:
        """A diagram from a file that has been read, whose mesh has not changed."""
        found = super().of(stored)
        stored.check_files(found.scene)
        return found

    @cached_property
    def _at(self) -> At:
        """Return the function :attr:`at`, from the scene if there is none."""
        count = self.omega_open.shape[1]
        return self.at or campbell(self.scene, self.speed, count, MPI.COMM_SELF)._at

    @property
    def omega_bilinear(self) -> np.ndarray:
        """2 w_o w_t / (w_o + w_t): (n, m) [rad/s]."""
        return BilinearFrequencies(self.omega_open, self.omega_tied).omega_bilinear

    @property
    def omega_real(self) -> np.ndarray:
        """Natural frequencies in the crack's state at each speed: (n, m) [rad/s]."""
        of_kinds = [getattr(self, f"omega_{kind}") for kind in STATES]
        return np.select([self.kind == kind for kind in STATES], of_kinds)

    @property
    def kinds(self) -> tuple[str, ...]:
        """ "open", "tied" and "bilinear", and "partly" where the crack is that somewhere; "open"
        alone without a crack."""
        seen = {*self.kind.ravel().tolist(), *(change[-1] for change in self.changes)}
        found = (*FREQUENCY_KIND_NAMES, *seen.intersection({"partly"}))
        return found if self.cracked else FREQUENCY_KIND_NAMES[:1]

    def crossings(self, order: int, kind: str = "bilinear") -> np.ndarray:
        """Find where w = order W meets natural frequencies: (k, 2), mode (from 1), speed [rad/s].

        They are sought between two speeds on whose sides of the order's line a mode is.

        Parameters
        ----------
        order : int
            Engine order n.
        kind : "open", "tied", "partly", "bilinear" or "real"
            Of the frequencies; the last are those that the crack has at each speed. Where it
            changes and its frequency falls across the order's line, they meet at the change.

        Raises
        ------
        InputError
            An argument cannot be used.
        """
        check_count("order", order, 1)
        check_choice("kind", kind, (*STATES, "real"))
        if kind == "real":
            return self._real_crossings(order)

        def over(speed: float, mode: int) -> float:
            return self._omega(mode, speed, kind) - order * speed

        above = getattr(self, f"omega_{kind}") > order * self.speed[:, None]
        found = []
        for place, mode in np.argwhere(above[1:] != above[:-1]).tolist():
            ends = self.speed[place : place + 2].tolist()
            found.append((mode + 1, brentq(over, *ends, (mode + 1,), rtol=CHANGE)))
        return np.array(sorted(found)).reshape(-1, 2)

    def _real_crossings(self, order: int) -> np.ndarray:
        """Return the crossings with each state's line where the crack is in it, or changes."""
        found = [
            (mode, speed)
            for kind in self.kinds
            for mode, speed in self.crossings(order, kind)
            if self._states(int(mode), speed)[1] == kind
        ]
        for mode, speed, _ in self.changes:
            before, after = (self._omega(mode, speed, k) for k in self._states(mode, speed))
            if before > order * speed > after:
                found.append((mode, speed))
        return np.array(sorted(found)).reshape(-1, 2)

    def _states(self, mode: int, speed: float) -> tuple[str, str]:
        """Return the crack's state just below a speed, and from it on."""
        known = [*zip(self.speed.tolist(), self.kind[:, mode - 1].tolist(), strict=True)]
        known = sorted([*known, *((at, kind) for which, at, kind in self.changes if which == mode)])
        below = [kind for at, kind in known if at < speed] or [known[0][1]]
        return below[-1], [kind for at, kind in known if at <= speed][-1]

    def _omega(self, mode: int, speed: float, kind: str) -> float:
        """A natural frequency at a speed."""
        omega = self._at(speed)[0][:, mode - 1]
        if kind == "bilinear":
            return float(BilinearFrequencies(omega[0], omega[1]).omega_bilinear)
        return float(omega[HELD.index(kind)])

    def real_line(self, mode: int) -> list[tuple[float, float, str]]:
        """Speeds [rad/s], the crack's frequency in a mode (from 1) [rad/s] and its kind, along a
        line: two points where the crack changes."""
        speeds = {*self.speed.tolist(), *(at for which, at, _ in self.changes if which == mode)}
        return [
            (at, self._omega(mode, at, kind), kind)
            for at in sorted(speeds)
            for kind in dict.fromkeys(self._states(mode, at))
        ]

    def _at_load(self, order: int) -> list[tuple[int, float, AtLoad]]:
        """Each crossing of an engine order: mode, speed, and of the load's own the resonance there;
        elsewhere it is not known."""
        own, every = order == self.scene.excitation.order, self.crossings(order, "real").tolist()
        found = [one for _, one in self.met] if own else []
        found += [NOT_SOUGHT] * len(every)
        return [(int(mode), speed, one) for (mode, speed), one in zip(every, found, strict=False)]

    def meetings(self, order: int) -> Iterator[str]:
        """Each crossing of an engine order in words: with which mode, of the load's own at which
        speed at the load, and at which with the natural frequency of the crack as it is there, and
        as it would be otherwise."""
        for mode, speed, found in self._at_load(order):
            text = f"engine order {order} meets mode {mode} at "
            if math.isfinite(found.value):
                text += f"{_in_words(found.value)} at the load, {found.in_words}; estimated at "
            text += _in_words(speed)
            if self.cracked:
                own = [*dict.fromkeys(self._states(mode, speed))]
                others = [
                    f"{STATES[kind]} at {_in_words(other)}"
                    for kind in FREQUENCY_KIND_NAMES
                    if kind != own[-1] or len(own) > 1
                    for which, other in self.crossings(order, kind)
                    if which == mode
                ]
                text += f" with the crack {' before and '.join(STATES[kind] for kind in own)}"
                text += " after" if len(own) > 1 else ""
                text += " (bilinear estimate)" if "bilinear" in own else ""
                text += f"; it would be {', '.join(others)}" if others else ""
            yield text + f"; there d ln f / d ln n = {self.stiffening(speed, order * speed):.2g}"

    def stiffening(self, speed: float, omega: float) -> float:
        """Return d ln w / d ln W of the mode nearest to a frequency at a speed [rad/s].

        It is of the kind that the crack has at the next of the speeds; w^2 is linear in W^2
        (Southwell) between two speeds and beyond them. For :func:`find_passages`.
        """
        near = self.kind[int(np.abs(self.speed - speed).argmin())]
        of_kinds = [getattr(self, f"omega_{kind}") for kind in STATES]
        own = np.select([near == kind for kind in STATES], of_kinds)
        there, slope = self._squares(speed, own)
        mode = int(np.abs(np.sqrt(np.maximum(there, 0.0)) - omega).argmin())
        return float(slope[mode] * speed**2 / there[mode])

    def between(self, speed: float) -> tuple[np.ndarray, np.ndarray]:
        """Natural frequencies with the crack open and bonded at a speed [rad/s], in the same way:
        (m,) each [rad/s]."""
        squares = (self._squares(speed, one)[0] for one in (self.omega_open, self.omega_tied))
        opened, tied = (np.sqrt(np.maximum(square, 0.0)) for square in squares)
        return opened, tied

    def _squares(self, speed: float, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Squares (m,) at a speed of frequencies (n, m), and their slopes over its square."""
        squares, turns = omega**2, self.speed**2
        place = int(np.clip(np.searchsorted(self.speed, speed), 1, len(turns) - 1))
        slope = (squares[place] - squares[place - 1]) / (turns[place] - turns[place - 1])
        return squares[place] + slope * (speed**2 - turns[place]), slope

    def to_dict(self) -> dict[str, Any]:
        """Columns, a row for every speed and mode."""
        n, m = self.omega_open.shape
        speed = np.repeat(self.speed, m)
        found = {"speed": speed.tolist(), "mode": np.tile(np.arange(1, m + 1), n).tolist()}
        if self.cracked:
            found["crack"] = [STATES[kind] for kind in self.kind.ravel()]
        for kind in self.kinds:
            for name in (f"omega_{kind}", f"frequency_{kind}"):
                found[name] = getattr(self, name).ravel().tolist()
        return with_frequency(found)

    def said(self) -> Said:
        """What the last sentence on the diagram says: where the load's engine order meets modes."""
        axis, order = speed_axis(self.scene.in_rpm), self.scene.excitation.order
        modes = counted(self.omega_open.shape[1], "mode")
        outcome = f"{modes} found between {in_unit(axis, self.speed[0], self.speed[-1])}"
        if order is None:
            return Said(outcome)
        met = [
            f"mode {mode} at {in_unit(axis, speed if found.unknown else found.value)}"
            for mode, speed, found in self._at_load(order)
        ]
        return Said(outcome, f"engine order {order} meets {', '.join(met) or 'none of them'}")

    def _title(self) -> str:
        span = f"speed {self.speed[0]:.6g} to {self.speed[-1]:.6g} rad/s"
        first = self.omega_bilinear[[0, -1], 0]
        rise = f"first {first[0]:.6g} to {first[1]:.6g} rad/s"
        return f"{span}, {counted(self.omega_open.shape[1], 'mode')}, {rise}"


def campbell(
    scene: Scene,
    speeds: Sequence[float] | np.ndarray,
    count: int | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    few: int = 4,
) -> Campbell:
    """Natural frequencies of a scene's blade at some speeds; it is meshed once (collective).

    Parameters
    ----------
    scene : Scene
        With a table ``[rotation]``, whose own speed does not matter.
    speeds : (n,) [rad/s]
        Two or more, rising from 0 or more.
    count : int, optional
        Number of the lowest modes; default: ``few``, or all of fewer.
    comm : MPI.Comm
        Ranks that share the mesh.
    few : int
        Number if ``count`` is not given.

    Returns
    -------
    Campbell
        Frequencies with the crack open and bonded at each speed, and what the crack does.

    Raises
    ------
    InputError
        An argument cannot be used, or a speed is too high.

    Examples
    --------
    >>> diagram = fc.campbell(blade, [0.0, 150.0, 300.0], count=2)
    """
    if scene.disk is not None:
        allowed = "left out of a Campbell diagram; nodal_diameters has its frequencies"
        raise InputError("disk", "a table", allowed)
    scene.given("rotation")
    _, axis = scene.axis
    check_count("count", few if count is None else count, 1)
    wanted = np.atleast_1d(numbers(speeds))
    rising = wanted.ndim == 1 and len(wanted) > 1 and bool(np.all(np.diff(wanted) > 0.0))
    if not (rising and wanted[0] >= 0.0 and np.isfinite(wanted[-1])):
        raise InputError("speeds", speeds, "two or more finite numbers, rising from 0 or more")
    asked = scene
    scene = with_crack_length(scene.replace({"rotation.speed": float(wanted[-1])}), comm)
    top = assembled(scene, comm)
    most = count_bonded_modes(top)
    if count is not None and count > most:
        raise InputError("count", count, f"a whole number from 1 to {most}")
    count = min(few, most) if count is None else count
    # That of an open mode's shape may come later, where the bond has taken it past others.
    n_tied = min(count + 2, most) if top.n_pairs else 0
    small = RitzProjection.of_range(top.damped(None), wanted[0], wanted[-1], count, n_tied)
    peaks = partial(_at_resonance, small.force[1] - 1j * small.force[2], top)

    @cache
    def at(speed: float) -> tuple[np.ndarray, np.ndarray]:
        return _frequencies(small.structure_at_speed(speed), peaks, count, n_tied)

    omega, holds = zip(*map(at, wanted.tolist()), strict=True)
    opened, tied, partly = np.moveaxis(omega, 1, 0)
    changes = tuple(
        (mode + 1, speed, kind)
        for mode in range(count)
        for ends in pairwise(wanted.tolist())
        for speed, kind in _changes(at, *ends, mode)
    )
    kind = np.array([_kinds(hold) for hold in holds])
    last = solve_modes(small.structure_at_speed(wanted[-1]), count)
    modes = Modes(last.omega, small.basis @ last.shapes, top)
    coriolis = coriolis_shifts(modes, wanted[-1] * axis)
    found = Campbell(
        asked, wanted, opened, tied, partly, top.n_pairs > 0, kind, changes, coriolis, at
    )
    return replace(found, met=_met(found, replace(small, structure=top)))


def _met(found: Campbell, small: RitzProjection) -> tuple[tuple[int, AtLoad], ...]:
    """Return the resonances at the load where its engine order crosses natural frequencies."""
    scene, order, law = (
        found.scene,
        found.scene.excitation.order,
        law_of(found.scene, small.structure),
    )
    if order is None or law is None:
        return ()
    many = replace(small, n_modes=max(small.n_modes, SOUGHT_MODES))

    def find_resonance(speed: float) -> AtLoad:
        try:
            return at_load(scene, law, RunUpStructure(many, speed), order * speed, "speed")
        except REFUSALS as error:
            return AtLoad(unknown=str(error))

    crossings = found.crossings(order, "real").tolist()
    return tuple((int(mode), find_resonance(speed)) for mode, speed in crossings)


def report_of_campbell(found: Campbell) -> Report:
    """The frequencies, and where engine orders meet them: the load's, or those up to
    :data:`ORDERS`."""
    scene = found.scene
    own, unit = scene.excitation.order, "frequency" if scene.in_hertz or scene.in_rpm else "omega"
    orders = [own] if own else [*range(1, ORDERS + 1)]
    notes = [text for order in orders for text in found.meetings(order)]
    if not notes and own is None:
        notes = [f"engine orders 1 to {ORDERS} meet none"]
    if text := coriolis_in_words(found.coriolis):
        notes.append(f"at {in_unit(speed_axis(scene.in_rpm), found.speed[-1])} {text}")
    columns = ["rpm" if scene.in_rpm else "speed", "mode"]
    columns += [*(f"{unit}_{kind}" for kind in found.kinds), *(["crack"] if found.cracked else [])]
    return Report(
        found.table(),
        found.said(),
        shown=found.table(*columns),
        notes=notes,
        remarks=remarks_on_scene(scene),
    )


def _kinds(holds: np.ndarray) -> np.ndarray:
    """Return the crack's state in each mode, by how it is held (3, count) in each: (count,)."""
    return np.select([*(holds > 0.0)], HELD, "bilinear")


def _changes(at: At, low: float, high: float, mode: int) -> Iterator[tuple[float, str]]:
    """From which speeds on, between two of them, a crack does something else in a mode (from 0).

    Between held and breathing it changes where it is held by nothing more; from one held state to
    another by way of breathing, for however narrow a range of speeds.
    """
    before, after = (str(_kinds(at(speed)[1])[mode]) for speed in (low, high))
    held = {before, after} - {"bilinear"}
    if before != after and len(held) == 1:
        [which] = map(HELD.index, held)
        yield brentq(lambda speed: at(speed)[1][which, mode], low, high, rtol=CHANGE), after
    elif before != after and high - low <= CHANGE * high:
        yield high, after
    elif before != after:
        middle = 0.5 * (low + high)
        yield from _changes(at, low, middle, mode)
        yield from _changes(at, middle, high, mode)


def _in_words(speed: float) -> str:
    return f"{speed:.5g} rad/s = {speed / RPM:.5g} rpm"


def _at_resonance(force: np.ndarray, damped: Structure, modes: Modes) -> np.ndarray:
    """Amplitudes of modes at their own resonances, inf without damping: (n,); under a complex force
    on them (n,) [N], cosine less i times sine part, and with the damping of a whole structure."""
    size = np.abs(force @ modes.shapes)
    below = 2.0 * damping_ratios(damped, modes.omega) * modes.omega**2
    return np.divide(size, below, out=np.where(size > 0.0, np.inf, 0.0), where=below > 0.0)


def _frequencies(
    structure: Structure, peaks: Peaks, count: int, n_tied: int
) -> tuple[np.ndarray, np.ndarray]:
    """Natural frequencies of the states in which a crack may be held [rad/s], and by how much it is
    held at resonance under a load, > 0 where it is: (3, count) each, in the order of HELD.

    Those with the crack open are the lowest; the others have the same shapes, sought among the
    lowest ``n_tied``.
    """
    is_open = solve_modes(structure, count)
    none, every = np.zeros(structure.n_pairs, dtype=bool), np.ones(structure.n_pairs, dtype=bool)
    if not structure.n_pairs:
        return np.tile(is_open.omega, (3, 1)), np.outer([1.0, -1.0, -1.0], np.ones(count))
    clearance = np.broadcast_to(structure.clearance, structure.n_pairs)
    moved, pressed = static_state(structure, structure.force[0], clearance)
    shut = pressed > 0.0
    opening = np.where(shut, 0.0, clearance - structure.apply_bt(moved[None])[0])
    rest = np.where(np.array([none, every, shut]), pressed, opening)
    states = zip(rest, (none, every, shut), strict=True)
    found = [_held(is_open, peaks, own, tied, n_tied) for own, tied in states]
    omega, hold = (np.array(part) for part in zip(*found, strict=True))
    if shut.all() or not shut.any():
        hold[2] = -1.0  # not partly
    return omega, hold


def _held(
    is_open: Modes, peaks: Peaks, rest: np.ndarray, tied: np.ndarray, n_tied: int
) -> tuple[np.ndarray, np.ndarray]:
    """Natural frequencies with some pairs bonded, of the shapes of modes with the crack open
    [rad/s], and by how much less than their state at rest the resonance moves the pairs, the least
    of all [m, N]: (count,) each.

    Parameters
    ----------
    rest : (n_pairs,)
        Openings of open pairs [m], and forces of bonded ones [N].
    tied : (n_pairs,) of bool
        True for bonded pairs.
    """
    modes, structure = is_open, is_open.structure
    if tied.any():
        ties, loose = structure.gap[:, tied], np.zeros(int(tied.sum()))
        part = Structure(Body(structure.mass, structure.stiffness, ties, structure.force, loose))
        found = solve_modes(part, n_tied, lips="tied")
        own = find_bonded_mode_indices(is_open, found)
        modes = Modes(found.omega[own], found.shapes[:, own], structure)
    change = np.abs(structure.apply_bt(modes.shapes.T)).T
    if tied.any():
        stiff, heavy = (multiply(m, modes.shapes) for m in (structure.stiffness, structure.mass))
        left = ties.T @ (heavy * modes.omega**2 - stiff)
        change[tied] = np.abs(np.linalg.lstsq((ties.T @ ties).toarray(), left, rcond=None)[0])
    return modes.omega, (rest[:, None] - peaks(modes) * change).min(axis=0)
