"""What else is not as the scene says: the material, the clamp, damping, and the model itself.

Each has a prior, a normal distribution about what the scene says, whose width is in ``[identify]``
with its source. To first order a standard deviation of it changes the natural frequency of mode j
by a relative a_j, the size of harmonics by a relative b, and through their poles
(:mod:`fenics_crack.identification.interpolation`) the harmonics by

    d ln U_k = b - sum_j (2 r^2 - 2 i z r) / (1 - r^2 + 2 i z r) a_j,      r = k W / w_j.

Nothing is solved again for it. These changes are directions in which predictions may be wrong
together: of the plate with its crack, of the same plate without it, and of its frequencies before
it had one, which is how these take away what is not known of the plate.

A crack that is inclined acts like a straight one at the height of its tip (0.87 to 1.11 of that, of
ten edge cracks inclined by 10 degrees); a wider or softer one like a sharp one that is longer or
shorter: it is this that measurements tell of. What is stated of the real one is less sure by that
(:func:`act_as`).

Young's modulus and density change the part e of w_j^2 that is elastic, not what rotation adds. A
soft clamp takes from w_j^2

    w_j^4 m^2 times its softness to turning and w_j^4 (m_x^2 + m_y^2) times that to pushing,

with m = R^T M phi_j (Rayleigh's quotient, from the moment w_j^2 m and the forces of the clamp,
which are those of the mode's inertia in rigid motions R about its middle). The two are independent:
a bolt that is loose lets it turn, jaws that slip let it move. How large they are, one beside the
other, is that of a clamp that is as soft everywhere, with a radius of gyration q about its middle,
q^2; together, by what they take from the first mode.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fenics_crack.errors import FEW_MODES, InputError
from fenics_crack.fem.loads import rigid_motions
from fenics_crack.identification.interpolation import Feature, poles
from fenics_crack.identification.measurements import Measurements
from fenics_crack.model.modes import Modes, solve_modes, times
from fenics_crack.parallel import MPI
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Identify
from fenics_crack.study.prepare import prepare
from fenics_crack.table import RPM

STIFFENING = 0.05
"""Relative standard deviation of what rotation adds to the square of a natural frequency: beams and
plates differ by so much in it."""
OF_ALL_MODES = 0.9
"""Part of the variance of what a crack changes that all modes have together: a compliance."""
OF_ONE_MODE = 0.2
"""Part of what changes between the plate before it had a crack and now that each mode has by
itself. Of plates clamped deeper, let go at an end of the clamp or on an elastic block, turning,
moving and a common change leave so much of the largest change of four to six modes: 0.00 to 0.04 if
15 times as tall as wide, to 0.08 if five times, to 0.12 if three, to 0.19 if two and to 0.32 if
square; of cracks of 5 and 10 % of the width in the plate of three 0.11 to 0.51."""
POWER = 2.0
"""Of a crack's length, like which it changes natural frequencies."""
OF_SIZE = ("crack.length", "crack.depth")
"""Keys of a crack's size."""
FACTORS = {"rad/s": 2.0 * np.pi, "kHz": 1e-3, "mHz": 1e3}
"""What numbers in other units are multiples of."""
LIKE_A_MULTIPLE = 0.3
"""Of the logarithm of such a multiple: no crack halves a frequency or doubles it."""


