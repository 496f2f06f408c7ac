"""Plausibility of a scene: key figures, and remarks on unusual values.

The figures follow from one factor of K and few modes; nothing is solved. With the crack open, K^-1
and the lowest modes give displacement and gap at a frequency w,

    u(w) = K^-1 f + sum_j phi_j (phi_j^T f) [d_j(w) - 1 / w_j^2],
    d_j(w) = 1 / (w_j^2 - w^2 + 2 i xi_j w_j w),

and, by B instead of f, the compliance of the crack faces R(w) = B^T H(w) B. The mean load and the
preload alone close some pairs, by a static contact problem. As long as these stay closed and the
others open, the motion is linear, and the closed ones carry R(w)^-1 B^T u(w) beside their static
force.

Remarks are rows of tables: a key, a number, and the range in which it is usual. A remark forbids
nothing; most often a unit or a number is mistyped.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from fenics_crack.basics.ranks import gather_rows
from fenics_crack.basics.tables import RPM, TURN, frequency_axis, in_unit
from fenics_crack.fem.cracks import POSITION_TOLERANCE
from fenics_crack.fem.setting import expand_load_table
from fenics_crack.model.contact import solve_complementarity
from fenics_crack.model.factor import Factor
from fenics_crack.model.modes import (
    BilinearFrequencies,
    Modes,
    check_damped_modes,
    count_below,
    match_bonded_modes,
    multiply,
    solve_bonded_modes,
    solve_modes,
    solve_modes_with_factor,
)
from fenics_crack.model.nodes import format_point
from fenics_crack.model.receptance import ResidualFlexibility
from fenics_crack.model.rotation import coriolis_shifts
from fenics_crack.model.structure import ModalDamping, RayleighDamping, Structure
from fenics_crack.numerics.fourier import to_complex
from fenics_crack.scene.scene import Scene
from fenics_crack.scene.tables import Curve
from fenics_crack.scene.words import faces_in_words
from fenics_crack.study.prepare import Study, reduction_of
from fenics_crack.study.resonance import (
    N_SEARCH_MODES,
    UNSOUGHT_RESONANCE,
    LoadResonance,
    order_crossing_speed,
)

N_MODES = 4
"""Modes that are computed."""
SMALL_MOTION = 0.1
"""Displacement over length, a rotation [rad], up to which displacements are small: the terms that
linear theory neglects are about its square, 1 %."""


@dataclass(frozen=True)
class KeyFigures:
    """Key figures of a scene's structure, not reduced.

    Attributes
    ----------
    size : (d,) [m]
        Width, height and, of a solid, thickness of the mesh.
    elements : int or None
        Along each face of the crack that has the fewest; None without a crack.
    omega_open, omega_tied : (at most 4,) [rad/s]
        Lowest natural frequencies, crack open and crack bonded; these are infinite where there
        are no more.
    omega_bilinear : (at most 4,) [rad/s]
        Estimated resonances of a crack that opens for one half of a motion and closes for the
        other, by the open modes.
    damping : (at most 4,)
        Ratios of critical damping of the open modes.
    slopes : (at most 4,)
        S = d(w^2) / d(W^2) of the open modes under rotation; 0 without.
    own_stiffness : (n_pairs,) [N/m]
        1 / (B^T K^-1 B)_jj: of the crack faces themselves, pair by pair.
    stiffness_ratio : (n_pairs,) or None
        Contact stiffness over the own stiffness; None without a law, or without a stiffness.
    mean_opening, static_motion : float [m]
        Largest opening of an open crack under the mean load, and the largest motion of their gaps
        under the load's amplitude, both static.
    displacement, gap_motion : float [m]
        Largest amplitudes of what is watched, and of the gaps, with an open crack at the
        frequencies that are requested.
    rotation : float [rad]
        Largest amplitude over distance from the clamp, of what is watched.
    closed : int
        Pairs that are closed under the mean load and the preload alone.
    breathes : bool
        True if a pair that is then open closes, or one that is closed opens, at these frequencies.
    modes_below : int
        Natural frequencies below that of the highest harmonic.
    modes_kept : int
        After the reduction.
    at_load : AtLoad
        The resonance at the scene's own load, if it has been sought.
    """

    size: tuple[float, ...]
    elements: int | None
    omega_open: np.ndarray
    omega_tied: np.ndarray
    omega_bilinear: np.ndarray
    damping: np.ndarray
    slopes: np.ndarray
    own_stiffness: np.ndarray
    stiffness_ratio: np.ndarray | None
    mean_opening: float
    static_motion: float
    displacement: float
    rotation: float
    gap_motion: float
    closed: int
    breathes: bool
    modes_below: int
    modes_kept: int
    at_load: LoadResonance = UNSOUGHT_RESONANCE


def find_key_figures(study: Study) -> KeyFigures:
    """Compute the figures of a study; of a reduced one in its own coordinates, which hold static
    responses exactly (collective)."""
    scene, whole, law = study.scene, study.structure.in_few_coordinates(), study.contact
    known = whole.known_modes(is_bonded=False)
    most = whole.n_dofs if known is None else len(known[0])
    count = min(N_MODES, most)
    with Factor(whole.stiffness, definite=True) as factor:
        many = solve_modes_with_factor(
            factor, whole, min(N_SEARCH_MODES, most)
        )  # of the resonance, too
        modes = Modes(many.omega[:count], many.shapes[:, :count], whole)
        static = _static(factor, modes, whole.force)
        lips = whole.apply_bt(_static(factor, modes, whole.gap.T.toarray()))
        tied = solve_bonded_modes(whole, count, factor) if whole.n_pairs else modes
    ratios = damping_ratios(whole, modes.omega)
    breathing = BilinearFrequencies(modes.omega, tied.omega[match_bonded_modes(modes, tied)])
    gaps, psi = whole.apply_bt(static), whole.apply_bt(modes.shapes.T)
    loads = whole.sum_over_ranks(whole.force @ modes.shapes)
    amplitudes = [to_complex(rows)[1:] for rows in (static, gaps, loads)]  # of each harmonic
    resting = gaps[0] - whole.clearance  # of an open crack
    pressed = solve_complementarity(lips, resting) if whole.n_pairs else np.zeros(0)
    closed = pressed > 0.0
    watched = [one.dof for one in study.watched]
    lengths = from_clamp(whole.whole, watched)
    largest, turned, moved, breathes = 0.0, 0.0, 0.0, False
    for omega in _omegas(scene, np.concatenate([modes.omega, tied.omega])):
        seen, gap, apart, push = np.zeros((4, 1))  # at most: amplitudes of all harmonics
        for k, (still, still_gap, pull) in enumerate(zip(*amplitudes, strict=True), 1):
            change = _dynamic_part(modes.omega, ratios, k * omega)
            load = change * pull
            motion = still + load @ modes.shapes.T
            parts = whole.values_at(np.stack([motion.real, motion.imag]), watched)
            seen = seen + np.hypot(*parts)
            if whole.n_pairs:
                of_gap = still_gap + load @ psi
                compliance = lips + (psi.T * change) @ psi
                force = np.zeros(whole.n_pairs, dtype=complex)
                shut = compliance[np.ix_(closed, closed)]
                force[closed] = np.linalg.lstsq(shut, of_gap[closed], rcond=None)[0]
                gap, push = gap + np.abs(of_gap), push + np.abs(force)
                apart = apart + np.abs(of_gap - compliance @ force)
        largest = max(largest, float(seen.max(initial=0.0)))
        turned = max(turned, float((seen / lengths).max(initial=0.0)))
        if whole.n_pairs:
            moved = max(moved, float(gap.max()))
            opened = resting - lips @ pressed + apart >= 0.0
            breathes = breathes or bool(np.any(np.where(closed, pressed <= push, opened)))
    own = 1.0 / np.maximum(np.diagonal(lips), 1e-300)
    stiffness = None if law is None or not np.all(np.isfinite(law.stiffness)) else law.stiffness
    kept = reduction_of(scene, whole)
    return KeyFigures(
        size=mesh_extents(whole.whole),
        elements=_elements(scene, whole),
        omega_open=modes.omega,
        omega_tied=tied.omega,
        omega_bilinear=breathing.omega_bilinear,
        damping=ratios,
        slopes=_slopes(modes),
        own_stiffness=own,
        stiffness_ratio=None if stiffness is None else stiffness / own,
        mean_opening=float(np.max(-resting, initial=0.0)) + 0.0,
        static_motion=float(np.abs(amplitudes[1]).sum(axis=0).max(initial=0.0)),
        displacement=largest,
        rotation=turned,
        gap_motion=moved,
        closed=int(closed.sum()),
        breathes=breathes,
        modes_below=_modes_below(whole, many, highest_omega(scene)) if whole.n_pairs else 0,
        modes_kept=whole.n_dofs if kept is None else kept.n_modes,
    )


def _modes_below(whole: Structure, known: Modes, omega: float) -> int:
    """Number of modes below a frequency [rad/s]; counted where all known ones are."""
    if omega < known.omega[-1]:
        return int(np.sum(known.omega < omega))
    return count_below(whole, omega**2)


def _static(factor: Factor, modes: Modes, forces: np.ndarray) -> np.ndarray:
    """Static responses to forces (m, n_local); of a structure that can move as a
    rigid body the deformation alone, as it accelerates."""
    whole, free = modes.structure, modes.shapes[:, modes.omega == 0.0]
    left = ResidualFlexibility(whole, free, np.zeros(free.shape[1]), whole.gap)
    return left.solve(factor, forces) if free.size else factor.solve(forces)


def _slopes(modes: Modes) -> np.ndarray:
    """Return d(w^2) / d(W^2) of mass-normalised modes phi under rotation, else 0: (n,).

    phi^T (K_1 + K_2 + 2 W^2 K_3) phi
    """
    structure, slopes = modes.structure, np.zeros(len(modes.omega))
    rotation = structure.rotation if structure.n_sectors == 1 else structure.whole.rotation
    if rotation is None:
        return slopes
    second, third = rotation.displaced_stiffness
    for mode, shape in enumerate(modes.shapes.T):
        shapes = np.vstack(list(structure.sector_displacements(shape[None]))).T
        force = multiply(rotation.stiffness, shapes) + multiply(second, shapes)
        force += 2.0 * rotation.speed**2 * multiply(third, shapes)
        slopes[mode] = structure.sum_over_ranks((shapes * force).sum())
    return slopes


def _elements(scene: Scene, whole: Structure) -> int | None:
    """Elements along the crack that has the fewest: its pairs by the order of the displacement,
    rounded up, for tips are no pairs; or its patches."""
    if not whole.n_pairs:
        return None
    cracks = whole.pairs.cracks
    fewest = whole.n_pairs if cracks is None else int(np.bincount(cracks).min())
    return math.ceil(fewest / (1 if scene.mesh is None or scene.mesh.patches else scene.mesh.order))


def mesh_extents(whole: Structure) -> tuple[float, ...]:
    """Extents of the mesh of a whole structure [m] (collective)."""
    if whole.nodes is None:
        return np.nan, np.nan
    return tuple(np.ptp(gather_rows(whole.comm, whole.nodes.points), axis=0).tolist())


def from_clamp(whole: Structure, dofs: Sequence[int]) -> np.ndarray:
    """Distance of the nodes of some dofs from the clamp, at most the mesh's longest side [m]; inf
    without nodes (collective)."""
    if whole.nodes is None:
        return np.full(len(dofs), np.inf)
    points, numbers = (gather_rows(whole.comm, a) for a in (whole.nodes.points, whole.nodes.dofs))
    clamp, side = points[np.all(numbers < 0, axis=1)], np.ptp(points, axis=0).max()
    away = [clamp[:, None] - points[np.any(numbers == dof, axis=1)] for dof in dofs]
    return np.array([np.linalg.norm(vectors, axis=2).min(initial=side) for vectors in away])


def damping_ratios(whole: Structure, omega: np.ndarray) -> np.ndarray:
    """Ratios of critical damping of the lowest modes, by their frequencies (n,) [rad/s]."""
    rule = whole.damping
    if isinstance(rule, RayleighDamping):
        twice = 2.0 * omega
        return np.divide(rule.rate(omega**2), twice, out=np.zeros_like(omega), where=omega > 0.0)
    found = np.zeros(len(omega))
    if isinstance(rule, ModalDamping):
        damped = min(check_damped_modes(whole), len(omega))
        ratio = np.asarray(rule.ratio)
        found[:damped] = ratio if ratio.ndim == 0 else ratio[:damped]
    return found


def _dynamic_part(natural: np.ndarray, ratios: np.ndarray, omega: float) -> np.ndarray:
    """d_j(w) - 1 / w_j^2 of the modes; d_j(w) of rigid-body ones, which no static part holds."""
    squares = natural**2
    below = squares - omega**2 + 2j * ratios * natural * omega
    static = np.divide(1.0, squares, out=np.zeros_like(squares), where=squares > 0.0)
    return 1.0 / np.where(below == 0.0, 1e-12 * squares, below) - static


# --- the frequencies that a scene requests --------------------------------------------------------


def _omegas(scene: Scene, natural: np.ndarray) -> list[float]:
    """Return the frequencies to compute at: ends of the requested ranges, resonances between."""
    found = {scene.excitation.omega}
    for low, high in (span_of(scene, "curve"), span_of(scene, "sweep")):
        found |= {low, high, *(float(omega) for omega in natural if low <= omega <= high)}
    return sorted(found)


def span_of(scene: Scene, command: str) -> tuple[float, float]:
    """Lowest and highest load frequency [rad/s] of "solve", "curve" or "sweep"."""
    omegas = [scene.excitation.omega]
    curve = scene.curve if command == "curve" else None
    if curve is not None and curve.followed[0] == "omega":
        omegas = [*curve.followed[1:]]
    elif curve is not None and curve.followed[0] == "speed":
        omegas = [(scene.excitation.order or 1) * speed for speed in curve.followed[1:]]
    if command == "sweep":
        omegas = [*scene.swept_omegas]
    return min(omegas), max(omegas)


def highest_omega(scene: Scene, command: str = "") -> float:
    """H w: the highest frequency [rad/s] of the harmonics in "solve", "curve" or "sweep", by
    default in any of them."""
    if not command:
        return max(highest_omega(scene, one) for one in ("solve", "curve", "sweep"))
    harmonics = [scene.harmonic_balance.harmonics]
    if command == "sweep":
        harmonics = [*scene.swept.get("harmonic_balance.harmonics", harmonics)]
    return span_of(scene, command)[1] * max(harmonics)


# --- resonances and curves ------------------------------------------------------------------------

CURVE_UNITS = {"omega": (1.0, "rad/s"), "frequency": (TURN, "Hz"), "speed": (1.0, "rad/s"),
               "rpm": (RPM, "rpm")}  # fmt: skip
"""Factor to [rad/s] of a curve's parameter, and its unit."""


