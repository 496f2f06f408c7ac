"""Campbell diagrams: natural frequencies over a rotor's speed, and the engine orders they meet.

A blade is excited at multiples of the rotor's speed, w = n W with the engine order n. Resonances
are where such a line crosses a natural frequency. The frequency depends on the crack's state:

    breathing           near the bilinear frequency 2 w_o w_t / (w_o + w_t), between the frequencies
                        w_o with open and w_t with bonded crack (:mod:`fenics_crack.model.modes`)
    held open           w_o
    held shut           w_t
    held partly open    frequency with the pairs bonded that are pressed at rest

Rotation or the mean load holds a crack in a state if the resonance of this state cannot change it.
A mode phi with the frequency w and the damping ratio xi has the amplitude a = |phi . f| / (2 xi
w^2) at resonance under the load f. Two conditions must hold:

    open pairs          are open at rest by more than a |B^T phi|
    pressed pairs       are pressed at rest by more than a |lambda|, with the forces of the bonds
                        (K - w^2 M) phi + B lambda = 0
"""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property, partial
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from mpi4py import MPI
from scipy.optimize import brentq

from fenics_crack.basics.errors import InputError, check_choice, check_count
from fenics_crack.basics.suggestions import keep_old_attribute_names
from fenics_crack.basics.tables import (
    RAD_PER_S_PER_RPM,
    Conclusion,
    Report,
    add_frequency_entries,
    choose_speed_factor_name_unit,
    format_count,
    format_in_unit,
    hertz_property,
)
from fenics_crack.fem.build import with_crack_length
from fenics_crack.files.store import SavableResult, StoredFile
from fenics_crack.model.body import Body
from fenics_crack.model.matrices import floats_or_single_nan
from fenics_crack.model.modes import (
    FREQUENCY_KIND_NAMES,
    BilinearFrequencies,
    Modes,
    count_bonded_modes,
    find_bonded_mode_indices,
    multiply_columns,
    solve_modes,
)
from fenics_crack.model.rotation import (
    RitzProjection,
    RunUpStructure,
    relative_coriolis_shifts,
    static_displacement_and_forces,
)
from fenics_crack.model.structure import Structure
from fenics_crack.scene.scene import Scene
from fenics_crack.study.key_figures import list_modal_damping_ratios
from fenics_crack.study.plausibility import describe_coriolis, remarks_on_scene
from fenics_crack.study.prepare import scene_contact_law
from fenics_crack.study.resonance import (
    N_RESONANCE_SEARCH_MODES,
    UNSOUGHT_RESONANCE,
    ResonanceUnderLoad,
    find_load_resonance,
)
from fenics_crack.study.sharing import assemble_or_reuse_structure

FREQUENCY_KINDS_OF_HELD_CRACK = (*FREQUENCY_KIND_NAMES[:2], "partly")
"""Kinds of natural frequencies for a crack that rotation or mean load holds in a state: "open",
"tied" (held shut), "partly" (some pairs shut, the others open)."""
CRACK_STATE_BY_FREQUENCY_KIND = {
    **dict(
        zip(
            FREQUENCY_KINDS_OF_HELD_CRACK,
            ("held open", "held shut", "held partly open"),
            strict=True,
        )
    ),
    "bilinear": "breathing",
}
"""State of the crack in words, by kind of frequency ("open", "tied", "partly", "bilinear")."""
SPEED_SEARCH_RELATIVE_TOLERANCE = 1e-4
"""Relative tolerance of rotor speeds at which the crack's state changes, or an engine order meets a
mode."""
MAX_REPORTED_ENGINE_ORDER = 8
"""Highest engine order that a diagram shows, and that is reported for a load without engine
order."""
FrequenciesAndHoldMarginsFunction = Callable[[float], tuple[np.ndarray, np.ndarray]]
"""Function of a rotor speed [rad/s]. Returns natural frequencies [rad/s] and margins, (3, n_modes)
each: the rows are for a crack held open, shut and partly open. A positive margin says that rotation
or mean load holds the crack in this state, even if the mode is at resonance."""
PeakAmplitudeFunction = Callable[[Modes], np.ndarray]
"""Function of n modes. Returns each mode's modal amplitude at its resonance under a load: (n,)."""


