"""Tables of a scene for results, such as a curve or a sweep."""

from __future__ import annotations

import itertools
import math
import re
from collections import Counter
from dataclasses import MISSING, dataclass
from typing import Any

import numpy as np

from fenics_crack.basics.errors import InputError
from fenics_crack.basics.observables import OBSERVABLES_BY_NAME
from fenics_crack.basics.tables import RAD_PER_S_PER_RPM, RAD_PER_TURN
from fenics_crack.scene.fields import (
    ALLOWED_MAGNITUDES_TEXT,
    Axis,
    MeshFile,
    OutputPoint,
    Rule,
    Table,
    any_type_field,
    bounded_field,
    choice_field,
    nonnegative_field,
    number_field,
    path_field,
    positive_field,
    positive_int_field,
)
from fenics_crack.scene.tables import Crack

MAX_NAMED_OUTPUT_POINTS = 100
"""Maximum number of points in ``[output.points]``: each is computed, printed and written."""
MIN_GRID_VALUES_PER_UNKNOWN = 4
"""Minimum number of values for an unknown in [identify], for interpolation between them."""


@dataclass(frozen=True)
class Curve(Table):
    """Settings for a response curve, followed through folds by continuation."""

    start: float = number_field()
    """First value of the parameter, in the units of ``stop``."""
    stop: float = number_field()
    """Last value of the parameter.

    Units are rad/s for the load frequency, or Hz with "frequency". Load, stiffness, damping and
    friction are factors, clearances are added [m]. With an engine order: rotor speed [rad/s], or
    "rpm".
    """
    parameter: str = choice_field(
        "omega", "frequency", "load", "stiffness", "damping", "clearance", "friction", "speed",
        "rpm", default="omega",
    )  # fmt: skip
    """Parameter that changes along the curve."""
    at: str | None = choice_field("resonance", default=None)
    """With ``parameter = "load"``: follow the resonance while the load grows.

    The curve is the backbone of a forced and damped vibration, from the resonance near the load
    frequency. The load factor leaves the mean load unchanged. In a bladed disk the watched blade is
    at resonance.
    """
    stability: bool = any_type_field("true or false", default=True)
    """Compute Floquet multipliers and period doublings along the curve."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.require(
            self.start != self.stop, "stop", f"different from curve.start = {self.start:g}"
        )
        if self.at is not None:
            self.require(self.parameter == "load", "at", "left out unless curve.parameter = 'load'")
        names_of_positive_parameters = "omega", "frequency", "stiffness", "friction", "speed", "rpm"
        if self.parameter in names_of_positive_parameters or self.at is not None:
            # Rounding would take a smaller end to 0.
            lower_bound = max(1e-12 * max(self.start, self.stop), 0.0)
            for end_key in ("start", "stop"):
                end_value = getattr(self, end_key)
                bound_text = ", and above 1e-12 of the other end" if end_value > 0.0 else ""
                self.require(
                    end_value > lower_bound,
                    end_key,
                    f"a number > 0 with curve.parameter = {self.parameter!r}{bound_text}",
                )

    @property
    def parameter_and_range(self) -> tuple[str, float, float]:
        """Curve parameter's name in the equations, start and stop of its range.

        The parameter "frequency" becomes "omega", and "rpm" becomes "speed", with start and stop in
        rad/s. If ``at`` is "resonance", the curve follows the resonance over the load. The name is
        then "resonance", and start and stop are factors on the load.
        """
        if self.parameter == "rpm":
            return "speed", RAD_PER_S_PER_RPM * self.start, RAD_PER_S_PER_RPM * self.stop
        if self.parameter == "frequency":
            return "omega", RAD_PER_TURN * self.start, RAD_PER_TURN * self.stop
        return self.at or self.parameter, self.start, self.stop


@dataclass(frozen=True)
class Integration(Table):
    """Settings for direct integration in time, under the load or as a free decay.

    Integration starts at rest, at the end of an earlier motion, or at a static deflection.
    """

    _KEY_RULES = (Rule("integration.initial", ("deflection",)),)

    method: str | None = choice_field("exponential", "central_difference", "events", default=None)
    """Method: "exponential" or "central_difference" with time steps, or "events".

    "events" is exact from one switching instant to the next. Default: "exponential" for crack faces
    without mass, otherwise "central_difference".
    """
    periods: int = positive_int_field(600)
    """Maximum number of load periods to integrate."""
    settle: float = positive_field(1e-4)
    """Relative change from one period to the next at which integration stops.

    The change is that of the gaps and of the displacement at the load, relative to the motion.
    Results state the remaining distance from the settled motion. This distance matters most for
    the mean and the higher harmonics, mostly below a thousandth of the first harmonic.
    """
    steps_per_period: int | None = positive_int_field(None)
    """Number of time steps, or of stored instants, in a load period.

    Default: 512 for "exponential", 256 for "events". For "central_difference" 512, or twice the
    smallest stable number if larger.
    """
    initial: str | None = path_field("the path of the .h5 file of a solution or an integration")
    """File with a solution or an integration on the same mesh, as the start.

    From a solution come displacement and velocity at phase 0 of the load, from an integration the
    final displacement and velocity. The scene's load acts.
    """
    deflection: float | None = positive_field(None)
    """Start at rest from the static deflection, with contact.

    The static load is the mean plus the sum of cosine and sine parts times this factor.
    """
    free: bool = any_type_field("true or false", default=False)
    """Free decay: only the mean load acts. All periods are recorded."""


@dataclass(frozen=True)
class Sweep(Table):
    """Settings for a sweep: all combinations of values for some keys of the scene.

    For example::

        [sweep.over]
        "excitation.omega" = { start = 1000.0, stop = 4000.0, count = 61 }
        "crack.length" = [0.02, 0.03, 0.04]
    """

    over: tuple[Axis, ...] = any_type_field(
        "a table with keys of the scene and lists of values, 'crack.length' = [0.02, 0.03]",
        lambda value: value,
    )
    """Keys with lists of values, or start, stop, count and ``spacing = "logarithmic"``."""
    at_resonance: bool = any_type_field("true or false", default=False)
    """Solve each case at the resonance nearest to the excitation's frequency."""

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values on each sweep axis."""
        return tuple(len(axis.values) for axis in self.over)

    @property
    def n_cases(self) -> int:
        """Number of cases."""
        return math.prod(self.shape)


@dataclass(frozen=True)
class Growth(Table):
    """Settings for crack growth by fatigue, for the command ``fenics-crack grow``.

    In a cycle of the load, the crack grows by

        rate sum_i (delta_K_i / ((1 - R_i)^(1 - ratio_exponent) 1 MPa m^0.5))^exponent.

    The sum is over the cycles i of K_I in the load cycle. Cycle i has the range delta_K_i and the
    ratio R_i = max(K_min, 0) / K_max. A range counts only K_I > 0, since a tip with negative K_I is
    closed (Paris and Erdogan 1963; Walker 1970).
    """

    _KEY_RULES = (
        Rule("growth.drive = 'frequency'", ("frequencies", "cycles")),
        Rule("growth.drive = 'resonance'", ("frequencies", "cycles")),
    )

    until: float = positive_field(unit="m")
    """Length at which growth ends, from ``crack.length`` on.

    For a half-ellipse the depth, from ``crack.depth`` on.
    """
    rate: float = positive_field(unit="m")
    """Growth in a load cycle with one K_I range delta_K = 1 MPa m^0.5 and R = 0."""
    exponent: float = bounded_field("0.1", "50", MISSING)
    """Exponent of the growth law."""
    ratio_exponent: float = bounded_field("0", "1", 1.0)
    """Walker's exponent gamma for the influence of R; 1: no influence except by closure."""
    threshold: float = nonnegative_field(0.0, unit="Pa m^0.5")
    """Effective range of K_I, delta_K / (1 - R)^(1 - gamma), below which the crack stops."""
    toughness: float | None = positive_field(None, unit="Pa m^0.5")
    """Fracture toughness: K_max at which the structure breaks; left out: no limit."""
    drive: str = choice_field("frequency", "resonance", "spectrum", default="frequency")
    """"frequency": the load keeps the excitation's frequency.

    "resonance": the load follows the largest response. "spectrum": the load passes through the
    ``frequencies`` again and again.
    """
    frequencies: tuple[float, ...] | None = any_type_field(
        "a list of different numbers > 0",
        lambda frequencies: (
            len(set(frequencies)) == len(frequencies) > 0 and min(frequencies) > 0.0
        ),
        None,
        unit="Hz",
    )
    """Load frequencies of the spectrum [Hz], with ``drive = "spectrum"``."""
    cycles: tuple[float, ...] | None = any_type_field(
        "a list of numbers > 0", lambda cycles: len(cycles) > 0 and min(cycles) > 0.0, None
    )
    """Number of load cycles at each frequency, in one repeat of the spectrum."""
    rate_deviation: float = bounded_field("0", "10", 0.0)
    """Relative standard deviation of ``rate``, for the scatter of the life."""
    exponent_deviation: float = bounded_field("0", "10", 0.0)
    """Standard deviation of ``exponent``; the rate at 1 MPa m^0.5 stays the same."""
    life_tolerance: float = bounded_field("1e-6", "1", 0.01)
    """Relative error of the life that interpolation between solved crack lengths may cause."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.drive != "spectrum":
            return
        for spectrum_key in ("frequencies", "cycles"):
            allowed_text = self.field_by_key()[spectrum_key].metadata["allowed"]
            self.given(spectrum_key, f"given: {allowed_text}, with drive = 'spectrum'")
        self.require(
            len(self.cycles or ()) == len(self.frequencies or ()),
            "cycles",
            f"as many numbers as growth.frequencies, {len(self.frequencies or ())}",
        )

    @property
    def repeat_cycles_and_duration(self) -> tuple[float, float] | None:
        """Number of load cycles in one pass through the load spectrum, and the duration [s].

        The spectrum is the list ``frequencies`` with the number of ``cycles`` at each. None if one
        of the keys is missing: only ``drive = "spectrum"`` has both.
        """
        if self.cycles is None or self.frequencies is None:
            return None
        repeat_duration = sum(
            n_cycles_at_frequency / frequency
            for n_cycles_at_frequency, frequency in zip(self.cycles, self.frequencies, strict=True)
        )
        return sum(self.cycles), repeat_duration


@dataclass(frozen=True)
class Identify(Table):
    """Settings for identification: unknowns, their ranges, and uncertainties of the model.

    The keys ``..._deviation`` are standard deviations of what the model does not know.

    For example::

        [identify.unknown]
        "crack.length" = { start = 0.003, stop = 0.045, count = 8 }
        "crack.height" = { start = 0.02, stop = 0.2, count = 10 }

    or, with meshes of the user::

        [identify.meshes]
        "blade_05.msh" = { "crack.length" = 0.005 }
        "blade_10.msh" = { "crack.length" = 0.010 }
        "blade_15.msh" = { "crack.length" = 0.015 }
        "blade_20.msh" = { "crack.length" = 0.020 }
    """

    unknown: tuple[Axis, ...] = any_type_field(
        "a table with keys of the scene and the values between which these are sought", default=()
    )
    """Unknown keys, each with at least 4 ascending numbers at which the model is solved.

    Instead of numbers: start, stop, count and ``spacing = "logarithmic"``, or words,
    ``"crack.edge" = ["left", "right"]``. May be left out with ``meshes``.
    """
    meshes: tuple[MeshFile, ...] = any_type_field(
        'a table of .msh files and their numbers, "blade_05.msh" = { "crack.length" = 0.005 }',
        default=(),
    )
    """Meshes of the cracked structure, with the unknowns of each, for ``mesh.layout = "file"``.

    The names are keys of the crack, or free names for other unknowns. Each name has at least 4
    values, and every combination of values has a mesh.
    """
    uncracked: str | None = path_field("the path of a .msh file")
    """Mesh of the same structure without the crack, if meshes are read from files."""
    frequencies: tuple[float, ...] = any_type_field(
        "a list of finite numbers > 0", lambda values: min(values, default=1.0) > 0, ()
    )
    """Load frequencies [Hz], besides the excitation's, for which measurements are planned."""
    finer: float = bounded_field("0.25", "4", 0.5)
    """Ratio of element lengths between the few fine cases and all other cases.

    Fine cases correct the model and give its error; 1: no fine cases. Below 1, fine cases have the
    scene's mesh and harmonics, and other cases coarser ones: 0.5 doubles the element length.
    """
    harmonic_deviation: float = bounded_field("0", "1", 0.05)
    """Minimum relative standard deviation of the computed second harmonic due to the crack.

    For the k-th harmonic it is k - 1 times as large. The cause is contact on a coarse mesh, which
    changes harmonics separately and all together.
    """
    young_deviation: float = bounded_field("0", "1", 0.03)
    """Relative standard deviation of Young's modulus.

    Structural steel: JCSS, Probabilistic Model Code, part 3.2, 2001.
    """
    density_deviation: float = bounded_field("0", "1", 0.01)
    """Relative standard deviation of the density (JCSS, Probabilistic Model Code, part 2.1)."""
    thickness_deviation: float = bounded_field("0", "1", 0.01)
    """Relative standard deviation of the thickness, which changes amplitudes.

    Tolerances are at most 0.2 mm in 10 mm (ISO 2768-1, medium).
    """
    clamp_deviation: float = bounded_field("0", "1", 0.01)
    """Standard deviation of the relative decrease of the first frequency by a soft clamp.

    A beam on an elastic body of the same thickness acts as if longer by 0.44 times the depth (W. J.
    O'Donnell, Journal of Applied Mechanics 27, 1960, 461). At a length of 15 depths the frequency
    is 6 % lower; jaws are several times stiffer.
    """
    before_deviation: float = bounded_field("0", "1", 0.002)
    """Standard deviation of the clamp's change between measurements without and with the crack.

    It is relative to the first natural frequency. A clamp that was opened holds differently; on a
    rotor the blade's seat or the measured speed changes. Temperatures have separate keys.
    """
    before_scatter: float = bounded_field("0", "1", 0.2)
    """Part of the clamp's change (``before_deviation``) that each mode has by itself.

    Evidence: in plates clamped deeper, partly released or on an elastic block, a turning clamp, a
    moving clamp and a common change explain all but this part of the largest change. The part is up
    to 0.05 for plates 15 times as tall as wide, 0.07 for five times, 0.12 for three, 0.18 for two
    and 0.29 for squares (benchmarks/identification_limits.py in commit 981867df).
    """
    temperature_deviation: float | None = any_type_field(
        "a number from 0 to 1000", lambda value: 0.0 <= value <= 1000.0, None, unit="K"
    )
    """Standard deviation of the temperature difference since the measurement without a crack.

    It counts if measurements do not state temperatures; 0: equal temperatures. Default at rest:
    10 K, which takes 0.2 % from all natural frequencies. Default for a rotor: 25 K, since gas or
    drag warms blades (engineering judgement).
    """
    temperature_coefficient: float = bounded_field("-0.01", "0.01", -4e-4, unit="1/K")
    """Relative change of Young's modulus per kelvin.

    Steel -2.6e-4 to -3e-4, aluminium and titanium -5e-4 to -6e-4 at room temperature; more if hot.
    """
    coefficient_deviation: float = bounded_field("0", "1", 0.3)
    """Relative standard deviation of ``temperature_coefficient``.

    It counts if measurements state temperatures; 0.1 for a metal with a known coefficient.
    """
    thermometer_deviation: float = bounded_field("0", "100", 1.0, unit="K")
    """Standard deviation of a stated temperature difference between the measurements.

    For a thermocouple of class 1 (IEC 60584-1: 1.5 K) at the blade or its root.
    """
    damping_deviation: float = bounded_field("0", "10", 0.3)
    """Relative standard deviation of the damping ratio.

    Joints and air change damping so much between assemblies.
    """
    stiffening_deviation: float = bounded_field("0", "1", 0.05)
    """Relative standard deviation of the part of omega^2 that rotation adds.

    Beam and plate models differ by so much.
    """
    angle_deviation: float = bounded_field("0", "45", 5.0, unit="degrees")
    """Standard deviation of the angle between crack and horizontal.

    The angle moves the tip away from the height of the mouth.
    """
    model_deviation: float = bounded_field("0", "1", 0.01)
    """Relative standard deviation of each natural frequency, equal with and without the crack.

    Spacecraft models shall meet measured frequencies to 5 % (NASA-STD-5002). The ratio of the first
    two frequencies of a plain beam is 2 % off (docs/notebook/measured_beams.md).
    """
    first_resonance_deviation: float = bounded_field("0", "1", 0.04)
    """Standard deviation of the first resonance around the bilinear frequency.

    The crack breathes. The deviation is relative to the difference between bonded and open natural
    frequency (docs/identification.md).
    """
    resonance_deviation: float = bounded_field("0", "1", 0.3)
    """Standard deviation of higher resonances around the bilinear frequency.

    It is relative as ``first_resonance_deviation``. Neighbouring modes also open and close the
    crack, which may be open for any part of the period: 12^-1/2 for a uniform distribution.
    """
    crack_deviation: float = bounded_field("0", "1", 0.15)
    """Relative standard deviation of a crack's computed effect on natural frequencies.

    Two common compliances for one crack, from 0.1 to 0.3 of the depth, differ by 25 to 29 %; half
    is taken (W. M. Ostachowicz and M. Krawczuk, Journal of Sound and Vibration 150, 1991, 191; P.
    F. Rizos, N. Aspragathos and A. D. Dimarogonas, 138, 1990, 381). A slot changes more than a
    crack (P. Cawley and R. Ray, Journal of Vibration and Acoustics 110, 1988, 366).
    """
    crack_correlation: float = bounded_field("0", "1", 0.9)
    """Correlation between modes of the errors with ``crack_deviation``.

    1: the crack's compliance has one error, common to all modes.
    """
    confidence: float = bounded_field("0.5", "0.9999", 0.95)
    """Probability that reported regions and intervals contain the true values.

    A hypothesis explains the measurements if the p-value of chi^2 is at least 1 - ``confidence``.
    """
    log_bayes_factor: float = bounded_field("0", "1000", 3.0)
    """Natural logarithm of the evidence ratio above which a hypothesis is preferred.

    3 is a ratio of 20 to 1.
    """

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.unknown and not self.meshes:
            allowed_text = self.field_by_key()["unknown"].metadata["allowed"]
            raise InputError("identify.unknown", None, f"given: {allowed_text}")
        self._check_meshes_form_full_grid()
        for axis in self.unknown:
            word_flags = [isinstance(value, str) for value in axis.values]
            has_enough_numbers = (
                not any(word_flags) and len(axis.values) >= MIN_GRID_VALUES_PER_UNKNOWN
            )
            if not (all(word_flags) or (has_enough_numbers and np.all(np.diff(axis.values) > 0))):
                raise InputError(
                    f'identify.unknown."{axis.key}"',
                    axis.values,
                    f"words, or {MIN_GRID_VALUES_PER_UNKNOWN} or more numbers in ascending order",
                )

    def _check_meshes_form_full_grid(self) -> None:
        """Raise InputError if ``meshes`` is not a full grid of parameter values.

        All meshes have the same parameters, each with 4 or more values. Each combination of values
        has exactly one mesh.
        """
        allowed_crack_keys = {
            Crack.full_key(key_in_crack_table)
            for key_in_crack_table, key_field in Crack.field_by_key().items()
            if key_field.metadata["unit"] == "m"
        } - {axis.key for axis in self.unknown}
        for mesh_file_entry in self.meshes:
            error_key = f'identify.meshes."{mesh_file_entry.key}"'
            parameter_names = list(mesh_file_entry.parameter_value_by_name)
            if {*parameter_names} != {
                *self.meshes[0].parameter_value_by_name
            } or not parameter_names:
                raise InputError(
                    error_key, parameter_names, "one or more names, the same for all meshes"
                )
            for parameter_name in parameter_names:
                if not (parameter_name in allowed_crack_keys or parameter_name.isidentifier()):
                    names_text = ", ".join(sorted(allowed_crack_keys))
                    raise InputError(
                        error_key, parameter_name, f"a single word, or one of {names_text}"
                    )
        axes = self.mesh_parameter_axes
        for axis in axes:
            if len(axis.values) < MIN_GRID_VALUES_PER_UNKNOWN:
                raise InputError(
                    f"identify.meshes, {axis.key}",
                    axis.values,
                    f"at least {MIN_GRID_VALUES_PER_UNKNOWN} different values",
                )
        n_meshes_by_combination = Counter(
            tuple(mesh_file_entry.parameter_value_by_name[axis.key] for axis in axes)
            for mesh_file_entry in self.meshes
        )
        mesh_parameter_combinations = itertools.product(*(axis.values for axis in axes))
        for mesh_parameter_combination in (
            mesh_parameter_combinations if n_meshes_by_combination else ()
        ):
            if (
                n_meshes_of_combination := n_meshes_by_combination[mesh_parameter_combination]
            ) != 1:
                combination_text = ", ".join(
                    f"{axis.key} = {parameter_value:g}"
                    for axis, parameter_value in zip(axes, mesh_parameter_combination, strict=True)
                )
                raise InputError(
                    "identify.meshes",
                    f"{n_meshes_of_combination or 'no'} files of {combination_text}",
                    "a table with one mesh file for every combination of the numbers",
                )

    @property
    def mesh_parameter_axes(self) -> tuple[Axis, ...]:
        """Parameters of ``meshes``, each with its sorted values; empty without meshes."""
        parameter_names = self.meshes[0].parameter_value_by_name if self.meshes else ()
        return tuple(
            Axis(
                name,
                tuple(
                    sorted(
                        {
                            mesh_file_entry.parameter_value_by_name[name]
                            for mesh_file_entry in self.meshes
                        }
                    )
                ),
            )
            for name in parameter_names
        )

    @property
    def mesh_files(self) -> tuple[str, ...]:
        """Paths of all mesh files in ``meshes``, ordered by parameter values.

        The parameters are in the order of :attr:`mesh_parameter_axes`; the last parameter varies
        fastest.
        """
        mesh_parameter_axes = self.mesh_parameter_axes
        mesh_files_by_parameter_values = sorted(
            self.meshes,
            key=lambda mesh_file_entry: [
                mesh_file_entry.parameter_value_by_name[axis.key] for axis in mesh_parameter_axes
            ],
        )
        return tuple(ordered_mesh_file.key for ordered_mesh_file in mesh_files_by_parameter_values)

    @property
    def inference_setting_by_key(self) -> dict[str, Any]:
        """Settings for inference by key: standard deviations and confidence.

        Keys with an effect on the solved cases are left out, for example the unknowns.
        """
        forward_model_keys = {"unknown", "meshes", "uncracked", "frequencies", "finer"}
        return {
            key: getattr(self, key) for key in self.field_by_key() if key not in forward_model_keys
        }


