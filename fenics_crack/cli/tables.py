"""What the commands print and store of a result, as tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from fenics_crack.balance.indicators import Indicators, contact_extremes, indicators_of
from fenics_crack.balance.solution import PeriodicSolution
from fenics_crack.curves.curve import PARAMETERS, ResponseCurve, parameter_axis
from fenics_crack.model.bilinear import BilinearFrequencies, bilinear_frequencies
from fenics_crack.model.run_up import RunUpStructure
from fenics_crack.numerics.fourier import balanced
from fenics_crack.scene.quantities import OF_FREQUENCIES, OF_LIPS, OF_POINTS, QUANTITIES
from fenics_crack.scene.scene import Scene
from fenics_crack.study.run import Run
from fenics_crack.study.watched import Watched
from fenics_crack.table import UNITS, Table, quantity, with_frequency, with_unit
from fenics_crack.time.march import TimeHistory

if TYPE_CHECKING:
    from fenics_crack.sweep.result import SweepResult

__all__ = [
    "SHORT_CURVE",
    "curve_points",
    "few_cases",
    "few_special_points",
    "history_quantities",
    "history_waves",
    "in_one_unit",
    "in_short",
    "remark_on_points",
    "solution_quantities",
    "solution_waves",
    "special_points",
    "stability_changes",
]

ENDS = 3
"""Rows of special points that are no bifurcations: start, end, largest."""
WIDEST = 120
"""Columns of a terminal that a table of cases takes."""
SHOWN_POINTS, SHOWN_CASES = 5, 12
"""Special points of a curve and cases of a sweep that are printed; files have all."""
SPEEDS = 9
"""Of a run-up, at which natural frequencies are computed."""
SHARE = "of the lips' motion"
OTHERS = {
    "periods": ("periods", "-"),
    "steps_per_period": ("steps in a period", "-"),
    "settled": ("change over the last period", "-"),
    "created_energy": ("energy created", "-"),
    "verdict": ("verdict", "-"),
    "multiplier": ("largest multiplier", "-"),
    "converged": ("converged", "-"),
    "harmonics": ("harmonics", "-"),
    "iterations": ("iterations", "-"),
    "residual_error": ("estimated error: residual", SHARE),
    "truncation_error": ("estimated error: truncation", SHARE),
    "sampling_error": ("estimated error: sampling", SHARE),
    "reduction_error": ("estimated error: reduction", SHARE),
    "displacement_error": ("estimated error: displacement at the load", SHARE),
    "total_error": ("estimated error: total", SHARE),
    "penetration_share": ("penetration", SHARE),
}
"""Words and unit of what is printed of a solution or a motion beside the indicators."""
LAST_HARMONICS = 3
"""Of the last period of a motion in time."""
ALWAYS = ("omega", "frequency", "verdict", "converged", "total_error")
"""Printed whatever the scene chooses."""
SHORT_CURVE = ("amplitude", "ratio_2_1", "closed_share", "opening", "over_bilinear")
"""Indicators printed of the special points of a curve where the scene does not choose: no wider
than a terminal."""
SHORT_SWEEP = ("response", "opening", "amplitude", "ratio_2_1")
"""Columns printed of a sweep, likewise; the response is the amplitude at the load."""

Row = tuple[str, str, object, str]
"""Name, words, value, unit."""


# --- of a solution and of a motion ----------------------------------------------------------------


def solution_quantities(run: Run[PeriodicSolution]) -> Table:
    """The numbers of a solution, its indicators, and its verdict (collective)."""
    found = run.result
    values = found.to_dict()
    if not values["pairs"]:  # no errors were estimated
        values = {n: v for n, v in values.items() if not n.endswith(("_error", "_share"))}
    rows = _frequencies(found.omega)
    for watched in run.watched:
        rows += _of_point(watched, found.indicators(watched.dof).to_dict())
    return _named([*rows, *_of_lips(values), *_natural(run), *_others(values)])


def history_quantities(run: Run[TimeHistory]) -> Table:
    """The numbers of a motion in time: of all periods kept, harmonics of the last (collective)."""
    found = run.result
    values = vars(found) | contact_extremes(found.gap, found.contact_force)
    rows = _frequencies(run.scene.excitation.omega)
    steps = found.steps_per_period
    for watched in run.watched:
        motion = found.displacement([watched.dof])[:, 0]
        waves, size = balanced(motion[-steps:], LAST_HARMONICS), float(np.ptp(motion) / 2.0)
        seen = indicators_of(run.scene.excitation.omega, waves, size, {}).to_dict()
        rows += _of_point(watched, seen)
    return _named([*rows, *_of_lips(values), *_others(values)])


def _named(rows: list[Row]) -> Table:
    return Table(("name", "quantity", "value", "unit"), rows)


def _frequencies(omega: float) -> list[Row]:
    return [
        ("omega", "omega", omega, "rad/s"),
        ("frequency", "frequency", omega / (2.0 * np.pi), "Hz"),
    ]


def _of_point(watched: Watched, values: Mapping[str, object]) -> list[Row]:
    """What is known of a watched dof; the load's is said once."""
    return [
        (
            watched.column(name),
            f"{words}, {watched.words}" if watched.name or name == "amplitude" else words,
            values[name],
            _shown_unit(unit),
        )
        for name, (words, unit) in OF_POINTS.items()
        if name in values
    ]


