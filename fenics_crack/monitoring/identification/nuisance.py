"""Nuisance parameters: the material, the clamp, damping, and the error of the model itself.

Each has a prior, a normal distribution about the scene's value, whose width is in ``[identify]``
with its source. To first order a standard deviation of it changes the natural frequency of mode j
by a relative a_j, the size of harmonics by a relative b, and through their poles
(:mod:`fenics_crack.monitoring.identification.interpolation`) the harmonics by

    d ln U_k = b - sum_j (2 r^2 - 2 i z r) / (1 - r^2 + 2 i z r) a_j,      r = k W / w_j,

and by those of the first harmonic, which drives the k-th. Nothing is solved again for it. These
changes are common errors of predictions: of the plate with its crack, of the same plate without it,
and of its frequencies before it had one, so that measuring those calibrates the plate.

A crack that is inclined acts like a straight one at the height of its crack tip (0.87 to 1.11 of
that, of ten edge cracks inclined by 10 degrees); a wider or softer one like a sharp one that is
longer or shorter. Measurements determine this equivalent crack; the real one has a larger standard
deviation (:func:`crack_deviations`).

Young's modulus E and density change the part e_j of w_j^2 that is elastic, not that by rotation:

    d ln w_j / d ln E = e_j / 2,      e_j = phi_j^T K_0 phi_j / w_j^2,

with the stiffness K_0 at rest and the mode at its speed. A soft clamp takes from w_j^2

    m_j^2 times its softness to turning and (m_x^2 + m_y^2) times that to pushing,

with m = R^T K_0 phi_j, the moment and the forces that hold the mode in rigid motions R about the
clamp's middle (at rest w_j^2 R^T M phi_j, Rayleigh's quotient). The two are independent: a bolt
that is loose lets it turn, jaws that slip let it move. How large they are, one beside the other, is
that of a clamp that is as soft everywhere, with a radius of gyration q about its middle, q^2;
together, by what they take from the first mode.

Modes at other speeds, and of another modulus, are those of a K_0 + s (K - K_0), s the square of the
speed over the scene's, in the space of the modes at rest and at the scene's speed. So temperature
and clamp, which change between the record before there was a crack and the one since, move each
mode at each speed. The stiffening by rotation may change, too, by the blade's seat or the measured
speed: with a temperature that makes the same relative change of all frequencies.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.linalg import eigh

from fenics_crack.basics.errors import FEW_MODES, InputError
from fenics_crack.basics.ranks import MPI
from fenics_crack.basics.tables import RPM, TURN
from fenics_crack.fem.loads import rigid_motions
from fenics_crack.model.modes import Modes, multiply, solve_modes
from fenics_crack.monitoring.identification.interpolation import Feature, driving, poles, turned
from fenics_crack.monitoring.identification.measurements import Measurement, Measurements
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Identify
from fenics_crack.study.prepare import prepare

CRACK_SIZE_KEYS = ("crack.length", "crack.depth")
"""Keys of a crack's size."""
FACTOR_BY_UNIT = {"rad/s": 2.0 * np.pi, "kHz": 1e-3, "mHz": 1e3}
"""Numbers in these units over those in Hz."""


