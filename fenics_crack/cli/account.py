"""Warnings of results, and what is printed of tables."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from fenics_crack.balance.error_report import LARGE_ERROR, NOT_CONFIRMED_TEXT, ErrorReport
from fenics_crack.balance.solution import PeriodicSolution, Stability
from fenics_crack.basics.errors import MOST_HARMONICS
from fenics_crack.basics.observables import QUANTITIES, Where, names_of
from fenics_crack.basics.report import Report
from fenics_crack.basics.tables import Table, percent, quantity
from fenics_crack.model.contact import friction_of
from fenics_crack.model.modes import damped_count_and_max_omega
from fenics_crack.runs.run import Run
from fenics_crack.scene.scene import Scene
from fenics_crack.study.plausibility import SMALL_MOTION, from_clamp

MOST_TURNING = 0.3
"""Sliding across the lines of friction over that along them from which on friction along lines is
not trusted."""
ALWAYS, BY_DEFAULT, NEVER = range(3)
"""Whether a quantity is printed: whatever the scene chooses, where it does not choose, or in files
alone. These are parts of an error, and sentences, which are below the table."""
OTHERS = {
    "periods": ("periods", "-", BY_DEFAULT),
    "steps_per_period": ("steps in a period", "-", BY_DEFAULT),
    "settled": ("change over the last period", "-", BY_DEFAULT),
    "distance": ("distance from the settled motion", "-", ALWAYS),
    "created_energy": ("energy created", "-", BY_DEFAULT),
    "verdict": ("verdict", "-", ALWAYS),
    "multiplier": ("largest multiplier", "-", BY_DEFAULT),
    "converged": ("converged", "-", ALWAYS),
    "harmonics": ("harmonics", "-", BY_DEFAULT),
    "iterations": ("iterations", "-", BY_DEFAULT),
    "residual_error": ("relative error of the gap: residual", "-", NEVER),
    "truncation_error": ("relative error of the gap: harmonics", "-", NEVER),
    "sampling_error": ("relative error of the gap: AFT sampling", "-", NEVER),
    "reduction_error": ("relative error of the gap: modal truncation", "-", NEVER),
    "displacement_error": ("relative error of the displacement at the load", "-", NEVER),
    "total_error": ("relative error of the gap by modes and harmonics", "-", ALWAYS),
    "penetration_share": ("relative penetration", "-", BY_DEFAULT),
    "from_rest": ("the motion from rest", "-", NEVER),
    "rest_amplitude": ("half peak-to-peak, motion from rest", "m", BY_DEFAULT),
    "unknown_error": ("reason of the unknown error", "-", NEVER),
    "remarks": ("remarks", "-", NEVER),
    "conclusion": ("conclusion", "-", NEVER),
}
"""Words and unit of quantities beside the indicators of a motion, and whether they are printed."""
DECIDES = "--set harmonic_balance.tolerance=1e-2"
"""Option with which an exact orbit, its error and its stability are sought."""
ON_MODES = "depends on truncated modes"
IN_A_TEST = {
    "fold": "the curve turns back: in a test the vibration jumps to another size here",
    "period_doubling": "beyond it the vibration repeats after two periods of the load: in a test "
    "half the load's frequency appears in the spectrum",
    "neimark_sacker": "beyond it the vibration will not repeat each period: in a test its size "
    "swells and falls slowly, and lines appear on both sides of the load's frequency",
}
"""Meaning of bifurcations to somebody at a test rig, by their kinds."""
UNITS_WITH_ROUNDING = ("m", "N", "Pa m^0.5")
"""Units in which values up to 1e-15 are rounding, and written as 0."""


# --- sentences ------------------------------------------------------------------------------------


def of_size(run: Run[Any], largest: Sequence[float]) -> list[str]:
    """A warning of a motion that is not small beside the distance from the clamp, from the largest
    displacement of each dof that is watched [m], with its mean (collective)."""
    lengths = from_clamp(run.structure.whole, [one.dof for one in run.watched])
    place = int(np.argmax(rotations := np.asarray(largest) / lengths))
    if not rotations[place] > SMALL_MOTION:
        return []
    return [
        f"{quantity(largest[place], 'm')} of {run.watched[place].words} is beyond small "
        f"displacements: the equations neglect the square of the rotation about the clamp, of "
        f"{rotations[place]:.2g} rad; the stated errors do not include it"
    ]


def largest_seen(run: Run[Any]) -> list[float]:
    """|a0| and half the peak-to-peak displacement of each dof that is watched, the largest along a
    curve [m] (collective)."""
    seen = run.result.measure([one.dof for one in run.watched])
    return [float(np.max(np.abs(one.mean) + one.amplitude)) for one in seen]


def of_error(
    scene: Scene, report: ErrorReport, harmonics: int, where: str = "", limit: float = LARGE_ERROR
) -> Iterator[str]:
    """A warning of an estimated error above a limit, with what makes it smaller: by its largest
    part, and never what the scene does already. Without an orbit :func:`of_stability` says it."""
    if not report.total > limit:  # or not requested
        return
    finer, table = "more damping: H is at its limit", scene.harmonic_balance
    if table.tolerance is None:
        can_choose = table.samples is None and table.form != "block"
        key_words = f": {DECIDES} chooses them" if can_choose else " (harmonic_balance.harmonics)"
        finer = f"more harmonics{key_words}"
    elif harmonics < MOST_HARMONICS:
        finer = "a smaller harmonic_balance.tolerance"
    rigid = scene.contact is not None and scene.contact.law == "unilateral"
    softer = "softer contact, or contact.law = 'unilateral'"
    softer = "a load that moves the crack faces more" if rigid else softer
    part, wanted = {
        "truncation": ("truncated harmonics", finer),
        "reduction": ("truncated modes", f"more modes ({scene.modes_key})"),
        "sampling": ("AFT sampling", "more samples (harmonic_balance.samples)"),
        "residual": ("the residual", f"{softer}: it is rounding"),
    }[report.largest_part]
    said = f"the estimated relative error of the gap is {percent(report.total)}{where}"
    said += f", mostly due to {part}{'' if report.confirmed else f' ({NOT_CONFIRMED_TEXT})'}"
    if report.unknown:
        said = f"the error is unknown{where}, its estimate for {part} did not converge"
    yield f"{said}; use {wanted}" if report.confirmed or where else said


def of_stability(
    scene: Scene, run: Run, stability: Stability | None, seen: str = ""
) -> Iterator[str]:
    """A warning of a solution that is unstable, irregular or undecided, with the motion seen in
    place of it."""
    if stability is None or stability.verdict == "stable":
        return
    because = f" ({stability.reason})" if stability.reason else ""
    largest, other = complex(stability.multipliers[0]), "of another size"
    if largest.imag != 0.0:
        other = "that does not repeat each period, whose size swells and falls slowly"
    elif largest.real <= 0.0:
        other = "that repeats after two periods of the load"
    text = f"the orbit is unstable{because}: a disturbed motion leaves it, for one {other}{seen}"
    hints, search = [], [] if scene.harmonic_balance.tolerance else [DECIDES]
    if stability.verdict == "irregular":
        text = "; ".join(
            [stability.reason + seen, *(f"{option} may find one" for option in search)]
        )
    if stability.verdict == "undecided":
        text = f"the stability of the orbit is undecided{because}{seen}"
        hints += search
        table = scene.damping  # None: a matrix, which damps all modes or not
        if table and not (table.of_all_modes or damped_count_and_max_omega(run.structure) is None):
            hints.append("damping of all modes (damping.modes = 'all')")
    yield text + (f"; {' or '.join(hints)} may decide it" if hints else "")


def of_lines(run: Run[Any]) -> tuple[list[str], list[str]]:
    """A note that pairs of a solid slide along lines, and a warning where they do not; nothing on
    plates and without friction."""
    if not (turning := getattr(friction_of(run.contact), "turning", None)):
        return [], []
    warning = f"sliding turns ({turning:.2g}): what friction does is not to be trusted"
    note = "friction acts along one line for each pair; sliding across it is"
    note += f" {turning:.2g} of that along it, without friction"
    return [note], [warning] if turning > MOST_TURNING else []


def of_friction(found: PeriodicSolution) -> Iterator[str]:
    """A warning where contact has nearly more than one solution at an instant."""
    flow = found.assessment.flow
    if flow is None or flow.friction_law is None:
        return
    largest, critical = float(np.max(flow.friction_law.coefficient)), flow.critical_friction
    if largest > 0.5 * critical:
        high = f"the coefficient of friction, {largest:g}, is above half of {critical:.2g}"
        yield f"{high}, from which on the contact forces of an instant need not be the only ones"


def of_more_modes(scene: Scene, found: PeriodicSolution, verdict: str) -> Iterator[str]:
    """A warning of a solution whose orbit has another verdict with twice the modes or more
    (collective)."""
    larger = found.assessment.more_modes
    if larger is not None and (said := larger.describe_contradiction(verdict)):
        yield f"{said}: the verdict {verdict!r} {ON_MODES}; raise {scene.modes_key}"


# --- what is printed of tables --------------------------------------------------------------------


def in_short(table: Table, scene: Scene, where: Where) -> Table:
    """Return the printed part of a table: the quantities that the scene chooses, or those shown at
    a place, one of the frequencies in rad/s and in Hz, and one of the speeds in rad/s and in rpm.

    A table with a column "name" has a quantity in each row, another one in each column. What is not
    a quantity is printed too, where quantities are columns or the scene does not choose.
    """
    chosen, table, default = scene.quantities, _rounded(table), names_of(where=where)

    def wanted(name: str, unit: str) -> bool:
        name = name.rpartition(".")[2]
        if _is_twin(name, unit, scene):
            return False
        name = name.replace("frequency_", "omega_")
        return name in (chosen or default) if name in QUANTITIES else True

    if table.columns[0] == "name":
        shown = (ALWAYS, BY_DEFAULT) if chosen is None else (ALWAYS,)
        rows = [
            row[1:]
            for row in table.rows
            if wanted(row[0], row[3])
            and not (isinstance(row[2], float) and np.isnan(row[2]))
            and OTHERS.get(row[0], ("", "", ALWAYS))[2] in shown
        ]
        return Table(table.columns[1:], rows)
    return _with_columns(table, wanted)


def _rounded(table: Table) -> Table:
    """The same with lengths and forces that are rounding as 0."""
    units = [heading.partition("[")[2].rstrip("]") for heading in table.columns]
    place = table.columns.index("unit") if "unit" in table.columns else None

    def rounded(value: Any, unit: str) -> Any:
        known = isinstance(value, float) and unit in UNITS_WITH_ROUNDING
        return 0.0 if known and abs(value) <= 1e-15 else value

    rows = []
    for row in table.rows:
        own = units if place is None else len(units) * [str(row[place])]
        rows.append([rounded(*both) for both in zip(row, own, strict=True)])
    return Table(table.columns, rows)


def printed(report: Report) -> Table:
    """The table of a report that is printed; with a scene one of its frequencies, in rad/s or in
    Hz, and one of its speeds, likewise."""
    table, scene = report.shown or report.table, report.scene
    if scene is None:
        return table
    return _with_columns(table, lambda name, unit: not _is_twin(name, unit, scene))


def _is_twin(name: str, unit: str, scene: Scene) -> bool:
    """Return True for a frequency or speed in the unit that the scene does not use."""
    prefix, other = ("omega", "rad/s") if scene.in_hertz else ("frequency", "Hz")
    speed = "speed" if scene.in_rpm else "rpm"
    return name == speed or (name.startswith(prefix) and unit == other)


def _with_columns(table: Table, wanted: Callable[[str, str], bool]) -> Table:
    """The columns of a table that are wanted by their names and units."""
    headings = (heading.rstrip("]").partition(" [") for heading in table.columns)
    kept = [n for n, (name, _, unit) in enumerate(headings) if wanted(name, unit)]
    return Table([table.columns[n] for n in kept], [[row[n] for n in kept] for row in table.rows])


def readable_rows(table: Table) -> Table:
    """The known quantities of a table with a column "name" as one reads them: "7.916 µm", and
    relative ones as "5.7 %"; with their errors where it has these."""
    rows = [row[1:] for row in _rounded(table).rows if row[2] == row[2]]
    return Table(
        ("quantity", "value", *table.columns[4:]),
        [(*_readable(*row[:3]), *row[3:]) for row in rows],
    )


def _readable(name: str, value: Any, unit: str) -> tuple[str, Any]:
    known = isinstance(value, float) and np.isfinite(value)
    if known and unit in UNITS_WITH_ROUNDING:
        return name, quantity(value, unit)
    if known and name.startswith("relative "):
        return name, percent(value)
    words = f"{value:.6g}" if known else {True: "yes", False: "no"}.get(value, value)
    return name, words if unit in ("-", "1", "") else f"{words} {unit}"
