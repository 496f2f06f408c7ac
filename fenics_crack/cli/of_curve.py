"""What there is to say of a response curve."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from fenics_crack.balance.error_report import LARGE_ERROR
from fenics_crack.balance.indicators import Indicators
from fenics_crack.cli.account import (
    IN_A_TEST,
    Account,
    in_short,
    known_to,
    largest_seen,
    of_error,
    of_size,
)  # fmt: skip
from fenics_crack.cli.of_motion import with_hertz
from fenics_crack.cli.scenes import remark_on
from fenics_crack.curves.curve import PARAMETERS, ResponseCurve, kind_in_words, parameter_axis
from fenics_crack.curves.peak import top_and_damping
from fenics_crack.model.bilinear import BilinearFrequencies, bilinear_frequencies
from fenics_crack.model.rotation import RunUpStructure
from fenics_crack.scene.quantities import OF_LIPS, OF_POINTS, QUANTITIES
from fenics_crack.study.asked import asked_along_curve
from fenics_crack.study.key_figures import highest_omega
from fenics_crack.study.run import Run
from fenics_crack.table import UNITS, Table, counted, quantity, ranging, with_frequency, with_unit

__all__ = ["account_of_curve", "curve_points", "few_special_points", "special_points"]

ENDS = 3
"""Rows of special points that are no bifurcations: start, end, largest."""
SHOWN_POINTS = 5
"""Special points that are printed beside these; the file has all."""
LOOKED_AT = 8
"""Points along a curve whose error is reported, beside the largest response."""
KNOWN_SPEEDS = 9
"""Of a run-up, at which natural frequencies are computed."""
SHORT = ("amplitude", "ratio_2_1", "closed_share", "opening", "over_bilinear")
"""Indicators printed of the special points where the scene does not choose: no wider than a
terminal."""


def account_of_curve(run: Run[ResponseCurve]) -> Account:
    """A curve, its special points, its errors and its stability (collective)."""
    found, scene = run.result, run.scene
    special = special_points(run)
    few, hidden = few_special_points(run, special)
    largest = _largest(run)
    notes = [
        *([largest] if run.stated else []),
        remark_on(run.structure, highest_omega(scene, "curve")),
    ]
    if hidden:
        what = "more bifurcations and changes of stability"
        notes.insert(0, f"{hidden} {what}: curve.json")
    kinds = dict.fromkeys(point.kind for point in found.bifurcations)
    notes += [f"{kind_in_words(kind)}: {IN_A_TEST[kind]}" for kind in kinds if kind in IN_A_TEST]
    seen = found.indicators(run.watched_dof)
    peak = int(np.argmax(seen.amplitude))
    if seen.largest_order[peak] > 3:
        order = f"harmonic {seen.largest_order[peak]:.0f} is the largest of the higher ones"
        share = f"{seen.ratio_largest[peak]:.2g} of harmonic 1"
        where = "the largest response" if _passed(found, peak) else "its end"
        notes.append(f"at {where} {order}, {share}")
    if scene.harmonic_balance.tolerance is not None and run.structure.n_pairs:
        notes.append(f"harmonics, by the truncation error: {ranging(found.harmonics)}")
    return Account(
        "curve",
        special,
        rows=curve_points(run),
        shown=in_short(few, scene, SHORT),
        facts=_facts(run, largest),
        notes=notes,
        warnings=[*_warnings(run), *of_size(run, largest_seen(run))],
        tables={"Special points": in_short(special, scene, SHORT)},
        done=bool(found.complete),
        run=run,
    )


def _largest(run: Run[ResponseCurve]) -> str:
    """The largest response, and how well it is known."""
    found = run.result
    amplitude = found.amplitude(run.watched_dof)
    place = int(np.argmax(amplitude))
    if not _passed(found, place):
        return (
            f"The response grows up to where the curve ended early, "
            f"{quantity(amplitude[place], 'm')} half peak-to-peak ({run.watched_name}) at "
            f"{_place(run, found.values[place])}."
        )
    peak, height, _ = top_and_damping(found.values, amplitude, place)
    known = known_to(run, run.watched[0].column("amplitude"))
    where = "" if run.stated is None else known_to(run, run.stated.resonance)
    return (
        f"The largest response of the curve, {quantity(height, 'm')} half peak-to-peak "
        f"({run.watched_name}{known and f', known to {known}'}), is at "
        f"{_place(run, peak)}{where and f', known to {where}'}."
    )


def _passed(found: ResponseCurve, place: int) -> bool:
    """Whether the largest response is none only because the curve ended early there."""
    return bool(found.complete) or place < len(found) - 1


def _place(run: Run[ResponseCurve], *values: float) -> str:
    """Values of the parameter in its unit: "50.1 Hz", "50.1 and 50.3 Hz"."""
    factor, _, unit = parameter_axis(run.result.parameter, run.scene.in_hertz)
    numbers = " and ".join(f"{factor * value:.6g}" for value in values)
    return f"{numbers} {unit}".removesuffix(" -")


def _facts(run: Run[ResponseCurve], largest: str) -> Iterator[str]:
    """The largest response, shares of stability, and where the error is large."""
    yield largest
    found = run.result
    if found.multipliers is not None:
        states = ("stable", "unstable", "undecided")
        shares = [f"{np.mean(found.verdicts == state):.0%} {state}" for state in states]
        yield f"Of {len(found)} points {', '.join(shares)}."
    inexact = found.displacement_errors > LARGE_ERROR
    if inexact.any():
        at = found.values[inexact]
        yield (
            f"At {np.mean(inexact):.0%} of the points, between {_place(run, at.min(), at.max())}, "
            f"the estimated error of the displacement is above {LARGE_ERROR:.0%}; these are faint "
            "in the picture."
        )


def _warnings(run: Run[ResponseCurve]) -> Iterator[str]:
    """A large error, where and why the stability is undecided, and an early end."""
    found, scene = run.result, run.scene
    peak = int(np.argmax(found.amplitude(run.watched_dof)))
    looked_at = {peak, *np.linspace(0, len(found) - 1, LOOKED_AT).astype(int).tolist()}
    reports = {index: found.solution(index).report for index in sorted(looked_at)}
    worst = max(reports, key=lambda index: reports[index].total)
    where = f" at {_place(run, found.values[worst])}"
    yield from of_error(scene, reports[worst], int(found.harmonics[worst]), where)
    stretches = _undecided_stretches(found)
    for first, last in stretches[:SHOWN_POINTS]:
        ends = found.values[[first, last]] if last > first else found.values[[first]]
        where = f"{'between ' if last > first else ''}{_place(run, *ends)}"
        reason = found.reason((first + last) // 2)
        count = counted(last + 1 - first, "point")
        yield f"the stability is undecided at {count}, {where}: {reason}"
    if len(stretches) > SHOWN_POINTS:
        more = sum(last + 1 - first for first, last in stretches[SHOWN_POINTS:])
        yield (
            f"the stability is undecided at {counted(more, 'other point')}, each for its own "
            "reason: curve.reason(index) in Python"
        )
    yield from run.stated.dents if run.stated is not None else ()
    if not found.complete:
        yield f"the curve ended early: {found.status}"


def _undecided_stretches(found: ResponseCurve) -> list[tuple[int, int]]:
    """First and last points of stretches along which no point is decided, the longest first."""
    if found.undecided is None:
        return []
    left = np.concatenate([[0], found.undecided, [0]])
    first, behind = (np.flatnonzero(np.diff(left) == change).tolist() for change in (1, -1))
    stretches = [(one, other - 1) for one, other in zip(first, behind, strict=True)]
    return sorted(stretches, key=lambda ends: ends[0] - ends[1])


def _undecided(found: ResponseCurve) -> bool:
    """Whether no point is known to be stable or unstable, though all were judged."""
    return found.multipliers is not None and bool(np.all(found.verdicts == "undecided"))


# --- its points -----------------------------------------------------------------------------------


def curve_points(run: Run[ResponseCurve]) -> Table:
    """Every point of a curve with its indicators."""
    names = [name for name in run.result.to_dict() if name not in QUANTITIES]
    table, found = run.result.table(*names), _along(run, run.result)
    values = zip(*(column.tolist() for column in found.values()), strict=True)
    rows = [[*row, *more] for row, more in zip(table.rows, values, strict=True)]
    return Table((*table.columns, *found), rows)


def special_points(run: Run[ResponseCurve]) -> Table:
    """Ends, largest response of the first watched dof, bifurcations and changes of stability.

    Of a curve over the load frequency both columns, rad/s and Hz; of a run-up also the speed, in
    rad/s and rpm.
    """
    found = run.result
    along = _places(found) | _along(run, found)
    special = found.at_bifurcations if found.bifurcations else found
    there = _places(special) | _along(run, special)
    largest = int(np.argmax(found.amplitude(run.watched_dof)))
    top = "largest" if _passed(found, largest) else "largest so far"
    rows = [("start", 0, along), ("end", -1, along), (top, largest, along)]
    for number, point in enumerate(found.bifurcations, 1):
        name = kind_in_words(point.kind)
        if found.undecided is not None:
            name += f", exact {_place(run, point.exact)}" if point.confirmed else ", unconfirmed"
        rows.append((name, number, there))
    if found.multipliers is not None:
        for index in np.flatnonzero(found.verdicts[1:] != found.verdicts[:-1]):
            after = found.verdicts[index + 1]
            what = {"stable": "gained", "unstable": "lost", "undecided": "undecided"}[after]
            rows.append((f"stability {what} after", int(index), along))
    values = [(name, *(float(column[at]) for column in of.values())) for name, at, of in rows]
    return Table(("point", *along), values)


def _places(curve: ResponseCurve) -> dict[str, np.ndarray]:
    """Columns of a curve's parameter, of frequencies and speeds in both of their units."""
    if curve.parameter not in ("omega", "speed"):
        return {PARAMETERS[curve.parameter]: curve.values}
    columns = with_frequency({curve.parameter: curve.values, "omega": curve.omega})
    return {with_unit(name, UNITS[name]): np.asarray(column) for name, column in columns.items()}