@dataclass(frozen=True)
class Whole:
    """The plate without its crack: natural frequencies, and how they change with what is not known.

    Attributes
    ----------
    speed : float [rad/s]
        Of the rotor.
    frequencies : (n,) [Hz]
        With lips tied where a crack cannot be taken out.
    elastic : (n,)
        Part of their squares that rotation does not add.
    by_elastic, by_rotation : (n, s)
        Relative changes by a standard deviation of each, were it all or none.
    sizes : (s,)
        Likewise of the size of harmonics.
    between : (n, 3 + n)
        Relative changes between the plate before it had a crack and now, by temperature, by its
        clamp, that turns and that moves, and of each mode by itself.
    """

    speed: float
    frequencies: np.ndarray
    elastic: np.ndarray
    by_elastic: np.ndarray
    by_rotation: np.ndarray
    sizes: np.ndarray
    between: np.ndarray

    def changes_at(self, faster: np.ndarray) -> np.ndarray:
        """Relative changes by a standard deviation of each at speeds (k,), over the rotor's, with
        whose square grows what it adds to that of a frequency (Southwell): (k, n, s)."""
        elastic = (self.elastic / self._squares_at(faster[:, None]))[..., None]
        return np.asarray(elastic * self.by_elastic + (1.0 - elastic) * self.by_rotation)

    def _frequencies_at(self, rpm: float) -> np.ndarray:
        """Those at another speed, nan for the rotor's own: (n,) [Hz]."""
        if np.isnan(rpm):
            return self.frequencies
        return self.frequencies * np.sqrt(self._squares_at(RPM * rpm / self.speed))

    def _squares_at(self, faster: np.ndarray | float) -> np.ndarray:
        """Squares of frequencies at speeds (k, 1), over the rotor's, over those at its own:
        (k, n)."""
        return np.asarray(self.elastic + (1.0 - self.elastic) * faster**2)

    def check(self, measurements: Measurements, loads: Sequence[float], *, other: bool) -> None:
        """Raise InputError for frequencies of loads, of which the scene has these [Hz], and natural
        ones in another unit than Hz, in rad/s all of them where the plate may be an ``other`` one;
        and unless it may for those without the crack that are of another mode."""
        for row in [row for row in measurements.rows if loads and not row.natural]:
            near = loads[int(np.abs(np.log(np.divide(loads, row.frequency))).argmin())]
            if (unit := _unit(row.frequency / near)) in ("kHz", "mHz"):
                allowed = f"in Hz; the scene has {near:.4g} Hz, so that this seems to be in {unit}"
                raise InputError(f"measurements.frequency, {row.name}", row.frequency, allowed)
        rows = [row for row in measurements.rows if row.natural and row.value > 0.0]
        rows = [row for row in rows if row.mode <= len(self.frequencies)]
        known = [self._frequencies_at(row.rpm) for row in rows]
        pairs = zip(rows, known, strict=True)
        units = [_unit(row.value / there[row.mode - 1]) for row, there in pairs]
        for unit in FACTORS:
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


def _unit(ratio: float) -> str:
    """The unit of a number that is so many times what it would be in Hz; empty: Hz, or none."""
    near = (u for u, factor in FACTORS.items() if abs(np.log(ratio / factor)) < LIKE_A_MULTIPLE)
    return next(near, "")


def whole_plate(scene: Scene, table: Identify) -> Whole:
    """Find the modes of a plate without a crack, lips tied if it has some, on this rank alone."""
    modes = _modes(scene)
    count = len(modes.omega)
    elastic = np.ones(count)
    if scene.speed > 0.0:
        still = _modes(scene.at_rest()).omega[:count]
        elastic = np.clip(still / modes.omega, 0.0, 1.0) ** 2
    unknown = {axis.key for axis in table.unknown}
    widths = {
        "material.young": table.young_deviation,
        "material.density": table.density_deviation,
        "geometry.thickness": table.thickness_deviation,
    }
    young, density, thickness = (0.0 if k in unknown else w for k, w in widths.items())
    by_clamp, every = _by_clamp(modes), np.eye(count)
    by_elastic, by_rotation = (
        np.column_stack(
            [
                np.tile([0.5 * young * part, -0.5 * density * part, 0.0], (count, 1)),
                -table.clamp_deviation * by_clamp,
                table.model_deviation * every,
                0.5 * STIFFENING * (1.0 - part) * every,
            ]
        )
        for part in (1.0, 0.0)
    )
    sizes = np.zeros(by_elastic.shape[1])
    sizes[[0, 2]] = -young, -thickness
    between = np.column_stack([np.ones(count), by_clamp, OF_ONE_MODE * every])
    return Whole(
        scene.speed,
        modes.omega / (2.0 * np.pi),
        elastic,
        by_elastic,
        by_rotation,
        sizes,
        table.before_deviation * between,
    )


def _modes(scene: Scene) -> Modes:
    structure = prepare(scene, MPI.COMM_SELF, whole=True).structure
    few = min(FEW_MODES, structure.n_dofs - structure.n_pairs)
    return solve_modes(structure, few, lips="tied" if structure.n_pairs else "open")