def _of_lips(values: Mapping[str, object]) -> list[Row]:
    return [
        (name, words, values[name], _shown_unit(unit))
        for name, (words, unit) in OF_LIPS.items()
        if name in values
    ]


def _natural(run: Run[PeriodicSolution]) -> list[Row]:
    """The natural frequencies next to the load's; none without lips."""
    if not run.structure.n_pairs:
        return []
    near = bilinear_frequencies(run.structure).nearest(run.result.omega)
    return [
        (name, f"{words}, mode {near['mode']}", float(value), _shown_unit(unit))
        for name, words, unit, value in _with_hertz(near)
    ]


def _with_hertz(near: Mapping[str, np.ndarray]) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Names, words, units and values of natural frequencies: "omega_open", "frequency_open"..."""
    for name, (words, unit) in OF_FREQUENCIES.items():
        yield name, words, unit, near[name]
        if unit == "rad/s":
            yield name.replace("omega", "frequency"), words, "Hz", near[name] / (2.0 * np.pi)


def _others(values: Mapping[str, object]) -> list[Row]:
    return [(n, words, values[n], unit) for n, (words, unit) in OTHERS.items() if n in values]


def _shown_unit(unit: str) -> str:
    return "-" if unit == "1" else unit


def remark_on_points(watched: Sequence[Watched]) -> str:
    """How far named points are from the nodes that are watched instead; empty where they are."""
    away = {w.name.partition(".")[0]: w.distance for w in watched if w.distance > 0.0}
    places = [f"{name} {quantity(distance, 'm')}" for name, distance in away.items()]
    return f"watched at the nearest node, away by: {', '.join(places)}" if places else ""


# --- waves ----------------------------------------------------------------------------------------


def solution_waves(run: Run[PeriodicSolution]) -> Table:
    """One period of a solution: watched dofs, the mouth and the contact force over time."""
    found = run.result
    time = np.linspace(0.0, found.period, 401)
    motion = found.displacement(time, [watched.dof for watched in run.watched])
    return _waves(run, time, motion, found.gap(time), found.contact_force(time))


def history_waves(run: Run[TimeHistory]) -> Table:
    """The last periods of a motion, likewise."""
    found = run.result
    motion = found.displacement([watched.dof for watched in run.watched])
    return _waves(run, found.time, motion, found.gap, found.contact_force)


def _waves(
    run: Run, time: np.ndarray, motion: np.ndarray, gap: np.ndarray, force: np.ndarray
) -> Table:
    structure = run.structure.whole
    closing = {
        f"closing {structure.where(pair)} [m]": gap[:, pair]
        for pair in structure.watched_pairs.values()
    }
    contact = closing | {"contact force, all pairs [N]": force.sum(axis=1)} if gap.size else {}
    waves, names = np.column_stack([time, motion, *contact.values()]), tuple(contact)
    moved = (f"{watched.words} [m]" for watched in run.watched)
    return Table(("time [s]", *moved, *names), waves.tolist())


# --- of a curve -----------------------------------------------------------------------------------


def curve_points(run: Run[ResponseCurve]) -> Table:
    """Every point of a curve with its indicators."""
    table, found = run.result.table(), _along(run, run.result)
    values = zip(*(column.tolist() for column in found.values()), strict=True)
    rows = [[*row, *more] for row, more in zip(table.rows, values, strict=True)]
    return Table((*table.columns, *found), rows)


def special_points(run: Run[ResponseCurve]) -> Table:
    """Ends, largest response of the first watched dof, bifurcations and changes of stability.

    Of a curve over the load frequency both columns, rad/s and Hz; of a run-up also the speed, in
    rad/s and rpm.
    """
    found, along = run.result, _along(run, run.result)
    factor, _, unit = parameter_axis(found.parameter, run.scene.in_hertz)
    special = _along(run, found.at_bifurcations) if found.bifurcations else {}

    def at(index: int, columns: dict[str, np.ndarray] = along) -> list[float]:
        return [float(column[index]) for column in columns.values()]

    largest = int(np.argmax(found.amplitude(run.watched_dof)))
    places = [("start", 0), ("end", -1), ("largest", largest)]
    rows = [(name, found.values[index], at(index)) for name, index in places]
    for number, point in enumerate(found.bifurcations, 1):
        name = point.kind.replace("_", " ")
        if found.undecided is not None:
            exact = f", exact {factor * point.exact:.6g} {unit}".removesuffix(" -")
            name += exact if point.confirmed else ", unconfirmed"
        rows.append((name, point.value, at(number, special)))
    for index in stability_changes(found):
        after = found.verdicts[index + 1]
        what = {"stable": "gained", "unstable": "lost", "undecided": "undecided"}[after]
        rows.append((f"stability {what} after", found.values[index], at(index)))
    if found.parameter not in ("omega", "speed"):
        names = ("point", PARAMETERS[found.parameter], *along)
        return Table(names, [(name, value, *more) for name, value, more in rows])
    values = np.array([value for _, value, _ in rows])
    axes = {found.parameter: values, "omega": values * (found.omega[0] / found.values[0])}
    columns = with_frequency({name: axis.tolist() for name, axis in axes.items()})
    both = [
        (name, *at, *more)
        for (name, _, more), at in zip(rows, zip(*columns.values(), strict=True), strict=True)
    ]
    headings = [with_unit(name, UNITS[name]) for name in columns]
    return Table(("point", *headings, *along), both)


def _along(run: Run[ResponseCurve], curve: ResponseCurve) -> dict[str, np.ndarray]:
    """Columns of indicators, a value for every point of a curve of the run."""
    return _columns(run, curve.measure([watched.dof for watched in run.watched]))


def _columns(run: Run[ResponseCurve], seen: Sequence[Indicators]) -> dict[str, np.ndarray]:
    """Columns of the indicators of the watched dofs, by their names with units."""
    found: dict[str, np.ndarray] = {}
    for watched, indicators in zip(run.watched, seen, strict=True):
        for name, (_, unit) in OF_POINTS.items():
            found[with_unit(watched.column(name), unit)] = getattr(indicators, name)
    for name, (_, unit) in OF_LIPS.items():
        found[with_unit(name, unit)] = getattr(seen[0], name)
    near = _natural_along(run, np.asarray(seen[0].omega)).nearest(seen[0].omega)
    found |= {with_unit(name, unit): value for name, _, unit, value in _with_hertz(near)}
    return found


def _natural_along(run: Run[ResponseCurve], omega: np.ndarray) -> BilinearFrequencies:
    """Natural frequencies; of a run-up those at the speeds where the load has some frequencies
    (...) [rad/s]: (..., n). Squares are linear in W^2 between :data:`SPEEDS` of them."""
    structure, found = run.structure, run.result
    if not isinstance(structure, RunUpStructure):
        return bilinear_frequencies(structure)
    speed = omega * (found.values[0] / found.omega[0])
    known = np.linspace(speed.min(), speed.max(), min(speed.size, SPEEDS))
    there = [bilinear_frequencies(structure.at_speed(float(one))) for one in known]

    def at_speeds(rows: list[np.ndarray]) -> np.ndarray:
        columns = [np.interp(speed**2, known**2, row**2) for row in np.transpose(rows)]
        return np.sqrt(np.stack(columns, axis=-1))

    is_open, tied = ([getattr(one, f"omega_{kind}") for one in there] for kind in ("open", "tied"))
    return BilinearFrequencies(at_speeds(is_open), at_speeds(tied))


def few_special_points(run: Run[ResponseCurve], table: Table) -> tuple[Table, int]:
    """The first rows of :func:`special_points` and some others, and how many are left out.

    Bifurcations come before changes of stability, those of the exact orbits before others, and of
    alike ones those with the larger response. Where no point is decided, none changes.
    """
    found, rows = run.result, [*table.rows]
    ends, others = rows[:ENDS], rows[ENDS:]
    points = found.bifurcations
    amplitude = next(n for n, name in enumerate(table.columns) if name.endswith("amplitude [m]"))
    if found.multipliers is not None and bool(np.all(found.verdicts == "undecided")):
        others = others[: len(points)]

    def weight(place: int) -> tuple[bool, bool, float]:
        special = place < len(points)
        return special, special and points[place].confirmed, others[place][amplitude]

    kept = sorted(sorted(range(len(others)), key=weight, reverse=True)[:SHOWN_POINTS])
    shown = [*ends, *(others[place] for place in kept)]
    return Table(table.columns, shown), len(others) - len(kept)


# --- what is printed ------------------------------------------------------------------------------


def in_short(table: Table, scene: Scene, default: Sequence[str]) -> Table:
    """What is printed of a table: the quantities that the scene chooses, or the default, one of the
    frequencies in rad/s and in Hz, and one of the speeds in rad/s and in rpm.

    A table with a column "name" has a quantity in each row, another one in each column. What is not
    a quantity is printed too, where quantities are columns or the scene does not choose.
    """
    chosen = None if scene.output is None else scene.output.quantities

    def wanted(heading: str, unit: str) -> bool:
        name = heading.partition(" [")[0].rpartition(".")[2]
        if _is_twin(name, unit, scene):
            return False
        name = name.replace("frequency_", "omega_")
        return name in (chosen or default) if name in QUANTITIES else True

    if table.columns[0] == "name":
        rows = [
            row[1:]
            for row in table.rows
            if wanted(row[0], row[3])
            and not (isinstance(row[2], float) and np.isnan(row[2]))
            and (chosen is None or row[0] in ALWAYS or row[0] not in OTHERS)
        ]
        return Table(table.columns[1:], rows)
    return _with_columns(table, wanted)


def in_one_unit(table: Table, scene: Scene) -> Table:
    """A table with one of the frequencies, in rad/s or in Hz, and one of the speeds, likewise."""
    return _with_columns(
        table, lambda heading, unit: not _is_twin(heading.partition(" [")[0], unit, scene)
    )


def _is_twin(name: str, unit: str, scene: Scene) -> bool:
    """Whether a quantity is a frequency or a speed in the unit that the scene does not use."""
    prefix, other = ("omega", "rad/s") if scene.in_hertz else ("frequency", "Hz")
    speed = "speed" if scene.in_rpm else "rpm"
    return name == speed or (name.startswith(prefix) and unit == other)


def _with_columns(table: Table, wanted: Callable[[str, str], bool]) -> Table:
    """The columns of a table that are wanted by their headings and units."""
    headings = enumerate(table.columns)
    kept = [n for n, name in headings if wanted(name, name.partition("[")[2].rstrip("]"))]
    return Table([table.columns[n] for n in kept], [[row[n] for n in kept] for row in table.rows])


def few_cases(found: SweepResult) -> tuple[Table, str]:
    """The cases of a small sweep, of a larger one those of largest response; and which in words.

    They are the largest over the load frequency, or over the longest axis, one for each combination
    of the others.
    """
    keys = [axis.key for axis in found.axes]
    output = found.scene.output
    chosen = SHORT_SWEEP if output is None or output.quantities is None else found.quantities
    shown = (n for n in found.quantities if n in chosen or n.rpartition(".")[2] in chosen)
    columns = [*keys, *shown, "verdict"]
    if not np.all(found.converged):
        columns.insert(len(keys), "state")
    verdicts = set(found["verdict"][found.converged].tolist())
    if verdicts <= {""} or verdicts == {"undecided"}:
        columns.remove("verdict")
    table, words = _fitting(found, columns)
    if len(table.rows) <= SHOWN_CASES:
        return table, words
    along = int(np.argmax(found.shape))
    for key in ("excitation.omega", "excitation.frequency"):
        along = keys.index(key) if key in keys else along
    height = np.nan_to_num(found["response"], nan=-1.0)
    numbers = np.arange(height.size).reshape(height.shape)
    highest = np.expand_dims(height.argmax(axis=along), along)
    places = np.take_along_axis(numbers, highest, along).ravel()
    words = f"; the table has the largest responses over {keys[along]}, {found.path.stem}.csv all"
    if len(places) > SHOWN_CASES:
        order = np.argsort(-height.ravel()[places], kind="stable")[:SHOWN_CASES]
        words += f", {SHOWN_CASES} of {len(places)}"
        places = np.sort(places[order])
    return Table(table.columns, [table.rows[place] for place in places]), words


def _fitting(found: SweepResult, columns: list[str]) -> tuple[Table, str]:
    """The table of some columns, without the last quantities if it is too wide; and that in words.

    What a scene asks for by ``output.quantities`` is printed, whatever its width.
    """
    output, left = found.scene.output, [*found.quantities]
    chosen = output is not None and output.quantities is not None
    while True:
        table = found.table(*columns)
        if len(table.formatted("text").splitlines()[1]) <= WIDEST or chosen or len(left) < 2:
            break
        columns = [name for name in columns if name != left[-1]]
        left.pop()
    whole = len(left) == len(found.quantities)
    return table, "" if whole else f"; {found.path.stem}.csv has more columns"


def stability_changes(curve: ResponseCurve) -> list[int]:
    """Points after which the stability is another, where it is known."""
    if curve.multipliers is None:
        return []
    verdicts = curve.verdicts
    return [int(index) for index in np.flatnonzero(verdicts[1:] != verdicts[:-1])]