def proposed_curve(scene: Scene, figures: KeyFigures) -> Curve | None:
    """Return a curve through the resonance at the load; None where the scene's holds it, or follows
    another parameter, or nothing is damped.

    From three half-power widths below to three above that and its place under a small load: the
    curve meets its peak. Where it is not known, the same of the mode nearest to the load, with the
    crack open and bonded. Ends are rounded outwards to three digits.
    """
    load, curve, found = scene.excitation, scene.curve, figures.at_load
    turns = load.order is not None and scene.disk is None
    parameter = "frequency" if scene.in_hertz else "omega"
    if turns:
        parameter = "rpm" if scene.in_rpm else "speed"
    if curve is not None:
        parameter = curve.parameter
    if parameter not in CURVE_UNITS:
        return None
    mode = int(np.argmin(np.abs(figures.omega_bilinear - load.omega)))
    opened, breathing = float(figures.omega_open[mode]), float(figures.omega_bilinear[mode])
    # Three half-power bandwidths from it the response is a sixth of the peak.
    beyond = 1.0 + 3.0 * 2.0 * float(figures.damping[mode])
    if not (opened > 0.0 and breathing < 2.0 * opened and beyond > 1.0):
        return None
    bonded = 1.0 / (2.0 / breathing - 1.0 / opened)  # of the same mode
    meeting = partial(_meeting, scene, parameter, slope=figures.slopes[mode])
    low, high, start, stop = map(meeting, (opened, bonded, opened / beyond, bonded * beyond))
    if not found.unknown and turns == (parameter in ("speed", "rpm")):
        low = high = found.value
        start, stop = min(low, found.rest), max(high, found.rest)
        start, stop = start - 3.0 * found.width, stop + 3.0 * found.width
    if curve is not None and min(curve.followed[1:]) <= high and max(curve.followed[1:]) >= low:
        return None
    if not 0.0 < start < stop < math.inf:
        return None
    unit = CURVE_UNITS[parameter][0]
    return Curve(_rounded(start / unit, math.floor), _rounded(stop / unit, math.ceil), parameter)