@dataclass(frozen=True)
class TipTiming(Table):
    """Settings for blade tip timing: probes in the casing, and the fit to tip arrivals.

    [tip_timing]
    probes = [0.0, 17.0, 41.0, 58.0, 86.0, 113.0, 140.0, 178.0, 205.0, 251.0, 288.0, 330.0]
    tip_radius = 0.45
    """

    _KEY_RULES = (
        Rule("tip_timing.frequencies", ("subharmonic",), allowed_choices=(1,)),
        Rule("tip_timing.frequencies", ("orders",)),
    )

    probes: tuple[float, ...] = any_type_field(
        "a list of rising angles in degrees, from 0 to less than 360",
        lambda angles: (
            angles and 0.0 <= angles[0] and angles[-1] < 360.0 and bool(np.all(np.diff(angles) > 0))
        ),
    )
    """Probe angles [degrees] in the direction of rotation.

    An angle is 0 at the tip's position when the shaft's once-per-revolution mark passes its sensor.
    """
    tip_radius: float = positive_field(unit="m")
    """Distance between tip and rotor axis."""
    tangential: float | None = any_type_field(
        f"a finite number other than 0 (of magnitude {ALLOWED_MAGNITUDES_TEXT})",
        lambda share: share != 0.0,
        None,
    )
    """Ratio of the tip's displacement along the rotation to the first watched displacement.

    Watched first is the load's dof, or the first point in [output.points]. The ratio is the sine of
    the stagger; < 0: against the rotation. Default: 1. For a solid with [rotation] the default is
    no ratio, but the circumferential motion of the watched node. For ``identify``, the rotor axis
    must then be parallel to x, y or z.
    """
    order: int | None = positive_int_field(None)
    """Number of load periods in a revolution, for a scene without [rotation]."""
    revolutions: int = positive_int_field(100)
    """Number of revolutions for which arrivals are computed; in a run-up the total number."""
    noise: float = nonnegative_field(0.0, unit="s")
    """Standard deviation of the normal errors that are added to computed arrival times."""
    clock: float = nonnegative_field(0.0, unit="s")
    """Step of the clock to which computed arrival times are rounded; 0: not rounded."""
    seed: int = any_type_field("a whole number >= 0", lambda value: value >= 0, 0)
    """Seed for the random errors with ``noise``."""
    angle_deviation: float = nonnegative_field(0.0, unit="degrees")
    """Standard deviation of the probe angles' errors, which a fit takes as constant."""
    orders: tuple[float, ...] | None = any_type_field(
        "a list of different whole numbers >= 1",
        lambda orders: (
            orders
            and all(order >= 1.0 and order % 1.0 == 0.0 for order in orders)
            and len(set(orders)) == len(orders)
        ),
        None,
    )
    """Engine orders among which the fit chooses for the vibration in the arrivals.

    Default: the load's order, or 1 to 24 if the order is unknown.
    """
    stiffening: float | None = bounded_field("-0.9", "0.9", None)
    """Relative change of natural frequencies f per relative change of the speed n, d ln f / d ln n.

    It is used for resonances in a measured run-up, and affects the fitted damping. Default with
    [rotation]: computed for each mode by the Campbell diagram; otherwise 0.
    """
    frequencies: tuple[float, ...] | None = any_type_field(
        "two finite numbers > 0, the second one larger",
        lambda ends: len(ends) == 2 and 0.0 < ends[0] < ends[1],
        None,
    )
    """Range for a frequency that need not be a multiple of the speed [Hz].

    It replaces engine orders, at constant speed.
    """
    fitted_harmonics: int = positive_int_field(2)
    """Number of fitted harmonics; 2 or more show a breathing crack."""
    subharmonic: int = positive_int_field(1)
    """2: the vibration has twice the load's period.

    Harmonics are then multiples of half the load frequency.
    """
    fitted_revolutions: int = positive_int_field(1)
    """Number of consecutive revolutions of a run-up that are fitted together."""


@dataclass(frozen=True)
class Output(Table):
    """Settings for the output: printed and drawn quantities, and watched points.

    [output]
    quantities = ["amplitude", "ratio_2_1"]
    [output.points]
    tip = [0.1, 0.1]
    """

    quantities: tuple[str, ...] | None = any_type_field(
        f"a list of names out of {', '.join(OBSERVABLES_BY_NAME)}",
        lambda names: names and set(names) <= OBSERVABLES_BY_NAME.keys(),
        None,
    )
    """Names of printed and drawn quantities; files have all. Default: a short selection."""
    points: tuple[OutputPoint, ...] = any_type_field(
        f"a table with at most {MAX_NAMED_OUTPUT_POINTS} points: a name of letters, digits and "
        "_, and finite numbers [x, y], or [x, y, z] in a solid",
        lambda points: (
            len(points) <= MAX_NAMED_OUTPUT_POINTS
            and all(re.fullmatch(r"[A-Za-z]\w{0,29}", point.key, re.A) for point in points)
        ),
        (),
    )
    """Points [m]: the nearest node to each is watched in each direction.

    Default: the dof with the largest load.
    """