class UncrackedPlate:
    """The plate without its crack, or with a bonded one: natural frequencies and their
    sensitivities to the priors, found on this rank alone.

    Attributes
    ----------
    speed : float [rad/s]
        Of the rotor.
    stiffness : (2, r, r) [1/s^2]
        At rest, and the addition of rotation at that speed, by mass-normalised motions.
    reactions : (r, d)
        Forces and moments at the clamp by these, each over that of a clamp of uniform compliance;
        none where the clamped nodes are not known.
    turning : int
        Number of these that are forces; the others are moments.
    table : Identify
        With the widths of the priors.
    """

    def __init__(self, scene: Scene, table: Identify) -> None:
        if table.temperature_deviation is None:  # of a room; of blades that their gas or drag warms
            table = replace(table, temperature_deviation=25.0 if scene.speed else 10.0)
        self.rotor_speed, self.identify_table, modes = scene.speed, table, _solve_plate_modes(scene)
        still = _solve_plate_modes(scene.at_rest()) if scene.speed > 0.0 else modes
        every = np.hstack([still.shapes, modes.shapes]) if scene.speed > 0.0 else modes.shapes
        squares, vectors = eigh(every.T @ multiply(modes.structure.mass, every))
        kept = squares > np.sqrt(np.finfo(float).eps) * squares[-1]  # independent motions
        basis = every @ (vectors[:, kept] / np.sqrt(squares[kept]))
        at_rest = multiply(still.structure.stiffness, basis)
        elastic = basis.T @ at_rest
        rotating = basis.T @ multiply(modes.structure.stiffness, basis) - elastic
        rigid, self.n_reaction_forces = _build_clamp_motions(modes)
        self.stiffness_parts, self.clamp_reactions = (
            np.stack([elastic, rotating]),
            at_rest.T @ rigid,
        )

    @cached_property
    def natural_frequencies(self) -> np.ndarray:
        """Natural frequencies, with a bonded crack where it cannot be removed: (n,) [Hz]."""
        return self.solve_modes_at(1.0)[0] / TURN

    def solve_modes_at(self, faster: float, stiffer: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Natural frequencies (n,) [rad/s] and modes (r, n) at a speed over the rotor's, with a
        Young's modulus over the scene's."""
        squares, modes = eigh(
            stiffer * self.stiffness_parts[0] + faster**2 * self.stiffness_parts[1]
        )
        count = min(FEW_MODES, len(squares))
        return np.sqrt(np.maximum(squares[:count], 0.0)), modes[:, :count]

    def compute_elastic_fractions(self, faster: float) -> np.ndarray:
        """Elastic part of the squares of frequencies at a speed over the rotor's: (n,)."""
        omega, modes = self.solve_modes_at(faster)
        return np.asarray(np.sum(modes * (self.stiffness_parts[0] @ modes), axis=0) / omega**2)

    def compute_stiffening_factors(self, faster: float, stiffer: float) -> np.ndarray:
        """Factors of frequencies at a speed over the rotor's by a factor of Young's modulus:
        (n,)."""
        return self.solve_modes_at(faster, stiffer)[0] / self.solve_modes_at(faster)[0]

    def compute_clamp_sensitivities(self, faster: float) -> np.ndarray:
        """Return relative changes of natural frequencies at a speed over the rotor's by a soft
        clamp.

        (n, 2): by a clamp that turns and one that moves, over the change of the first frequency at
        the rotor's speed by both. Where the clamp is not known, the same for all modes and by
        turning only, as of a slender beam.
        """
        if not self.clamp_reactions.shape[1]:
            return np.outer(self.compute_elastic_fractions(faster), [1.0, 0.0])

        def taken(faster: float) -> np.ndarray:
            omega, modes = self.solve_modes_at(faster)
            squares = (self.clamp_reactions.T @ modes) ** 2 / omega**2
            turning, moving = squares[self.n_reaction_forces :], squares[: self.n_reaction_forces]
            return np.stack([turning.sum(axis=0), moving.sum(axis=0)])

        return np.asarray((taken(faster) / np.hypot(*taken(1.0)[:, 0])).T)

    def compute_prior_sensitivities(self, faster: float) -> np.ndarray:
        """Relative changes by a standard deviation of each prior at a speed over the rotor's:
        (n, s)."""
        young, density, _ = self._prior_deviations
        elastic = self.compute_elastic_fractions(faster)
        every = np.eye(len(elastic))
        return np.column_stack(
            [
                np.outer(elastic, [0.5 * young, -0.5 * density, 0.0]),
                -self.identify_table.clamp_deviation * self.compute_clamp_sensitivities(faster),
                self.identify_table.model_deviation * elastic * every,
                0.5 * self.identify_table.stiffening_deviation * (1.0 - elastic) * every,
            ]
        )

    def compute_feature_sensitivities(
        self,
        features: Sequence[Feature],
        damping: np.ndarray,
        basis: np.ndarray,
        changes: np.ndarray,
    ) -> np.ndarray:
        """Return relative changes of features by a standard deviation of each prior, (m, f, s): of
        natural frequencies without the crack, of its additions to their logarithms, and of
        harmonics.

        Parameters
        ----------
        features : sequence of Feature
        damping : (m, 1)
            Ratios.
        basis : (m, f, 1 + 2 n)
            :attr:`SolvedCases.scale_and_frequencies` there at the load of each feature.
        changes : (f, n, s)
            Of this plate at the speed of each feature, :meth:`changes_at`.
        """
        table, count = self.identify_table, changes.shape[1]
        natural, cracked = (
            np.array([getattr(feature, name) for feature in features])[:, None]
            for name in ("is_natural_frequency", "is_cracked_frequency")
        )
        modes = np.array([feature.mode for feature in features])[:, None]
        shape = len(basis), len(modes), count
        by_mode = np.broadcast_to(natural & (modes == 1 + np.arange(count)), shape)
        by_crack, by_damping = by_mode * cracked, np.zeros((*shape[:2], 1))
        if not natural.all():
            with np.errstate(invalid="ignore"):
                bilinear, plain = np.split(np.log(basis[..., 1:]), 2, axis=2)
            shifts = np.nan_to_num(bilinear - plain)[..., :count]
            slopes, by_ratio = _differentiate_poles(features, damping, basis)
            first, ratio = _differentiate_poles(driving(features), damping, basis)
            slopes = (slopes + turned(first, features))[..., :count]
            by_mode = np.where(natural, by_mode, slopes)
            by_crack = np.where(natural, by_crack, slopes * shifts)
            by_damping = (by_ratio + turned(ratio, features)).sum(axis=2)[..., None]
        sizes = np.zeros(changes.shape[2])  # of harmonics
        sizes[:3] = np.multiply(self._prior_deviations, (-1.0, 0.0, -1.0))
        own = table.crack_deviation * np.sqrt(1.0 - table.crack_correlation)
        known = any(axis.key == "damping.ratio" for axis in table.unknown)
        columns = [
            np.einsum("mfn,fns->mfs", by_mode * ~cracked, changes) + ~natural * sizes,
            own * by_crack,
            (0.0 if known else table.damping_deviation) * by_damping,
        ]
        return np.concatenate(columns, axis=2)

    @property
    def _prior_deviations(self) -> list[float]:
        """Standard deviations of Young's modulus, density and thickness, 0 if it is an unknown."""
        table, unknown = self.identify_table, {axis.key for axis in self.identify_table.unknown}
        keys = ("material.young", "material.density", "geometry.thickness")
        widths = (table.young_deviation, table.density_deviation, table.thickness_deviation)
        pairs = zip(keys, widths, strict=True)
        return [0.0 if key in unknown else width for key, width in pairs]

    def compute_baseline_sensitivities(self, faster: float) -> tuple[np.ndarray, np.ndarray]:
        """Return relative changes at a speed over the rotor's between the plate before it had a
        crack and now.

        (n, 3 + n): by its clamp, that turns and that moves, by the stiffening of all modes, and of
        each mode by itself, a standard deviation each. (n, 1 + n): by a kelvin, and the uncertainty
        of that by rotation.
        """
        table, elastic = self.identify_table, self.compute_elastic_fractions(faster)
        every = np.eye(len(elastic))
        clamp = np.column_stack(
            [
                self.compute_clamp_sensitivities(faster),
                1.0 - elastic,
                table.before_scatter * elastic * every,
            ]
        )
        kelvin = 0.5 * table.temperature_coefficient * elastic
        unsure = table.stiffening_deviation * (1.0 - elastic) * kelvin * every
        return table.before_deviation * clamp, np.column_stack([kelvin, unsure])

    def check_units_and_modes(
        self, measurements: Measurements, loads: Sequence[float], *, other: bool
    ) -> None:
        """Raise InputError for frequencies that seem to be in another unit, or of another mode.

        Loads have those of the scene [Hz]. Natural ones may all be in rad/s, which is refused
        unless the plate may be an ``other`` one; so are those without the crack that are of another
        mode.
        """
        for row in [row for row in measurements.rows if loads and not row.natural]:
            near = loads[int(np.abs(np.log(np.divide(loads, row.frequency))).argmin())]
            if (unit := _guess_frequency_unit(row.frequency / near)) in ("kHz", "mHz"):
                allowed = f"in Hz; the scene has {near:.4g} Hz, so that this seems to be in {unit}"
                raise InputError(f"measurements.frequency, {row.name}", row.frequency, allowed)
        rows = [row for row in measurements.rows if row.natural and row.value > 0.0]
        rows = [row for row in rows if row.mode <= len(self.natural_frequencies)]
        speeds = [1.0 if np.isnan(row.rpm) else RPM * row.rpm / self.rotor_speed for row in rows]
        known = [self.solve_modes_at(faster)[0] / TURN for faster in speeds]
        pairs = zip(rows, known, strict=True)
        units = [_guess_frequency_unit(row.value / there[row.mode - 1]) for row, there in pairs]
        for unit in FACTOR_BY_UNIT:
            like = [one == unit for one in units]
            if rows and (all(like) if other and unit == "rad/s" else any(like)):
                row, there = rows[like.index(True)], known[like.index(True)]
                modes = "" if all(like) and len(rows) > 1 else ", or of another mode"
                allowed = (
                    f"in Hz; of this plate it is about {there[row.mode - 1]:.4g} "
                    f"Hz, so that this seems to be in {unit}{modes}"
                )
                raise InputError(f"measurements.value, {row.name}", row.value, allowed)
        for row, there in zip(rows, known, strict=True) if not other else ():
            near = int(np.abs(np.log(row.value / there)).argmin()) + 1
            if row.quantity == "frequency_uncracked" and near != row.mode:
                own, that = (f"{there[mode - 1]:.4g} Hz" for mode in (row.mode, near))
                allowed = f"near {own} of this plate's mode {row.mode}; its mode {near} has {that}"
                raise InputError(f"measurements.value, {row.name}", row.value, allowed)


def _guess_frequency_unit(ratio: float) -> str:
    """Unit of a number by its ratio to that in Hz; empty: Hz, or none."""
    # No crack changes a frequency by a factor of exp(0.3).
    near = (unit for unit, factor in FACTOR_BY_UNIT.items() if abs(np.log(ratio / factor)) < 0.3)
    return next(near, "")


class BaselineChanges:
    """Changes between the record before there was a crack and the one since, of q measurements: 0
    of those that are no natural frequency, and of modes that are not known.

    Attributes
    ----------
    factors : (q,)
        Of predictions, by temperatures that are known.
    clamp : (q, s)
        Relative changes by the clamp, a standard deviation each.
    temperature : (q, s)
        The same by a temperature that is not known, the first, and its uncertainty.
    known : (q, s)
        The same of temperatures that are known: by the coefficient, the thermometer and rotation.
    """

    def __init__(
        self, rows: Sequence[Measurement], faster: Sequence[float], whole: UncrackedPlate
    ) -> None:
        """Take measurements, each at a speed over the rotor's.

        Records since are at the mean of their stated temperatures, if any is; those before at the
        stated one, or at one that is not known.
        """
        table, count = whole.identify_table, len(whole.natural_frequencies)
        before = np.array([row.quantity == "frequency_uncracked" for row in rows])
        stated = np.array([row.temperature for row in rows])
        now = stated[~before & np.isfinite(stated)]
        off = np.nan_to_num(stated - (now.mean() if len(now) else np.nan))
        measured = before & np.isfinite(stated) & (len(now) > 0)
        self.temperature_factors, heat = np.ones(len(rows)), np.zeros((len(rows), 1 + count))
        self.clamp_changes = np.zeros((len(rows), 3 + count))
        since = {speed: whole.compute_baseline_sensitivities(speed) for speed in set(faster)}
        for place, (row, speed) in enumerate(zip(rows, faster, strict=True)):
            if row.natural and row.mode <= count:
                by_clamp, by_kelvin = since[speed]
                self.clamp_changes[place] = before[place] * by_clamp[row.mode - 1]
                heat[place] = by_kelvin[row.mode - 1]
                stiffer = 1.0 + table.temperature_coefficient * off[place]
                self.temperature_factors[place] = whole.compute_stiffening_factors(speed, stiffer)[
                    row.mode - 1
                ]
        unknown = (before & ~measured)[:, None]
        self.unknown_temperature_changes = -table.priors["temperature_deviation"] * unknown * heat
        of_known = [
            table.coefficient_deviation * off[:, None] * heat[:, :1],
            table.thermometer_deviation * measured[:, None] * heat[:, :1],
            off[:, None] * heat[:, 1:],
        ]
        self.known_temperature_changes = np.hstack(of_known)

    @property
    def all_changes(self) -> np.ndarray:
        """All changes: (q, s)."""
        return np.hstack(
            [self.unknown_temperature_changes, self.clamp_changes, self.known_temperature_changes]
        )

    def with_change_factors(self, clamp: float, temperature: float) -> BaselineChanges:
        """The same with the changes by the clamp and by an unknown temperature multiplied."""
        found = copy(self)
        found.clamp_changes, found.unknown_temperature_changes = (
            clamp * self.clamp_changes,
            temperature * self.unknown_temperature_changes,
        )
        return found


def _solve_plate_modes(scene: Scene) -> Modes:
    structure = prepare(scene, MPI.COMM_SELF, whole=True).structure
    few = min(FEW_MODES, structure.n_dofs - structure.n_pairs)
    return solve_modes(structure, few, lips="tied" if structure.n_pairs else "open")


def _build_clamp_motions(modes: Modes) -> tuple[np.ndarray, int]:
    """Rigid motions about the clamp's middle, (n, d), translations first, times its radius of
    gyration, and the number of these; none where no node is clamped or the nodes are not known."""
    nodes = modes.structure.nodes
    clamped = np.zeros((0, 0)) if nodes is None else nodes.points[(nodes.dofs < 0).all(axis=1)]
    if nodes is None or len(clamped) < 2:
        return np.zeros((modes.structure.n_local, 0)), 0
    moved = rigid_motions(nodes.points - clamped.mean(axis=0))
    rigid = np.zeros((modes.structure.n_local, len(moved)))
    dofs = nodes.dofs.ravel()
    rigid[dofs[dofs >= 0]] = moved[:, dofs >= 0].T
    straight = nodes.points.shape[1]
    rigid[:, :straight] *= np.sqrt(np.sum(np.var(clamped, axis=0)))
    return rigid, straight


def _differentiate_poles(
    features: Sequence[Feature], damping: np.ndarray, basis: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of logarithms of harmonics by those of natural frequencies and of the ratio of
    damping, from their poles: (m, f, modes)."""
    r, pole = poles(features, damping, basis)
    found = 2j * damping[..., None] * r / pole
    return found - 2.0 * r**2 / pole, -found


def compute_crack_deviations(x: np.ndarray, keys: Sequence[str], scene: Scene) -> np.ndarray:
    """Return standard deviations (m, d) of a crack from the equivalent straight and sharp one, at
    values (m, d) of the unknowns."""
    table, deviations, into = scene.given("identify"), np.zeros_like(x), np.zeros(len(x))
    for key in CRACK_SIZE_KEYS:  # that of a part-through crack is its depth
        size = np.full(len(x), getattr(scene.crack, key.removeprefix("crack."), None) or 0.0)
        if key in keys:
            size = x[:, keys.index(key)]
            common = table.crack_deviation * np.sqrt(table.crack_correlation)
            # Frequencies change with its square.
            deviations[:, keys.index(key)] = common / 2.0 * size
        into = np.where(size > 0.0, size, into)
    if "crack.height" in keys:
        tilt = np.tan(np.radians(table.angle_deviation))
        deviations[:, keys.index("crack.height")] = tilt * into
    return deviations