def _rounded(value: float, towards: Callable[[float], int]) -> float:
    """Round to three digits."""
    digits = 10.0 ** (2 - math.floor(math.log10(value)))
    return towards(value * digits) / digits


def _meeting(
    scene: Scene, parameter: str, omega: float, slope: float, harmonic: float = 1.0
) -> float:
    """Parameter of a curve [rad/s] at which a harmonic of the load meets a natural frequency, whose
    square has a slope over that of the speed."""
    order = scene.excitation.order
    if parameter in ("speed", "rpm") and order is not None:
        return order_crossing_speed(harmonic * order, scene.speed, omega, slope)
    return omega / harmonic


def scales_with_load(scene: Scene) -> bool:
    """Return True if the response is proportional to the load: no clearance, smoothing, rotation.

    Where forces and gaps are multiplied by a positive number, the equations of crack faces that
    touch or not, at g = 0, are multiplied by it as a whole. The centrifugal load stays what it is.
    """
    if scene.speed > 0.0 or (scene.contact is not None and not scene.contact.is_unilateral):
        return False
    parts = scene.all_cracks.values() if scene.structure is None else (scene.structure,)
    return all(part.clearance == 0.0 for part in parts)


# --- remarks --------------------------------------------------------------------------------------

LARGEST_SIDE = 20.0
"""Maximum plausible side of a plate [m]."""
FASTEST = 1000.0
"""Maximum plausible speed of a blade tip [m/s]; the longest blades have 700."""
TOO_FAST = "the blade tip moves at {:.3g} m/s, where the fastest have 700"
MOST_DAMPED = 0.05
"""Maximum plausible ratio of critical damping."""
CORIOLIS = 0.01
"""Minimum relative change of a frequency by the Coriolis force that is reported: the errors of
usual meshes are as large."""
WITHOUT_CORIOLIS = "the Coriolis force, left out, would move one of the first modes by {:.2%}"
SLIPS_FIRST = "material.", "geometry.", "rotation.", "mesh.file", "structure.model"
"""Keys on which the key figures depend: with a slip there they get no remarks."""