@keep_old_attribute_names(
    at="frequencies_and_margins_at_speed",
    frequency_real="frequency_in_actual_state",
    omega_real="omega_in_actual_state",
    real_line="list_actual_state_line",
    between="interpolate_open_and_tied",
    meetings="yield_crossing_texts",
)
@dataclass(frozen=True, repr=False)
class Campbell(SavableResult):
    """Result of a Campbell diagram: natural frequencies over the rotor speed.

    "tied" stands for bonded crack faces.

    Attributes
    ----------
    scene : Scene
        Scene of the blade.
    speed : (n,) [rad/s]
        Rotor speeds W, rising.
    omega_open, omega_tied : (n, m) [rad/s]
        Frequencies of m modes with open crack, ascending at each speed; and with bonded crack for
        the same mode shapes. Both are the same without a crack.
    omega_partly : (n, m) [rad/s]
        Frequencies for the same mode shapes with a partly open crack: the contact pairs pressed at
        rest are bonded.
    cracked : bool
        True if there are crack faces.
    kind : (n, m) of "open", "tied", "partly" or "bilinear"
        Which frequency each mode has under the scene's load. The crack is held open ("open"), held
        shut ("tied"), or held with some pairs pressed and the others open ("partly"). A crack that
        is not held breathes ("bilinear").
    changes : tuple of (mode, speed, kind)
        Changes of the kind between two speeds: mode (from 1), speed [rad/s], and the kind from this
        speed on.
    coriolis : (m,)
        Relative changes of the open frequencies by the Coriolis force of a solid, at the fastest
        speed. All frequencies here leave the Coriolis force out.
    frequencies_and_margins_at_speed : function of a speed [rad/s], optional
        Returns frequencies [rad/s] and margins, (3, m) each, for the crack held open, shut and
        partly open (``FrequenciesAndHoldMarginsFunction``). None in a diagram from a file; the
        blade is then meshed again on demand.
    met : tuple of (mode, ResonanceUnderLoad)
        Mode (from 1) and resonance under the load, for each crossing of the load's engine order
        with a natural frequency.
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
    frequencies_and_margins_at_speed: FrequenciesAndHoldMarginsFunction | None = None
    met: tuple[tuple[int, ResonanceUnderLoad], ...] = ()

    KIND: ClassVar[str] = "Campbell diagram"
    frequency_open, frequency_tied = hertz_property("omega_open"), hertz_property("omega_tied")
    frequency_partly, frequency_in_actual_state = (
        hertz_property("omega_partly"),
        hertz_property("omega_in_actual_state"),
    )
    frequency_bilinear = hertz_property("omega_bilinear")

    @classmethod
    def from_stored_file(cls, stored_file: StoredFile) -> Campbell:
        """Read a diagram from an open result file.

        Another kind of result, or a changed mesh file of the scene, raises InputError.
        """
        diagram = super().from_stored_file(stored_file)
        stored_file.check_files(diagram.scene)
        return diagram

    @cached_property
    def _frequencies_and_hold_margins_function(self) -> FrequenciesAndHoldMarginsFunction:
        """Function from a rotor speed to frequencies and margins.

        The function is :attr:`frequencies_and_margins_at_speed`. If this is None (diagram from a
        file), the blade is meshed again to make it.
        """
        n_modes = self.omega_open.shape[1]
        return (
            self.frequencies_and_margins_at_speed
            or campbell(
                self.scene, self.speed, n_modes, MPI.COMM_SELF
            )._frequencies_and_hold_margins_function
        )

    @property
    def omega_bilinear(self) -> np.ndarray:
        """Bilinear frequencies 2 w_o w_t / (w_o + w_t): (n, m) [rad/s].

        w_o and w_t are the frequencies with open and bonded crack, ``omega_open`` and
        ``omega_tied``.
        """
        return BilinearFrequencies(self.omega_open, self.omega_tied).omega_bilinear

    @property
    def omega_in_actual_state(self) -> np.ndarray:
        """Natural frequencies in the crack's actual state: (n, m) [rad/s].

        ``kind`` names the state.
        """
        return self._select_omega(self.kind)

    def _select_omega(self, kinds: np.ndarray) -> np.ndarray:
        """Return the natural frequencies of given kinds: (n, m) [rad/s].

        ``kinds`` are "open", "tied", "partly" or "bilinear", as in ``kind``: (n, m) for n
        speeds and m modes, or (m,) for all speeds.
        """
        omega_of_kinds = [getattr(self, f"omega_{kind}") for kind in CRACK_STATE_BY_FREQUENCY_KIND]
        return np.select([kinds == kind for kind in CRACK_STATE_BY_FREQUENCY_KIND], omega_of_kinds)

    @property
    def kinds(self) -> tuple[str, ...]:
        """Kinds of frequencies in the diagram: "open", "tied", "bilinear", "partly".

        "partly" is missing if the crack is nowhere held partly open. Without a crack there is
        "open" alone.
        """
        kinds_present = {
            *self.kind.ravel().tolist(),
            *(state_change[-1] for state_change in self.changes),
        }
        all_kinds = (*FREQUENCY_KIND_NAMES, *kinds_present.intersection({"partly"}))
        return all_kinds if self.cracked else FREQUENCY_KIND_NAMES[:1]

    def crossings(self, order: int, kind: str = "bilinear") -> np.ndarray:
        """Find where an engine order's line w = n W meets natural frequencies w.

        A crossing is sought between two neighbouring speeds W if a mode changes its side of the
        line.

        Parameters
        ----------
        order : int
            Engine order n.
        kind : "open", "tied", "partly", "bilinear" or "real"
            Kind of the frequencies; "real" follows the crack's state at each speed. If a change of
            the state drops the frequency across the line, the change is a crossing.

        Returns
        -------
        (k, 2)
            Mode (from 1) and rotor speed [rad/s] of each crossing, sorted.

        Raises
        ------
        InputError
            An argument cannot be used.
        """
        check_count("order", order, 1)
        check_choice("kind", kind, (*CRACK_STATE_BY_FREQUENCY_KIND, "real"))
        if kind == "real":
            return self._crossings_in_actual_state(order)

        def omega_minus_order_line(speed: float, mode: int) -> float:
            """Return a mode's w - n W [rad/s], zero at a crossing."""
            return self._omega_in_crack_state(mode, speed, kind) - order * speed

        is_above = getattr(self, f"omega_{kind}") > order * self.speed[:, None]
        crossings = []
        for speed_index, mode_index in np.argwhere(is_above[1:] != is_above[:-1]).tolist():
            speed_interval = self.speed[speed_index : speed_index + 2].tolist()
            mode = mode_index + 1
            speed = brentq(
                omega_minus_order_line,
                *speed_interval,
                (mode,),
                rtol=SPEED_SEARCH_RELATIVE_TOLERANCE,
            )
            crossings.append((mode, speed))
        return np.array(sorted(crossings)).reshape(-1, 2)

    def _crossings_in_actual_state(self, order: int) -> np.ndarray:
        """Return an engine order's crossings with frequencies in the crack's actual state.

        If a change of the state drops the frequency across the order's line, this is a crossing,
        too.

        Returns
        -------
        (k, 2)
            Mode (from 1) and rotor speed [rad/s] of each crossing, sorted.
        """
        crossings = [
            (mode, speed)
            for kind in self.kinds
            for mode, speed in self.crossings(order, kind)
            if self._crack_state_kinds_around_speed(int(mode), speed)[1] == kind
        ]
        for mode, speed, _ in self.changes:
            omega_below_change_speed, omega_above_change_speed = (
                self._omega_in_crack_state(mode, speed, state_kind)
                for state_kind in self._crack_state_kinds_around_speed(mode, speed)
            )
            if omega_below_change_speed > order * speed > omega_above_change_speed:
                crossings.append((mode, speed))
        return np.array(sorted(crossings)).reshape(-1, 2)

    def _crack_state_kinds_around_speed(self, mode: int, speed: float) -> tuple[str, str]:
        """Return a mode's kinds of frequency just below and just above a rotor speed.

        ``mode`` counts from 1; ``speed`` is in rad/s. Kinds are "open", "tied", "partly",
        "bilinear".
        """
        diagram_speeds_and_kinds = zip(
            self.speed.tolist(), self.kind[:, mode - 1].tolist(), strict=True
        )
        change_speeds_and_kinds = [
            (start_speed, kind)
            for changed_mode, start_speed, kind in self.changes
            if changed_mode == mode
        ]
        start_speeds, kinds_from_start_speeds = zip(
            *sorted([*diagram_speeds_and_kinds, *change_speeds_and_kinds]), strict=True
        )
        kind_just_below_speed = kinds_from_start_speeds[
            max(bisect_left(start_speeds, speed) - 1, 0)
        ]
        return kind_just_below_speed, kinds_from_start_speeds[bisect_right(start_speeds, speed) - 1]

    def _omega_in_crack_state(self, mode: int, speed: float, kind: str) -> float:
        """Return a mode's natural frequency [rad/s] at a rotor speed.

        Modes count from 1; ``speed`` is in rad/s. ``kind`` is "open", "tied", "partly" or
        "bilinear".
        """
        omega_of_kinds = self._frequencies_and_hold_margins_function(speed)[0][:, mode - 1]
        if kind == "bilinear":
            return float(BilinearFrequencies(omega_of_kinds[0], omega_of_kinds[1]).omega_bilinear)
        return float(omega_of_kinds[FREQUENCY_KINDS_OF_HELD_CRACK.index(kind)])

    def list_actual_state_line(self, mode: int) -> list[tuple[float, float, str]]:
        """Return a mode's frequency over the speed, for the crack's actual state.

        Parameters
        ----------
        mode : int
            Number of the mode, from 1.

        Returns
        -------
        list of (speed, omega, kind)
            Points by rising speed: rotor speed [rad/s], natural frequency [rad/s] and kind (crack
            state). At a change of the state there are two points.
        """
        diagram_and_change_speeds = {
            *self.speed.tolist(),
            *(speed for changed_mode, speed, _ in self.changes if changed_mode == mode),
        }
        return [
            (speed, self._omega_in_crack_state(mode, speed, kind), kind)
            for speed in sorted(diagram_and_change_speeds)
            for kind in dict.fromkeys(self._crack_state_kinds_around_speed(mode, speed))
        ]

    def _list_crossings_with_resonances(
        self, order: int
    ) -> list[tuple[int, float, ResonanceUnderLoad]]:
        """Return each crossing of an engine order, with the resonance near it.

        Returns
        -------
        list of (mode, speed, resonance)
            Mode (from 1), estimated rotor speed [rad/s], and the resonance under the scene's load.
            If ``order`` is not the load's engine order, no resonance was sought
            (UNSOUGHT_RESONANCE).
        """
        load_engine_order = self.scene.excitation.order
        crossings = self.crossings(order, "real").tolist()
        resonances = [resonance for _, resonance in self.met] if order == load_engine_order else []
        resonances += [UNSOUGHT_RESONANCE] * len(crossings)
        return [
            (int(mode), speed, resonance)
            for (mode, speed), resonance in zip(crossings, resonances, strict=False)
        ]

    def yield_crossing_texts(self, order: int) -> Iterator[str]:
        """Yield a text for each crossing of an engine order.

        ``order`` is the engine order. A text names the mode, and the resonance under the load, if
        known. Then follow the speed of the crossing for the crack's actual state, and the speeds if
        the crack were in other states. Last comes the stiffening (:meth:`stiffening`).
        """
        for mode, speed, resonance in self._list_crossings_with_resonances(order):
            crossing_text = f"engine order {order} meets mode {mode} at "
            if math.isfinite(resonance.value):
                crossing_text += (
                    f"{_speed_in_words(resonance.value)} under the load, "
                    f"{resonance.amplitude_and_errors_text}; "
                    "estimated at "
                )
            crossing_text += _speed_in_words(speed)
            if self.cracked:
                kinds_at_crossing = [
                    *dict.fromkeys(self._crack_state_kinds_around_speed(mode, speed))
                ]
                other_state_texts = [
                    f"{_speed_in_words(other_state_speed)} with the crack "
                    f"{CRACK_STATE_BY_FREQUENCY_KIND[kind]}"
                    for kind in FREQUENCY_KIND_NAMES
                    if kind != kinds_at_crossing[-1] or len(kinds_at_crossing) > 1
                    for crossing_mode, other_state_speed in self.crossings(order, kind)
                    if crossing_mode == mode
                ]
                state_texts = [CRACK_STATE_BY_FREQUENCY_KIND[kind] for kind in kinds_at_crossing]
                crossing_text += f" with the crack {' before and '.join(state_texts)}"
                crossing_text += " after" if len(kinds_at_crossing) > 1 else ""
                crossing_text += " (bilinear estimate)" if "bilinear" in kinds_at_crossing else ""
                crossing_text += (
                    f"; the speed would be {', '.join(other_state_texts)}"
                    if other_state_texts
                    else ""
                )
            slope = self.stiffening(speed, order * speed)
            yield (
                f"{crossing_text}; at this speed 1 % more speed changes the frequency by "
                f"{slope:.2g} % (the value for tip_timing.stiffening)"
            )

    def stiffening(self, speed: float, omega: float) -> float:
        """Return d ln w / d ln W for the mode nearest to a frequency.

        w is the mode's natural frequency, W the rotor speed. The crack's state is that at the
        nearest speed in the diagram. w^2 is taken as linear in W^2 (Southwell), between two speeds
        in the diagram and beyond the diagram. :func:`find_passages` calls this method.

        Parameters
        ----------
        speed : float [rad/s]
            Rotor speed W.
        omega : float [rad/s]
            Frequency that selects the mode.
        """
        nearest_kind = self.kind[int(np.abs(self.speed - speed).argmin())]
        squares, squared_omega_slopes = self._interpolate_squares_and_slopes(
            speed, self._select_omega(nearest_kind)
        )
        mode_index = int(np.abs(np.sqrt(np.maximum(squares, 0.0)) - omega).argmin())
        return float(squared_omega_slopes[mode_index] * speed**2 / squares[mode_index])

    def interpolate_open_and_tied(self, speed: float) -> tuple[np.ndarray, np.ndarray]:
        """Interpolate the frequencies with open and bonded crack at a rotor speed.

        Squared frequencies are taken as linear in the squared speed, also beyond the fastest speed
        of the diagram.

        Parameters
        ----------
        speed : float [rad/s]
            Rotor speed.

        Returns
        -------
        omega_open, omega_tied : (m,) [rad/s]
            Frequencies of m modes with open and with bonded crack.
        """
        omega_open, omega_tied = (
            np.sqrt(np.maximum(self._interpolate_squares_and_slopes(speed, omega)[0], 0.0))
            for omega in (self.omega_open, self.omega_tied)
        )
        return omega_open, omega_tied

    def _interpolate_squares_and_slopes(
        self, speed: float, omega: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Interpolate squared frequencies w^2 linearly in W^2, at a rotor speed W.

        Parameters
        ----------
        speed : float [rad/s]
            W; beyond the diagram the nearest interval is extended.
        omega : (n, m) [rad/s]
            Frequencies of m modes at the n speeds of the diagram.

        Returns
        -------
        squares : (m,) [rad^2/s^2]
        slopes : (m,)
            d(w^2) / d(W^2).
        """
        squares, squared_speeds = omega**2, self.speed**2
        upper_index = int(np.clip(np.searchsorted(self.speed, speed), 1, len(squared_speeds) - 1))
        slopes = (squares[upper_index] - squares[upper_index - 1]) / (
            squared_speeds[upper_index] - squared_speeds[upper_index - 1]
        )
        return squares[upper_index] + slopes * (speed**2 - squared_speeds[upper_index]), slopes

    def to_dict(self) -> dict[str, Any]:
        """Return the diagram as lists by column name.

        Each speed and mode has a row. Columns are speed [rad/s], rpm, mode, the crack's state in
        words, and frequencies of each kind [rad/s] and [Hz].
        """
        n_speeds, n_modes = self.omega_open.shape
        repeated_speeds = np.repeat(self.speed, n_modes)
        values_by_column = {
            "speed": repeated_speeds.tolist(),
            "mode": np.tile(np.arange(1, n_modes + 1), n_speeds).tolist(),
        }
        if self.cracked:
            values_by_column["crack"] = [
                CRACK_STATE_BY_FREQUENCY_KIND[kind] for kind in self.kind.ravel()
            ]
        for kind in self.kinds:
            for column_name in (f"omega_{kind}", f"frequency_{kind}"):
                values_by_column[column_name] = getattr(self, column_name).ravel().tolist()
        return add_frequency_entries(values_by_column)

    def build_conclusion(self) -> Conclusion:
        """Build the closing sentence that the command prints.

        It states the speeds at which the load's engine order meets modes; without an engine order
        only the number of modes.
        """
        order = self.scene.excitation.order
        speed_factor_name_unit = choose_speed_factor_name_unit(self.scene.is_speed_in_rpm)
        modes_and_speed_range_text = (
            f"{format_count(self.omega_open.shape[1], 'mode')} found between "
            f"{format_in_unit(speed_factor_name_unit, self.speed[0], self.speed[-1])}"
        )
        if order is None:
            return Conclusion(modes_and_speed_range_text)
        crossing_texts = [
            f"mode {mode} at "
            + format_in_unit(
                speed_factor_name_unit, speed if resonance.unknown else resonance.value
            )
            for mode, speed, resonance in self._list_crossings_with_resonances(order)
        ]
        return Conclusion(
            modes_and_speed_range_text,
            f"engine order {order} meets {', '.join(crossing_texts) or 'none of these modes'}",
        )

    def _repr_text(self) -> str:
        speed_text = f"speed {self.speed[0]:.6g} to {self.speed[-1]:.6g} rad/s"
        first_mode_omegas = self.omega_bilinear[[0, -1], 0]
        frequency_text = f"first {first_mode_omegas[0]:.6g} to {first_mode_omegas[1]:.6g} rad/s"
        return f"{speed_text}, {format_count(self.omega_open.shape[1], 'mode')}, {frequency_text}"


def campbell(
    scene: Scene,
    speeds: Sequence[float] | np.ndarray,
    count: int | None = None,
    comm: MPI.Comm = MPI.COMM_WORLD,
    *,
    few: int = 4,
) -> Campbell:
    """Find a blade's natural frequencies at several rotor speeds (collective).

    The blade is meshed once.

    Parameters
    ----------
    scene : Scene
        Scene with a table ``[rotation]``; the table's own speed does not matter.
    speeds : (n,) [rad/s]
        Two or more speeds, rising from 0 or more.
    count : int, optional
        Number of modes, the lowest first. Default: ``few``, or all if there are fewer.
    comm : MPI.Comm
        Ranks that share the mesh.
    few : int
        Number of modes if ``count`` is not given.

    Returns
    -------
    Campbell
        Frequencies with open and bonded crack, and the crack's state, at each speed.

    Raises
    ------
    InputError
        An argument cannot be used, or a speed is too high.

    Examples
    --------
    >>> diagram = fc.campbell(blade, [0.0, 150.0, 300.0], count=2)
    """
    if scene.disk is not None:
        requirement_text = "left out here; fc.nodal_diameters gives frequencies of bladed disks"
        raise InputError("disk", "a table", requirement_text)
    scene.given("rotation")
    _, rotation_axis = scene.axis_point_and_direction
    check_count("count", few if count is None else count, 1)
    speed_array = np.atleast_1d(floats_or_single_nan(speeds))
    has_rising_speeds = (
        speed_array.ndim == 1 and len(speed_array) > 1 and bool(np.all(np.diff(speed_array) > 0.0))
    )
    if not (has_rising_speeds and speed_array[0] >= 0.0 and np.isfinite(speed_array[-1])):
        raise InputError("speeds", speeds, "two or more finite numbers >= 0 that increase [rad/s]")
    top_scene = with_crack_length(scene.replace({"rotation.speed": float(speed_array[-1])}), comm)
    top_structure = assemble_or_reuse_structure(top_scene, comm)
    max_modes = count_bonded_modes(top_structure)
    if count is not None and count > max_modes:
        raise InputError("count", count, f"a whole number from 1 to {max_modes}")
    count = min(few, max_modes) if count is None else count
    # The bonded mode with an open mode's shape may come later, if the bond moves it past others.
    n_bonded = min(count + 2, max_modes) if top_structure.n_pairs else 0
    start_speed, stop_speed = speed_array[[0, -1]]
    projection = RitzProjection.of_range(
        top_structure.damped(None), start_speed, stop_speed, count, n_bonded
    )
    complex_load = projection.force[1] - 1j * projection.force[2]
    peak_amplitude_function = partial(_find_modal_peak_amplitudes, complex_load, top_structure)

    @cache
    def find_frequencies_and_hold_margins(speed: float) -> tuple[np.ndarray, np.ndarray]:
        return _find_frequencies_and_hold_margins(
            projection.structure_at_speed(speed), peak_amplitude_function, count, n_bonded
        )

    omega_of_states, hold_margins = zip(
        *map(find_frequencies_and_hold_margins, speed_array.tolist()), strict=True
    )
    omega_open, omega_tied, omega_partly = np.moveaxis(omega_of_states, 1, 0)
    kind_changes = tuple(
        (mode_index + 1, speed, kind)
        for mode_index in range(count)
        for interval in pairwise(speed_array.tolist())
        for speed, kind in _yield_state_changes(
            find_frequencies_and_hold_margins, *interval, mode_index
        )
    )
    frequency_kinds = np.array(
        [
            _frequency_kinds_from_margins(hold_margins_at_speed)
            for hold_margins_at_speed in hold_margins
        ]
    )
    modes_in_ritz_coordinates = solve_modes(projection.structure_at_speed(speed_array[-1]), count)
    modes = Modes(
        modes_in_ritz_coordinates.omega,
        projection.basis @ modes_in_ritz_coordinates.shapes,
        top_structure,
    )
    relative_coriolis_changes = relative_coriolis_shifts(modes, speed_array[-1] * rotation_axis)
    diagram = Campbell(
        scene,
        speed_array,
        omega_open,
        omega_tied,
        omega_partly,
        top_structure.n_pairs > 0,
        frequency_kinds,
        kind_changes,
        relative_coriolis_changes,
        find_frequencies_and_hold_margins,
    )
    damped_projection = replace(projection, structure=top_structure)
    return replace(diagram, met=_find_modes_and_load_resonances(diagram, damped_projection))


def _find_modes_and_load_resonances(
    diagram: Campbell, projection: RitzProjection
) -> tuple[tuple[int, ResonanceUnderLoad], ...]:
    """Find the resonance at each crossing of the load's engine order.

    The resonance is that of the nonlinear structure under the load, with opening and closing crack.
    A crossing only estimates its speed.

    Parameters
    ----------
    diagram : Campbell
        Diagram with the crossings.
    projection : RitzProjection
        Gives the blade's structure in few coordinates at any speed.

    Returns
    -------
    tuple of (mode, ResonanceUnderLoad)
        Mode (from 1) and resonance, in the order of the crossings. Empty without an engine order or
        a contact law.
    """
    scene, engine_order = diagram.scene, diagram.scene.excitation.order
    law = scene_contact_law(scene, projection.structure)
    if engine_order is None or law is None:
        return ()
    search_projection = replace(
        projection, n_modes_with_mass=max(projection.n_modes_with_mass, N_RESONANCE_SEARCH_MODES)
    )

    return tuple(
        (
            int(mode_number),
            find_load_resonance(
                scene, law, partial(RunUpStructure, search_projection, speed), engine_order * speed
            ),
        )
        for mode_number, speed in diagram.crossings(engine_order, "real").tolist()
    )


def report_of_campbell(diagram: Campbell) -> Report:
    """Return a diagram's report: frequency table, and crossings of engine orders.

    Without an engine order of the load, orders 1 to 8 (:data:`MAX_REPORTED_ENGINE_ORDER`) are
    reported.
    """
    scene = diagram.scene
    load_engine_order = scene.excitation.order
    frequency_column_prefix = (
        "frequency" if scene.is_frequency_in_hertz or scene.is_speed_in_rpm else "omega"
    )
    orders = (
        [load_engine_order] if load_engine_order else [*range(1, MAX_REPORTED_ENGINE_ORDER + 1)]
    )
    notes = [
        crossing_text for order in orders for crossing_text in diagram.yield_crossing_texts(order)
    ]
    if not notes and load_engine_order is None:
        notes = [f"engine orders 1 to {MAX_REPORTED_ENGINE_ORDER} meet no mode at these speeds"]
    if coriolis_text := describe_coriolis(diagram.coriolis):
        speed_factor_name_unit = choose_speed_factor_name_unit(scene.is_speed_in_rpm)
        notes.append(
            f"at {format_in_unit(speed_factor_name_unit, diagram.speed[-1])} {coriolis_text}"
        )
    column_names = [
        "rpm" if scene.is_speed_in_rpm else "speed",
        "mode",
        *(f"{frequency_column_prefix}_{kind}" for kind in diagram.kinds),
        *(["crack"] if diagram.cracked else []),
    ]
    return Report(
        diagram.table(),
        diagram.build_conclusion(),
        printed_table=diagram.table(*column_names),
        notes=notes,
        remarks=remarks_on_scene(scene),
    )


def _frequency_kinds_from_margins(hold_margins: np.ndarray) -> np.ndarray:
    """Return each mode's kind of frequency: (n_modes,) of str.

    A positive margin holds the crack in a state. The first of the states "open", "tied" and
    "partly" with a positive margin is the kind. If there is none, the crack breathes: "bilinear".

    Parameters
    ----------
    hold_margins : (3, n_modes)
        Margins for the states "open", "tied" and "partly".
    """
    return np.select([*(hold_margins > 0.0)], FREQUENCY_KINDS_OF_HELD_CRACK, "bilinear")


def _yield_state_changes(
    find_frequencies_and_hold_margins: FrequenciesAndHoldMarginsFunction,
    lower_speed: float,
    upper_speed: float,
    mode_index: int,
) -> Iterator[tuple[float, str]]:
    """Yield each change of a crack's state between two rotor speeds.

    A crack is held open, shut or partly open, or breathes. Between a held and a breathing crack,
    the state changes where the margin of the held state is zero. If the crack is held at both ends,
    but in different states, the range is halved. This ends if a breathing crack is found, or if the
    range is shorter than :data:`SPEED_SEARCH_RELATIVE_TOLERANCE`.

    Parameters
    ----------
    find_frequencies_and_hold_margins : callable
        Returns frequencies and margins of three states at a speed
        (``FrequenciesAndHoldMarginsFunction``).
    lower_speed, upper_speed : float [rad/s]
        Ends of the range.
    mode_index : int
        Index of the mode, from 0.

    Yields
    ------
    speed, kind : float, str
        Speed [rad/s], and the kind of frequency from this speed on.
    """
    lower_kind, upper_kind = (
        str(_frequency_kinds_from_margins(find_frequencies_and_hold_margins(speed)[1])[mode_index])
        for speed in (lower_speed, upper_speed)
    )
    held_kinds_at_both_ends = {lower_kind, upper_kind} - {"bilinear"}
    if lower_kind != upper_kind and len(held_kinds_at_both_ends) == 1:
        [kind_index] = map(FREQUENCY_KINDS_OF_HELD_CRACK.index, held_kinds_at_both_ends)
        speed_of_state_change = brentq(
            lambda speed: find_frequencies_and_hold_margins(speed)[1][kind_index, mode_index],
            lower_speed, upper_speed, rtol=SPEED_SEARCH_RELATIVE_TOLERANCE,
        )  # fmt: skip
        yield speed_of_state_change, upper_kind
    elif (
        lower_kind != upper_kind
        and upper_speed - lower_speed <= SPEED_SEARCH_RELATIVE_TOLERANCE * upper_speed
    ):
        yield upper_speed, upper_kind
    elif lower_kind != upper_kind:
        middle_speed = 0.5 * (lower_speed + upper_speed)
        yield from _yield_state_changes(
            find_frequencies_and_hold_margins, lower_speed, middle_speed, mode_index
        )
        yield from _yield_state_changes(
            find_frequencies_and_hold_margins, middle_speed, upper_speed, mode_index
        )


def _speed_in_words(speed: float) -> str:
    """Return a rotor speed [rad/s] as text: "104.72 rad/s = 1000 rpm"."""
    return f"{speed:.5g} rad/s = {speed / RAD_PER_S_PER_RPM:.5g} rpm"


def _find_modal_peak_amplitudes(
    complex_load: np.ndarray, damped_structure: Structure, modes: Modes
) -> np.ndarray:
    """Return modal amplitudes at the modes' own resonances: (n_modes,).

    Used to decide if vibration at resonance overcomes the force that holds a crack open or shut.
    The amplitude is |phi . f| / (2 xi w^2), with the mode shape phi, the damping ratio xi, the
    frequency w and the load f. It is inf without damping, and 0 without a modal force.

    Parameters
    ----------
    complex_load : (n,) complex [N]
        f = cosine part - i sine part of the load, in the n coordinates of the modes.
    damped_structure : Structure
        Whole structure whose damping gives xi.
    modes : Modes
        Modes, normalised by mass.
    """
    modal_forces = np.abs(complex_load @ modes.shapes)
    denominators = 2.0 * list_modal_damping_ratios(damped_structure, modes.omega) * modes.omega**2
    return np.divide(
        modal_forces,
        denominators,
        out=np.where(modal_forces > 0.0, np.inf, 0.0),
        where=denominators > 0.0,
    )


def _find_frequencies_and_hold_margins(
    structure: Structure,
    peak_amplitude_function: PeakAmplitudeFunction,
    n_modes: int,
    n_bonded_modes: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Find natural frequencies and margins for three states of the crack.

    The states are: crack open; crack shut (all pairs bonded); and partly open (pairs pressed at
    rest are bonded). A margin says by how much rotation or mean load holds the crack in a state. If
    it is negative, vibration at resonance opens or closes a pair.

    Parameters
    ----------
    structure : Structure
        Structure at a rotor speed.
    peak_amplitude_function : callable
        Returns the modal amplitudes at resonance (:data:`PeakAmplitudeFunction`).
    n_modes : int
        Number of lowest modes with open crack. In the other states, the frequencies of the most
        similar mode shapes are taken.
    n_bonded_modes : int
        Number of lowest modes of the other states, among which the similar shapes are sought.

    Returns
    -------
    omega : (3, n_modes) [rad/s]
        Frequencies of the states open, shut, partly open.
    hold_margins : (3, n_modes)
        Margin of each state at resonance: the smallest over all pairs. For an open pair it is the
        opening at rest less the amplitude [m]. For a bonded pair it is the force at rest less the
        amplitude [N].
    """
    open_modes = solve_modes(structure, n_modes)
    if not structure.n_pairs:
        return np.tile(open_modes.omega, (3, 1)), np.outer([1.0, -1.0, -1.0], np.ones(n_modes))
    clearance = np.broadcast_to(structure.clearance, structure.n_pairs)
    static_displacement, pair_forces = static_displacement_and_forces(
        structure, structure.force[0], clearance
    )
    is_pressed = pair_forces > 0.0
    pair_openings_at_rest = np.where(
        is_pressed, 0.0, clearance - structure.apply_bt(static_displacement[None])[0]
    )
    bonded_masks = np.array([np.zeros_like(is_pressed), np.ones_like(is_pressed), is_pressed])
    rest_forces_or_openings_of_states = np.where(bonded_masks, pair_forces, pair_openings_at_rest)
    frequencies_and_margins = [
        _find_held_frequencies_and_margins(
            open_modes, peak_amplitude_function, rest_forces_or_openings, is_bonded, n_bonded_modes
        )
        for rest_forces_or_openings, is_bonded in zip(
            rest_forces_or_openings_of_states, bonded_masks, strict=True
        )
    ]
    omega_of_states, hold_margins = np.moveaxis(frequencies_and_margins, 1, 0)
    if is_pressed.all() or not is_pressed.any():
        hold_margins[2] = -1.0  # not partly
    return omega_of_states, hold_margins


def _find_held_frequencies_and_margins(
    open_modes: Modes,
    peak_amplitude_function: PeakAmplitudeFunction,
    rest_forces_or_openings: np.ndarray,
    is_bonded: np.ndarray,
    n_bonded_modes: int,
) -> tuple[np.ndarray, np.ndarray]:
    """Find natural frequencies with bonded pairs, and the margins that keep this state.

    Parameters
    ----------
    open_modes : Modes
        Modes with open crack. For each, the mode with bonded pairs and the most similar shape is
        taken.
    peak_amplitude_function : callable
        Returns the modal amplitudes at resonance (:data:`PeakAmplitudeFunction`).
    rest_forces_or_openings : (n_pairs,) [m], [N]
        For an open pair the opening at rest [m], for a bonded pair the force at rest [N].
    is_bonded : (n_pairs,) of bool
        True for bonded pairs.
    n_bonded_modes : int
        Number of lowest modes with bonded pairs, among which the similar shapes are sought.

    Returns
    -------
    omega : (n_modes,) [rad/s]
        Natural frequencies.
    hold_margins : (n_modes,) [m], [N]
        Smallest margin over the pairs: opening or force at rest, less the amplitude at resonance.
    """
    modes, structure = open_modes, open_modes.structure
    bonded_gap_rows = structure.gap[:, is_bonded]
    bond_force_amplitudes = np.zeros((0, len(open_modes.omega)))
    if is_bonded.any():
        body_with_bonded_gaps_only = Body(
            structure.mass,
            structure.stiffness,
            bonded_gap_rows,
            structure.force,
            np.zeros(bonded_gap_rows.shape[1]),
        )
        bonded_structure = Structure(body_with_bonded_gaps_only)
        bonded_modes = solve_modes(bonded_structure, n_bonded_modes, lips="tied")
        bonded_mode_indices = find_bonded_mode_indices(open_modes, bonded_modes)
        modes = Modes(
            bonded_modes.omega[bonded_mode_indices],
            bonded_modes.shapes[:, bonded_mode_indices],
            structure,
        )
        stiffness_products, mass_products = (
            multiply_columns(stiffness_or_mass, modes.shapes)
            for stiffness_or_mass in (structure.stiffness, structure.mass)
        )
        unbalanced_forces = bonded_gap_rows.T @ (
            mass_products * modes.omega**2 - stiffness_products
        )
        bond_force_amplitudes = np.abs(np.linalg.lstsq(
            (bonded_gap_rows.T @ bonded_gap_rows).toarray(), unbalanced_forces, rcond=None
        )[0])  # fmt: skip
    gap_or_bond_force_of_unit_modes = np.abs(structure.apply_bt(modes.shapes.T)).T
    gap_or_bond_force_of_unit_modes[is_bonded] = bond_force_amplitudes
    return modes.omega, (
        rest_forces_or_openings[:, None]
        - peak_amplitude_function(modes) * gap_or_bond_force_of_unit_modes
    ).min(axis=0)