def few_special_points(run: Run[ResponseCurve], table: Table) -> tuple[Table, int]:
    """The first rows of :func:`special_points` and some others, and how many are left out.

    Bifurcations come before changes of stability, those of the exact orbits before others, and of
    alike ones those with the larger response. Where no point is decided, none changes.
    """
    found, rows = run.result, [*table.rows]
    ends, others = rows[:ENDS], rows[ENDS:]
    points = found.bifurcations
    amplitude = next(n for n, name in enumerate(table.columns) if name.endswith("amplitude [m]"))
    if _undecided(found):
        others = others[: len(points)]

    def weight(place: int) -> tuple[bool, bool, float]:
        special = place < len(points)
        return special, special and points[place].confirmed, others[place][amplitude]

    kept = sorted(sorted(range(len(others)), key=weight, reverse=True)[:SHOWN_POINTS])
    shown = [*ends, *(others[place] for place in kept)]
    return Table(table.columns, shown), len(others) - len(kept)


def _along(run: Run[ResponseCurve], curve: ResponseCurve) -> dict[str, np.ndarray]:
    """Columns of indicators of the watched dofs, by their names with units: a value for every point
    of a curve of the run."""
    seen: Sequence[Indicators] = curve.measure([watched.dof for watched in run.watched])
    found: dict[str, np.ndarray] = {}
    for watched, indicators in zip(run.watched, seen, strict=True):
        for name, (_, unit) in OF_POINTS.items():
            found[with_unit(watched.column(name), unit)] = getattr(indicators, name)
    for name, (_, unit) in OF_LIPS.items():
        found[with_unit(name, unit)] = getattr(seen[0], name)
    for name, values in asked_along_curve(run, curve).items():
        found[with_unit(name, QUANTITIES[name][1])] = values
    near = _natural_along(run, np.asarray(seen[0].omega)).nearest(seen[0].omega)
    return found | {with_unit(name, unit): value for name, _, unit, value in with_hertz(near)}


def _natural_along(run: Run[ResponseCurve], omega: np.ndarray) -> BilinearFrequencies:
    """Natural frequencies; of a run-up those at the speeds where the load has some frequencies
    (...) [rad/s]: (..., n). Squares are linear in W^2 between :data:`KNOWN_SPEEDS` of them."""
    structure, found = run.structure, run.result
    if not isinstance(structure, RunUpStructure):
        return bilinear_frequencies(structure)
    speed = omega * (found.values[0] / found.omega[0])
    known = np.linspace(speed.min(), speed.max(), min(speed.size, KNOWN_SPEEDS))
    there = [bilinear_frequencies(structure.at_speed(float(one))) for one in known]

    def at_speeds(rows: list[np.ndarray]) -> np.ndarray:
        columns = [np.interp(speed**2, known**2, row**2) for row in np.transpose(rows)]
        return np.sqrt(np.stack(columns, axis=-1))

    is_open, tied = ([getattr(one, f"omega_{kind}") for one in there] for kind in ("open", "tied"))
    return BilinearFrequencies(at_speeds(is_open), at_speeds(tied))