@dataclass(frozen=True)
class Remark:
    """Something unusual: ``key = value: what is usual``."""

    key: str
    value: object
    text: str

    def __str__(self) -> str:
        value = f"{self.value:g}" if isinstance(self.value, float) else str(self.value)
        return f"{self.key} = {value}: {self.text}"


class Usual(NamedTuple):
    """A row of the tables of remarks: the plausible range of a number.

    Attributes
    ----------
    keys : str
        Keys, of which the first one with a value other than 0 is named; "crack" is every crack.
    low, high : float
        Plausible range.
    words : str
        What is usual, with places for the number, further values, {kind} and {faces}.
    number : callable, optional
        Number by the value, the scene, and the structure or the key figures in the tables of these,
        or a tuple of it and further values; None where the row does not apply.
    units : mapping
        Units in which values are mistyped, by their factors to that of the key.
    """

    keys: str
    low: float
    high: float
    words: str
    number: Callable[..., Any] = lambda value, *_: float(np.max(value))
    units: Mapping[str, float] = MappingProxyType({})


def remarks_on_scene(
    scene: Scene, structure: Structure | None = None, figures: KeyFigures | None = None
) -> list[Remark]:
    """Return the remarks on a scene, and as far as they are given on its structure before it is
    reduced, and on its key figures (collective)."""
    found = [*_remarks(OF_SCENE, scene)]
    if structure is not None:
        found += _remarks(OF_STRUCTURE, scene, structure)
    if figures is not None and not any(remark.key.startswith(SLIPS_FIRST) for remark in found):
        found += _remarks(OF_FIGURES, scene, figures)
    if structure is not None:
        found += _remarks(OF_MODEL, scene, structure)
    return found