def _by_clamp(modes: Modes) -> np.ndarray:
    """Relative changes of natural frequencies by a clamp that turns and one that moves, over that
    of the first by both: (n, 2); all alike by turning, as of a slender beam, where no node is
    clamped or it is not known which are."""
    nodes = modes.structure.nodes
    slender = np.outer(np.ones(len(modes.omega)), [1.0, 0.0])
    if nodes is None:
        return slender
    clamped = nodes.points[(nodes.dofs < 0).all(axis=1)]
    if len(clamped) < 2:
        return slender
    moved = rigid_motions(nodes.points - clamped.mean(axis=0))
    rigid = np.zeros((len(moved), modes.structure.n_local))
    dofs = nodes.dofs.ravel()
    rigid[:, dofs[dofs >= 0]] = moved[:, dofs >= 0]
    squares = (rigid @ times(modes.structure.mass, modes.shapes)) ** 2
    gyration, d = np.sum(np.var(clamped, axis=0)), nodes.points.shape[1]
    pushed, turned = squares[:d].sum(axis=0), squares[d:].sum(axis=0)
    taken = modes.omega[:, None] ** 2 * np.column_stack([turned, gyration * pushed])
    return np.asarray(taken / np.hypot(*taken[0]))


def relative_changes(
    features: Sequence[Feature],
    damping: np.ndarray,
    basis: np.ndarray,
    scene: Scene,
    changes: np.ndarray,
    sizes: np.ndarray,
) -> np.ndarray:
    """Relative changes of features by a standard deviation of each unknown, (m, f, s): of natural
    frequencies without the crack, of what it adds to their logarithms, and of harmonics.

    Parameters
    ----------
    features : sequence of Feature
    damping : (m, 1)
        Ratios.
    basis : (m, f, 1 + 2 n)
        What :attr:`Part.basis` has there at the load of each feature.
    scene : Scene
        With the widths of the priors.
    changes : (f, n, s)
        Of the plate without a crack at the speed of each feature, :meth:`Whole.changes_at`.
    sizes : (s,)
        Likewise of the size of harmonics.
    """
    table, count = scene.given("identify"), changes.shape[1]
    natural, cracked = (
        np.array([getattr(feature, name) for feature in features])[:, None]
        for name in ("natural", "of_crack")
    )
    modes = np.array([feature.mode for feature in features])[:, None]
    shape = len(basis), len(modes), count
    by_mode = np.broadcast_to(natural & (modes == 1 + np.arange(count)), shape)
    by_crack, by_damping = by_mode * cracked, np.zeros((*shape[:2], 1))
    if not natural.all():
        with np.errstate(invalid="ignore"):
            bilinear, plain = np.split(np.log(basis[..., 1:]), 2, axis=2)
        shifts = np.nan_to_num(bilinear - plain)[..., :count]
        r, pole = poles(features, damping, basis)
        turned = 2j * damping[..., None] * r / pole
        slopes = (turned - 2.0 * r**2 / pole)[..., :count]
        by_mode = np.where(natural, by_mode, slopes)
        by_crack = np.where(natural, by_crack, slopes * shifts)
        by_damping = -turned.sum(axis=2)[..., None]
    own = table.crack_deviation * np.sqrt(1.0 - OF_ALL_MODES)
    known = any(axis.key == "damping.ratio" for axis in table.unknown)
    columns = [
        np.einsum("mfn,fns->mfs", by_mode * ~cracked, changes) + ~natural * sizes,
        own * by_crack,
        (0.0 if known else table.damping_deviation) * by_damping,
    ]
    return np.concatenate(columns, axis=2)


def act_as(x: np.ndarray, keys: Sequence[str], scene: Scene) -> np.ndarray:
    """How far a crack may be from the straight and sharp one that acts like it, at values (m, d) of
    the unknowns: standard deviations (m, d)."""
    table, found, into = scene.given("identify"), np.zeros_like(x), np.zeros(len(x))
    for key in OF_SIZE:  # that of a part-through crack is its depth
        size = np.full(len(x), getattr(scene.crack, key.removeprefix("crack."), None) or 0.0)
        if key in keys:
            size = x[:, keys.index(key)]
            own = table.crack_deviation * np.sqrt(OF_ALL_MODES) / POWER * size
            found[:, keys.index(key)] = own
        into = np.where(size > 0.0, size, into)
    if "crack.height" in keys:
        tilt = np.tan(np.radians(table.angle_deviation))
        found[:, keys.index("crack.height")] = tilt * into
    return found