def _remarks(rows: Iterable[Usual], scene: Scene, *known: object) -> Iterator[Remark]:
    """Yield the remarks of a table's rows; with the first unit in which a value would be usual."""
    geometry = scene.geometry
    kind = "structure" if geometry is None else geometry.kind
    for row in rows:
        for key, value in _named(scene, row.keys):
            numbers = row.number(value, scene, *known)
            number, *others = numbers if isinstance(numbers, tuple) else (numbers,)
            if number is None or row.low <= number <= row.high:
                continue
            text = row.words.format(number, *others, kind=kind, faces=faces_in_words(scene))
            for unit, factor in row.units.items():
                if row.low <= factor * number <= row.high:
                    text += f"; in {unit}? then {factor * float(np.max(value)):g}"  # type: ignore[call-overload]
                    break
            yield Remark(key, list(value) if isinstance(value, tuple) else value, text)


def _named(scene: Scene, keys: str) -> list[tuple[str, object]]:
    """Keys that are given with their values: of the first of some that is not 0, else of the first
    that is 0; of cracks all."""
    every: list[list[tuple[str, object]]] = []
    for key in keys.split():
        table, name = key.split(".")
        tables = scene.all_cracks if table == "crack" else {table: getattr(scene, table)}
        values = {f"{place}.{name}": getattr(part, name, None) for place, part in tables.items()}
        every.append([(place, value) for place, value in values.items() if value is not None])
    given = [named for named in every if named]
    moved = [named for named in given if any(np.any(np.asarray(v) != 0) for _, v in named)]
    return (moved or given or [[]])[0]


# --- numbers of rows ------------------------------------------------------------------------------


def _side(value: float, scene: Scene) -> float | None:
    """The longest side of a plate; None for another one."""
    geometry = scene.geometry
    return value if value == max(geometry.width or 0.0, geometry.height or 0.0) else None


def _over(length: float, side: float | None) -> float | None:
    """A crack's length over a side of a plate or of a box."""
    return None if side is None else length / side


def _shorter(scene: Scene) -> float:
    """Shorter side of a plate in its plane [m]; inf without any."""
    sides = scene.geometry.width, scene.geometry.height
    return min((side for side in sides if side is not None), default=math.inf)


def _thickness(value: float, scene: Scene) -> float | None:
    """Thickness over the shorter side; of plane problems 1 m is usual, and the width of a disk's
    blade is no measure."""
    plane = scene.geometry.kind == "plate" and (value == 1.0 or scene.disk is not None)
    return None if plane else value / _shorter(scene)


def _no_node(value: object, scene: Scene, structure: Structure) -> tuple[float, str] | None:
    """Distance of a load from the nearest node, of a part or of a model from elsewhere, over its
    size, and that node's place."""
    if structure.nodes is None or (scene.structure is None and scene.geometry.file is None):
        return None
    if scene.structure is None:
        from fenics_crack.fem.loads import nodal_force_fractions  # DOLFINx

        shares = nodal_force_fractions(scene, structure.nodes.mesh_dofs, "excitation.point", value)  # type: ignore[arg-type]
        if structure.comm.allreduce(np.count_nonzero(shares)) > 1:  # of the nodes of its cell
            return None
    points = gather_rows(structure.comm, structure.nodes.points)
    distance = np.linalg.norm(points - value, axis=1)
    nearest = int(np.argmin(distance))
    return distance[nearest] / np.ptp(points, axis=0).max(), format_point(points[nearest])


def _tip_speed(value: float, scene: Scene, structure: Structure) -> float | None:
    """Speed of the node farthest from the axis [m/s], by the key that gives the rotor's."""
    table = scene.rotation
    if table is None or structure.nodes is None or value != (table.rpm or table.speed):
        return None
    if (table.hub_radius or 0.0) > LARGEST_SIDE:
        return None
    point, axis = (vector[: structure.nodes.points.shape[1]] for vector in scene.axis)
    away = gather_rows(structure.comm, structure.nodes.points) - point
    across = away - np.outer(away @ axis, axis)
    return scene.speed * float(np.linalg.norm(across, axis=1).max())


def _clamp(_: float, scene: Scene, structure: Structure) -> tuple[float, float] | None:
    """Distance of a mesh's clamp from y = 0, over the mesh's size and in m."""
    nodes = structure.nodes
    if scene.mesh is None or scene.mesh.layout != "file" or nodes is None:
        return None
    points, dofs = (gather_rows(structure.comm, rows) for rows in (nodes.points, nodes.dofs))
    heights = points[np.all(dofs < 0, axis=1), 1]
    off = float(heights[np.abs(heights).argmax()]) if len(heights) else 0.0
    return abs(off) / float(np.ptp(points, axis=0).max()), off


def _clamp_bending(_: object, scene: Scene, structure: Structure) -> tuple[float, float] | None:
    """Return the bending stress in a solid's clamp, as of a rectangle, of an axis that is not below
    its middle: over the direct stress of the centrifugal force, and in MPa."""
    nodes, rotation, clamp = structure.nodes, structure.rotation, structure.clamp
    if nodes is None or rotation is None or clamp is None or scene.dimension == 2 or scene.disk:
        return None
    is_clamped, (point, axis) = np.all(nodes.dofs < 0, axis=1), scene.axis
    sides = np.ptp(gather_rows(structure.comm, nodes.points[is_clamped]), axis=0)
    normal, rows = int(sides.argmin()), nodes.dofs[~is_clamped] - structure.first_dof
    axis_offset = (np.eye(3) - np.outer(axis, axis)) @ (clamp.center - point)
    offset = np.where(np.arange(3) == normal, 0.0, axis_offset)
    parts = [rotation.force[rows].sum(axis=0), (clamp.inertia[3:, rows] @ offset).sum(axis=1)]
    force, moment = rotation.speed**2 * structure.sum_over_ranks(np.stack(parts))
    first_side, second_side = np.delete(sides, normal)
    bending = 6.0 * (np.abs(np.delete(moment, normal)) @ [1.0 / second_side, 1.0 / first_side])
    return bending / float(np.linalg.norm(force)), 1e-6 * bending / (first_side * second_side)


def _coriolis(_: float, scene: Scene, structure: Structure) -> float | None:
    """Largest relative change of the lowest frequencies of a solid by the Coriolis force."""
    if scene.rotation is None or structure.rotation is None or scene.dimension == 2 or scene.disk:
        return None
    turning = structure.rotation.speed * scene.axis[1]
    modes = solve_modes(structure, min(N_MODES, structure.n_modes))
    return float(np.abs(coriolis_shifts(modes, turning)).max())


def coriolis_in_words(shifts: np.ndarray) -> str:
    """Describe the effect of the Coriolis force, by relative changes of the lowest natural
    frequencies (m,); "" where it is small."""
    largest = np.abs(shifts).max()
    return "" if largest <= CORIOLIS else WITHOUT_CORIOLIS.format(largest)


def _keeps_mass(_: str, scene: Scene, structure: Structure) -> float | None:
    """The pairs of rigid contact that keep their mass."""
    table, contact = reduction_of(scene, structure), scene.contact
    massless = table is not None and table.method == "massless"
    return None if massless or contact is None or contact.law != "unilateral" else structure.n_pairs


def _other_unit(factor: float) -> Callable[..., tuple[float, ...] | None]:
    """The load's frequency over the first natural one, and that in Hz and rad/s, where times a
    factor, but not as it is, it is near one of the first."""

    def number(_: float, scene: Scene, figures: KeyFigures) -> tuple[float, ...] | None:
        first, omega = float(figures.omega_open[0]), scene.excitation.omega
        every = np.concatenate([figures.omega_open, figures.omega_tied])
        firsts = every[[0, len(figures.omega_open)]]
        meant = not _is_near(omega, every) and _is_near(factor * omega, firsts)
        return (omega / first, first / TURN, first) if meant and first > 0.0 else None

    return number


def _is_near(omega: float, natural: np.ndarray) -> bool:
    return bool(np.any(np.abs(natural - omega) < 0.1 * natural))


def _no_resonance(_: float, scene: Scene, figures: KeyFigures) -> tuple[float, str] | None:
    """The first natural frequency [rad/s] if a curve holds no resonance of the first modes, between
    open and bonded crack, with some harmonics of the load or half its frequency; and a range with
    the one at the load."""
    curve = scene.curve
    if curve is None or curve.parameter not in CURVE_UNITS:
        return None
    meeting = np.vectorize(partial(_meeting, scene, curve.parameter, slope=figures.slopes[0]))
    first, last = sorted(curve.followed[1:])
    natural = figures.omega_open, figures.omega_tied
    for order in (0.5, 1.0, 2.0, 3.0):
        opened, bonded = (meeting(omega, harmonic=order) for omega in natural)
        if np.any((first <= bonded) & (last >= opened)):
            return None
    if last >= meeting(figures.omega_tied[-1], harmonic=1.0):  # more modes are not computed
        return None
    proposed, unit = proposed_curve(scene, figures), CURVE_UNITS[curve.parameter][1]
    ends = figures.omega_open[0], figures.omega_tied[0]
    text = f"{curve.stop:g} {unit}: the first is between {in_unit(frequency_axis(True), *ends)}"
    if proposed is not None:
        text += f"; start = {proposed.start:g} and stop = {proposed.stop:g} hold one"
    return float(ends[0]), text


def _turned(_: object, scene: Scene, figures: KeyFigures) -> tuple[float, float] | None:
    """Rotation [rad] and displacement [m] under the force of [excitation] alone."""
    undamped = scene.has_other_loads or figures.damping.min() == 0.0
    return None if undamped else (figures.rotation, figures.displacement)


def _elements_along(_: object, scene: Scene, figures: KeyFigures) -> int | None:
    """Elements along each crack face; grids choose them, and a mouth has one."""
    at_mouth = scene.contact is not None and scene.contact.pairs == "mouth"
    by_grid = scene.mesh.layout == "grid" and scene.mesh.patches is None
    return None if at_mouth or by_grid else figures.elements


def _never_meet(_: object, scene: Scene, figures: KeyFigures) -> tuple[float, str] | None:
    """The motion of the faces [m] where it opens or closes no pair."""
    if scene.contact is None or scene.structure is not None or figures.breathes:
        return None
    return figures.gap_motion, "opens" if figures.closed else "closes"


# --- tables of remarks ----------------------------------------------------------------------------

MM = MappingProxyType({"mm": 1e-3})
ROTOR = "larger than any rotor"
METALS = "of critical damping, metals have 0.0001 to 0.01"
LOADS = "excitation.force_sin excitation.force_cos"
STIFFNESSES = "contact.stiffness contact.stiffness_per_area"
OF_FIRST = "{:.2g} times the first natural frequency, {:.4g} Hz = {:.4g} rad/s; is it in "
OF_SCENE = (
    Usual("material.young", 1e7, 1.5e12, "in Pa, steel has 2.1e11, and most solids from 1e7 to "
          "1.5e12", units={"GPa": 1e9, "MPa": 1e6}),
    Usual("material.density", 50.0, 25000.0, "in kg/m^3, steel has 7850, and most solids from 50 "
          "to 25000", units={"g/cm^3": 1e3, "t/mm^3": 1e12, "kg/mm^3": 1e9}),
    Usual("material.poisson", 0.0, 0.49, "most solids have 0 to 0.49, steel 0.3"),
    Usual("geometry.width", 0.0, LARGEST_SIDE, "a {kind} of {:g} m", _side, MM),
    Usual("geometry.height", 0.0, LARGEST_SIDE, "a {kind} of {:g} m", _side, MM),
    Usual("geometry.thickness", 0.0, 1.0, "thicker than the {kind} is wide or high",
          _thickness, MM),
    Usual("crack.length", 0.01, 0.9, "{:.3g} of the {kind}'s width; 0.01 to 0.9 are usual",
          lambda length, scene: _over(length, scene.geometry.width)),
    Usual("crack.depth", 0.01, 0.9, "{:.3g} of the {kind}'s thickness; 0.01 to 0.9 are usual",
          lambda depth, scene: _over(depth, scene.geometry.thickness)),
    Usual("mesh.size", 0.0, 1.0, "longer than the {kind}'s shorter side",
          lambda size, scene: size / _shorter(scene), MM),
    Usual("rotation.hub_radius", 0.0, LARGEST_SIDE, ROTOR, units=MM),
    Usual("tip_timing.tip_radius", 0.0, LARGEST_SIDE, ROTOR, units=MM),
    Usual("tip_timing.probes", TURN, math.inf, "all of them within {:.3g} degrees; in rad?",
          lambda angles, _: np.ptp(angles) or None),
    Usual("damping.ratio damping.ratios", 0.0, MOST_DAMPED, METALS, units={"%": 1e-2}),
    Usual("growth.rate", 1e-20, 1e-9, "in m in a cycle at 1 MPa m^0.5, steels have 5e-12 to "
          "1.4e-10", units={"mm in a cycle": 1e-3}),
    Usual("excitation.wave", 0.0, 0.0, "{1} harmonics leave out {0:.2%} of what changes in it "
          "(root mean square)",
          lambda _, scene: (expand_load_table(scene.excitation, scene.dimension)[1],
                            scene.excitation.wave_harmonics)),
    Usual(LOADS, 1.0, 1.0, "no force at all: excitation.force_sin, force_cos and force_mean are "
          "zero", lambda _, scene: scene.has_other_loads or bool(scene.excitation.force_given)),
)  # fmt: skip
OF_STRUCTURE = (
    Usual("structure.model mesh.file", 0.0, LARGEST_SIDE, "a structure of {1:.3g} m x {0:.3g} m; "
          "is the mesh in mm?",
          lambda _, __, structure: (max(e := mesh_extents(structure)), min(e))),
    Usual("excitation.point", 0.0, POSITION_TOLERANCE, "no node is there: the force acts on the "
          "nearest one, at {1}", _no_node),
    Usual("rotation.speed", 0.0, FASTEST, TOO_FAST, _tip_speed, {"rpm": RPM}),
    Usual("rotation.rpm", 0.0, FASTEST, TOO_FAST, _tip_speed),
    Usual("rotation.hub_radius", 0.0, 0.01, "counted from a clamp at y = 0; that of the mesh is at "
          "y = {1:.4g} m", _clamp),
    Usual("rotation.hub_radius rotation.center", 0.0, 0.2, "the axis is not below the middle of "
          "the clamp: so the centrifugal force bends the blade, by about {1:.3g} MPa at the clamp, "
          "{0:.2g} of its direct stress", _clamp_bending),
)  # fmt: skip
OF_FIGURES = (
    Usual("excitation.omega", 1.0, 0.0, OF_FIRST + "Hz? then use excitation.frequency",
          _other_unit(TURN)),
    Usual("excitation.frequency", 1.0, 0.0, OF_FIRST + "rad/s? then use excitation.omega",
          _other_unit(1.0 / TURN)),
    Usual("curve.start", 1.0, 0.0, "no resonance from there to {1}", _no_resonance),
    Usual(LOADS, 0.0, SMALL_MOTION, "with an open crack it moves the {kind} by {1:.2g} m, {0:.2g} "
          "rad about the clamp: beyond small displacements; in N?", _turned),
    Usual("mesh.patches mesh.lip_elements mesh.file", 4, math.inf, "elements or patches "
          "longer than a quarter of the crack; 4 to 20 along each face are usual", _elements_along),
    Usual(STIFFNESSES, 1.0, math.inf, "at most {:.2g} of the {faces}' static stiffness: they "
          "penetrate each other; 100 to 10000 times is usual, or contact.law = 'unilateral'",
          lambda _, __, figures: np.max(figures.stiffness_ratio)),
    Usual(STIFFNESSES, 0.0, 1e6, "at least {:.2g} times the {faces}' static stiffness: numerically "
          "rigid, and hard to solve; contact.law = 'unilateral' is rigid contact",
          lambda _, __, figures: np.min(figures.stiffness_ratio)),
    Usual("contact.sharpness", 10.0, math.inf, "the law is rounded over {1:.2g} m, and the {faces} "
          "move by {2:.2g} m: contact acts on open {faces}",
          lambda k, _, figures: (k * figures.gap_motion, 1.0 / k, figures.gap_motion)),
    Usual("crack.clearance excitation.force_mean rotation.rpm rotation.speed", 0.0, 0.0,
          "the crack never {1}: the load moves open crack faces by {0:.2g} m at most; the response "
          "is linear", _never_meet),
    Usual("damping.mass damping.stiffness", 0.0, MOST_DAMPED, "{:.3g} " + METALS + ", at the first "
          "natural frequency", lambda _, __, figures: float(figures.damping[0])),
    Usual("harmonic_balance.harmonics", 0, 0, "harmonics up to H w reach {1} modes, and {2} are "
          "kept: raise {3}", lambda _, scene, figures: (
              max(figures.modes_below - figures.modes_kept, 0), figures.modes_below,
              figures.modes_kept, scene.modes_key)),
)  # fmt: skip
OF_MODEL = (
    Usual("rotation.rpm rotation.speed", 0.0, CORIOLIS, WITHOUT_CORIOLIS, _coriolis),
    Usual("contact.law", 0.0, 0.0, "rigid contact of pairs that keep their mass: solve gives no "
          "verdict on stability, and curve needs 'penalty' or 'smoothed', or reduction.method = "
          "'massless'", _keeps_mass),
)  # fmt: skip
