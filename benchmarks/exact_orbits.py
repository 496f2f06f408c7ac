"""Exact orbits as answers: what is reached, what it costs, and the same of another checkout.

chains       judged curves of 31 random chains (:func:`verdicts.random_chain`), 6000 to 6029 and
             5012 over .8 w1 to 1.25 w2, and of chain 17 from .431 to 1.217 rad/s; the folds of
             chain 5012 beside those of harmonic balance with H = 60
lobes        the plate of `new` from 2340 to 3140 rad/s with the default step and half of it: three
             intervals of period doubling, whose ends are known
population   an orbit and a verdict to a tolerance of 1e-2: 60 plates as `new` writes them, chains
             5000 to 5059 with their own law, chains 7000 to 7049 with stops 1e2 to 1e4 N/m stiff
few_pairs    curves around the first two modes of 200 systems of 1 or 2 pairs (the "few" of
             :mod:`campaign_cases`, with a penalty of .5 to 1000 times the static stiffness): every
             period doubling and Neimark-Sacker point against :mod:`reference_flow`
between      10 curves of plates and chains, .05 to 1 % damped: the verdict that a curve states
             between its points, every 50th of the default step, against :mod:`reference_flow`
events       curves of 34 plates, those that take at most 2500 points: events of the default step
             among those of it and of a fifth of it
independence error and verdict of the chains of ``population``, H = 5 to 40, asked in two orders and
             after neighbours
breathing    the breathing plate with 18 pairs with mass, H = 7: time with and without verdicts
many         `new` and the same with 40 pairs and 60 modes: its curve to a tolerance
snes         the paper's plate, H = 5, by SNES and by the compiled kernel, on one and two processes
demos        numbers of sweep, grow, identify, timing and campbell

Each part ends with what is asked of it, yes or no. ``--before`` names another checkout with its own
.venv: the same parts run with its package, in a process of their own, and stand in the same table.
A curve to a tolerance is there, where it has no branches of exact orbits, one by harmonic balance
with verdicts: with H = 15, that of `new` to the same tolerance. Times are processor times.

    OMP_NUM_THREADS=1 python benchmarks/exact_orbits.py [--quick] [--only PART]
        [--before CHECKOUT] [folder]
"""

from __future__ import annotations

import csv
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import common
import numpy as np
from campaign_cases import _modes, draw
from reference_flow import NoOrbit, ReferenceFlow
from sweep_scaling import ENVIRONMENT
from verdicts import random_chain

import fenics_crack as fc
from fenics_crack.cli.given import new_scene

Row = dict[str, Any]
Span = tuple[float, float]
Measure = Callable[[bool], Iterator[Row]]
Report = Callable[[list[Row], list[Row]], Iterator[tuple[str, bool | None]]]

TOLERANCE = 1e-2
HERE = Path(__file__).parent
LOBES = (2615.838408, 2615.848897, 2616.218934, 2616.273243, 2616.715619, 2617.446838)
"""Period doublings of `new` with 20 modes [rad/s]: where the exact orbits' multiplier is -1, by
Brent's method on orbits found one by one."""
ON_CIRCLE = 1e-6
"""Distance from the unit circle within which a multiplier decides nothing."""


def main() -> None:
    """Run the parts asked for."""
    common.run(
        __doc__,
        {name: partial(section, name) for name in SECTIONS},
        before={"type": Path, "help": "another checkout, built, measured in the same run"},
        rows={"type": Path, "help": "measure alone, and write the rows as JSON to this file"},
    )


def section(name: str, arguments: common.Arguments) -> None:
    """Measure a part, here and in the other checkout; its table, and what is asked of it."""
    measure, report = SECTIONS[name]
    if arguments.rows:
        arguments.rows.write_text(json.dumps(list(measure(arguments.quick))))
        return
    before = elsewhere(arguments.before, name, arguments.quick) if arguments.before else []
    now = list(measure(arguments.quick))
    rows = [{"checkout": "before"} | row for row in before] + [{"checkout": "now"} | r for r in now]
    columns = [key for key in dict.fromkeys(key for row in rows for key in row) if key[0] != "_"]
    table = [[row.get(key, "-") for key in columns] for row in rows]
    common.save_table(arguments.folder / f"exact_orbits_{name}.csv", name, columns, table)
    for sentence, holds in report(now, before):
        print(f"{'    ' if holds is None else 'yes ' if holds else 'NO  '}{sentence}")


def elsewhere(checkout: Path, name: str, quick: bool) -> list[Row]:
    """The rows of a part as another checkout's package has them."""
    with tempfile.TemporaryDirectory() as folder:
        rows = Path(folder, "rows.json")
        words = [str(checkout / ".venv/bin/python"), __file__, folder, "--only", name]
        words += ["--rows", str(rows), *(["--quick"] if quick else [])]
        subprocess.run(words, check=True, env=os.environ | {"OMP_NUM_THREADS": "1"})
        found: list[Row] = json.loads(rows.read_text())
    return found


def named(now: list[Row], before: list[Row]) -> list[tuple[str, list[Row]]]:
    """The rows that there are, by the name of their checkout."""
    return [(name, rows) for name, rows in (("before", before), ("now", now)) if rows]


def spent(rows: Sequence[Row], key: str = "s") -> float:
    """Sum of the times [s]."""
    return float(sum(row[key] for row in rows))


# --- curves ---------------------------------------------------------------------------------------


def curve_to_tolerance(
    structure: fc.Structure, span: tuple[float, float], law: Any, **options: Any
) -> fc.ResponseCurve:
    """A curve over the frequency to a tolerance, with the verdict of every point."""
    return fc.continue_frequency(structure, *span, law, tolerance=TOLERANCE, throw=False, **options)


def followed(name: str, *arguments: Any, **options: Any) -> tuple[Row, fc.ResponseCurve | None]:
    """A curve and its row; one that does not begin says why."""
    started = time.process_time()
    try:
        curve = curve_to_tolerance(*arguments, **options)
    except fc.ConvergenceError as error:
        row = {"case": name, "complete": False, "at end": False, "points": 0, "undecided": 0}
        return row | {"s": time.process_time() - started, "status": str(error)}, None
    seconds = time.process_time() - started
    undecided = (curve.verdicts == "undecided") & (off_circle(curve) > ON_CIRCLE)
    kinds = [one.kind for one in curve.bifurcations]
    end = arguments[1][1]
    row = {
        "case": name, "complete": curve.complete, "points": len(curve),
        "at end": bool(abs(curve.values[-1] / end - 1.0) < 1e-9), "undecided": int(undecided.sum()),
    }  # fmt: skip
    names = {"folds": "fold", "doublings": "period_doubling", "Neimark-Sacker": "neimark_sacker"}
    row |= {word: kinds.count(kind) for word, kind in names.items()}
    return row | {"unconfirmed": len(curve.bifurcations) - len(kinds), "s": seconds,
                  "status": curve.status}, curve  # fmt: skip


def off_circle(curve: fc.ResponseCurve) -> np.ndarray:
    """Distance of the largest multipliers from the unit circle: (n,); inf where one is unknown."""
    leading = np.asarray(curve.multipliers).reshape(len(curve), -1)[:, 0]
    return np.nan_to_num(np.abs(np.abs(leading) - 1.0), nan=np.inf)


def around(structure: fc.Structure) -> tuple[float, float]:
    """From below the first to above the second natural frequency [rad/s]."""
    first, second = fc.solve_modes(structure, 2).omega
    return 0.8 * first, 1.25 * second


def chains(quick: bool) -> Iterator[Row]:
    """One row for each chain."""
    for seed in range(6000, 6004 if quick else 6030):
        structure, law = random_chain(seed)
        yield followed(str(seed), structure, around(structure), law)[0]
    structure, law = random_chain(5012)
    row, curve = followed("5012", structure, around(structure), law)
    fine = fc.continue_frequency(structure, *around(structure), law, harmonics=60, throw=False)
    known = [one.value for one in fine.bifurcations if one.kind == "fold"]
    found = [one.value for one in curve.bifurcations if one.kind == "fold"] if curve else []
    apart = [min((abs(one / its - 1.0) for one in found), default=np.inf) for its in known]
    yield row | {"folds, H = 60": len(known), "farthest": max(apart, default=np.inf)}
    structure, law = random_chain(17)
    yield followed("17", structure, (0.431, 1.217), law)[0]


def of_chains(now: list[Row], before: list[Row]) -> Iterator[tuple[str, bool | None]]:
    """27 of 30 reach the end, none has an undecided point, in no more time."""
    for name, rows in named(now, before):
        thirty = [row for row in rows if row["case"].startswith("6")]
        ended = sum(row["at end"] for row in thirty)
        points, left = spent(thirty, "points"), spent(thirty, "undecided")
        yield f"{name}: {ended} of {len(thirty)} reach the end, {points:.0f} points", None
        yield f"{name}: others close or say why", all(r["at end"] or r["status"] for r in thirty)
        yield f"{name}: at least 27 of 30", ended >= 0.9 * len(thirty)
        yield f"{name}: {left:.0f} points undecided, with 5012 and 17", not spent(rows, "undecided")
        for row in rows:
            if row["case"] == "5012":
                yield (
                    f"{name}: chain 5012, {row['folds, H = 60']} folds of H = 60 to "
                    f"{row['farthest']:.1e}, {row['folds']} stated", row["farthest"] <= 1e-4,
                )  # fmt: skip
            if row["case"] == "17":
                yield f"{name}: chain 17 to the end", row["at end"]
        yield f"{name}: thirty chains {spent(thirty):.1f} s", None
    if before:
        times = [spent([r for r in rows if r["case"][0] == "6"]) for rows in (now, before)]
        yield f"no more time than before: {times[0] / times[1]:.2f} of it", times[0] <= times[1]


def new(**changes: Any) -> tuple[fc.Scene, fc.Structure, Any]:
    """The scene of `new` with other values, its structure and law; 20 modes in every checkout."""
    changes = {key.replace("__", "."): value for key, value in changes.items()}
    changes = {"reduction.modes": 20} | changes
    scene = fc.Scene.from_text(new_scene("new.toml", "", ())).replace(changes)
    structure = fc.prepare(scene).structure
    assert scene.contact is not None
    return scene, structure, fc.contact_law(scene.contact, structure)


def lobes(quick: bool) -> Iterator[Row]:
    """A row for each step."""
    _, structure, law = new()
    for step in (0.05,) if quick else (0.05, 0.025):
        name = f"step {step:g}"
        row, curve = followed(name, structure, (2340.0, 3140.0), law, longest_step=step)
        found = (
            [one.value for one in curve.bifurcations if one.kind == "period_doubling"]
            if curve
            else []
        )
        ends = {
            f"{end:.3f}": min((abs(one - end) for one in found), default=np.inf) for end in LOBES
        }
        yield row | ends


def of_lobes(now: list[Row], before: list[Row]) -> Iterator[tuple[str, bool | None]]:
    """All ends to .01 rad/s; the narrowest lobe's may be missing at the default step."""
    for name, rows in named(now, before):
        for number, row in enumerate(rows):
            met = [row[f"{end:.3f}"] <= 0.01 for end in LOBES]
            yield (
                f"{name}, {row['case']}: {sum(met)} of 6 ends to .01 rad/s in {row['s']:.1f} s",
                all(met if number else met[2:]),
            )


def breathing(quick: bool) -> Iterator[Row]:
    """The curve without and with verdicts."""
    plate = fc.reduce_structure(common.plate("breathing_plate", {"damping.ratio": 0.01}))
    law, span = fc.UnilateralPenalty(1e9), (1500.0, 1700.0 if quick else 4000.0)
    for stability in (False, True):
        started = time.process_time()
        curve = fc.continue_frequency(
            plate, *span, law, harmonics=7, stability=stability, throw=False
        )
        seconds = time.process_time() - started
        left = int(np.sum(curve.verdicts == "undecided")) if stability else "-"
        yield {"pairs": plate.n_pairs, "verdicts": stability, "points": len(curve),
               "undecided": left, "s": seconds, "status": curve.status}  # fmt: skip


def of_breathing(now: list[Row], before: list[Row]) -> Iterator[tuple[str, bool | None]]:
    """At most three times the curve without verdicts."""
    for name, rows in named(now, before):
        if rows:
            ratio = rows[1]["s"] / rows[0]["s"]
            yield f"{name}: {ratio:.1f} times the curve without verdicts (3)", ratio <= 3.0


MANY = {"mesh__lip_elements": 20, "reduction__modes": 60}


def many(quick: bool) -> Iterator[Row]:
    """Curves to a tolerance over the range of `new`."""
    cases = {"new": {}, "new, 40 modes": {"reduction__modes": 40}, "many pairs": MANY}
    if quick:
        del cases["many pairs"]
    for name, changes in cases.items():
        scene, structure, law = new(**changes)
        _, start, stop = scene.given("curve").followed
        row, _ = followed(name, structure, (start, stop), law)
        yield {"pairs": structure.n_pairs, "modes": structure.n_modes} | row


def of_many(now: list[Row], before: list[Row]) -> Iterator[tuple[str, bool | None]]:
    """`new` no slower, 40 pairs and 60 modes at most 2.5 times as slow."""
    for row, was in zip(now, before, strict=False):
        ratio, most = row["s"] / was["s"], 2.5 if row["case"] == "many pairs" else 1.0
        yield f"{row['case']}: {ratio:.2f} times as long as before ({most:g})", ratio <= most


# --- solutions ------------------------------------------------------------------------------------


def plates(count: int) -> Iterator[tuple[str, fc.Structure, float, Any]]:
    """Plates as `new` writes them: name, structure, frequency [rad/s], law."""
    rng = np.random.default_rng(1)
    for number in range(count):
        _, structure, law = new(
            crack__length=0.1 * float(rng.uniform(0.1, 0.45)),
            mesh__lip_elements=int(rng.integers(4, 14)),
            reduction__modes=int(rng.integers(12, 41)),
            damping__ratio=float(np.exp(rng.uniform(np.log(5e-4), np.log(1e-2)))),
        )
        first = fc.bilinear_frequencies(structure).omega_bilinear[0]
        share = rng.choice([1.0, 1.0 / 2.0, 1.0 / 3.0, rng.uniform(0.2, 3.0)])
        yield f"plate {number}", structure, float(share * first), law


def drawn_chains(first: int, count: int) -> Iterator[tuple[str, fc.Structure, float, Any]]:
    """Chains from a seed on, each at a frequency between the first two modes and somewhat beyond;
    from 7000 on with a stiff stop."""
    rng = np.random.default_rng(first)
    for seed in range(first, first + count):
        structure, law = random_chain(seed)
        if first == 7000:
            law = fc.UnilateralPenalty(float(10.0 ** rng.uniform(2.0, 4.0)))
        yield f"chain {seed}", structure, float(rng.uniform(*around(structure))), law


def population(quick: bool) -> Iterator[Row]:
    """One row for each system."""
    counts = (6, 6, 5) if quick else (60, 60, 50)
    groups = {
        "plates": plates(counts[0]), "chains": drawn_chains(5000, counts[1]),
        "stiff": drawn_chains(7000, counts[2]),
    }  # fmt: skip
    for group, systems in groups.items():
        for name, structure, omega, law in systems:
            started = time.process_time()
            found = fc.solve_harmonic_balance(
                structure, omega, law, tolerance=TOLERANCE, throw=False
            )
            verdict = fc.floquet(structure, found).verdict if found.converged else "-"
            seconds = time.process_time() - started
            yield {
                "group": group, "case": name, "omega": omega, "H": found.harmonics,
                "error": found.report.total, "orbit": is_orbit(found), "verdict": verdict,
                "s": seconds, "status": found.status,
            }  # fmt: skip


def is_orbit(found: fc.PeriodicSolution) -> bool:
    """Whether a solution is an exact orbit's, or one is its own."""
    judged = getattr(found, "judged", None)
    return found.orbit is not None if judged is None else bool(judged.accepted)


def of_population(now: list[Row], before: list[Row]) -> Iterator[tuple[str, bool | None]]:
    """All plates, 59 of 60 chains, 48 of 50 stiff ones."""
    for name, rows in named(now, before):
        for group, lacking in (("plates", 0), ("chains", 1), ("stiff", 2)):
            some = [row for row in rows if row["group"] == group]
            good = [r for r in some if r["orbit"] and r["verdict"] in ("stable", "unstable")]
            yield (
                f"{name}: {len(good)} of {len(some)} {group} have an orbit and a verdict, "
                f"{spent(some):.1f} s", len(good) >= len(some) - lacking,
            )  # fmt: skip


def independence(quick: bool) -> Iterator[Row]:
    """One row for each system and H: what differs between the ways of asking."""
    counts = (3, 3) if quick else (60, 50)
    rungs = 5, 10, 20, 40
    for first, count in zip((5000, 7000), counts, strict=True):
        ways: list[list[dict[int, tuple[float, str]]]] = []
        for way in ("error first", "verdict first", "after neighbours"):
            ways.append([
                {
                    harmonics: answer(structure, omega, law, harmonics, way)
                    for harmonics in (rungs if way == "error first" else rungs[::-1])
                }
                for _, structure, omega, law in drawn_chains(first, count)
            ])  # fmt: skip
        for number, answers in enumerate(zip(*ways, strict=True)):
            for harmonics in rungs:
                asked = [one[harmonics] for one in answers]
                errors = np.array([error for error, _ in asked])
                off = float(np.abs(errors / errors[0] - 1.0).max()) if errors[0] else 0.0
                yield {
                    "case": f"chain {first + number}", "H": harmonics, "error": errors[0],
                    "verdict": asked[0][1], "apart": off,
                    "other verdict": len({verdict for _, verdict in asked}) > 1,
                }  # fmt: skip


def answer(
    structure: fc.Structure, omega: float, law: Any, harmonics: int, way: str
) -> tuple[float, str]:
    """Error and verdict of a solution of which nothing is known yet."""
    solve = partial(fc.solve_harmonic_balance, structure, harmonics=harmonics, throw=False)
    for near in (0.99 * omega, 1.01 * omega) if way == "after neighbours" else ():
        fc.floquet(structure, solve(near, law))
    found = solve(omega, law)
    known = "assessment" if hasattr(found, "assessment") else "judged"
    nothing: dict[str, Any] = {known: None}
    found = replace(found, **nothing)
    if way == "verdict first":
        verdict = fc.floquet(structure, found).verdict
        return getattr(found, known).errors()[0], verdict
    return getattr(found, known).errors()[0], fc.floquet(structure, found).verdict


def of_independence(now: list[Row], before: list[Row]) -> Iterator[tuple[str, bool | None]]:
    """Nothing differs beyond rounding."""
    for name, rows in named(now, before):
        others = [row for row in rows if row["other verdict"] or not row["apart"] <= 1e-9]
        worst = max((row["apart"] for row in rows), default=0.0)
        yield f"{name}: {len(others)} of {len(rows)} differ, errors by {worst:.1e}", not others


# --- bifurcations ---------------------------------------------------------------------------------


def few_systems(count: int) -> Iterator[tuple[int, fc.Structure, Any]]:
    """Systems of 1 or 2 pairs."""
    rng, number = np.random.default_rng(SEED), 0
    while count:
        structure = draw(SEED, number, "curve").structure
        if structure.n_pairs <= 2 and structure.n_dofs <= 12:
            stiffness = np.exp(rng.uniform(np.log(0.5), np.log(1000.0))) / _modes(structure)[1]
            yield number, structure, fc.UnilateralPenalty(stiffness)
            count -= 1
        number += 1


SEED = 66
POINTS = 20_000
"""At most, of a curve."""
ALIKE = 1e-4
"""Of the frequency: up to which two bifurcations of one kind are the same."""


def few_pairs(quick: bool) -> Iterator[Row]:
    """One row for each period doubling and Neimark-Sacker point that is stated."""
    for number, structure, law in few_systems(12 if quick else 200):
        flow = ReferenceFlow(structure, law)
        for natural in np.sqrt(_modes(structure)[0][:2]):
            span = 0.9 * float(natural), 1.1 * float(natural)
            row, curve = followed(str(number), structure, span, law, most_points=POINTS)
            row |= {"_curve": True, "kind": "-", "omega": span[0], "off": np.nan}
            yield row
            for one in [] if curve is None else curve.bifurcations:
                if one.kind in ("period_doubling", "neimark_sacker"):
                    off = off_reference(flow, one)
                    yield {"case": str(number), "_curve": False, "kind": one.kind,
                           "omega": one.value, "off": off}  # fmt: skip


def off_reference(flow: ReferenceFlow, one: Any) -> float:
    """Distance from the unit circle, or from -1, of the multiplier that a bifurcation has there, on
    the reference's orbit; inf where it has none."""
    # The exact state: Newton's method may lead elsewhere from a solution to 1e-2.
    parts = np.split(one.orbit.state, 2)
    state = flow.state(*(one.orbit.flow.modes.shapes @ part for part in parts))
    try:
        orbit = flow.orbit(state, one.value, 2.0 * np.pi / one.value)
    except (NoOrbit, np.linalg.LinAlgError):
        return float("inf")
    values = orbit.multipliers
    if one.kind == "period_doubling":
        return float(np.abs(values + 1.0).min())
    return float(np.abs(np.abs(values[np.abs(values.imag) > 1e-9]) - 1.0).min(initial=np.inf))


def of_few_pairs(now: list[Row], before: list[Row]) -> Iterator[tuple[str, bool | None]]:
    """99 % of what is stated is right; 97 % of what is right and was stated is stated."""
    right: dict[str, list[Row]] = {}
    for name, rows in named(now, before):
        points = [row for row in rows if not row["_curve"]]
        curves = [row for row in rows if row["_curve"]]
        right[name] = [row for row in points if row["off"] <= 1e-3]
        ended = sum(row["at end"] for row in curves)
        yield (
            f"{name}: {ended} of {len(curves)} curves reach the end in {spent(curves):.0f} s, "
            f"{spent(curves, 'undecided'):.0f} of {spent(curves, 'points'):.0f} points undecided",
            None,
        )
        yield (
            f"{name}: the reference has {len(right[name])} of {len(points)} points stated",
            len(right[name]) >= 0.99 * len(points),
        )
    if before:
        again = [row for row in right["before"] if any(same(row, one) for one in now)]
        yield (
            f"{len(again)} of {len(right['before'])} that were right before are stated",
            len(again) >= 0.97 * len(right["before"]),
        )


def same(one: Row, other: Row) -> bool:
    """Whether two rows are the same bifurcation."""
    alike = all(one[key] == other[key] for key in ("case", "kind"))
    return alike and abs(one["omega"] / other["omega"] - 1.0) <= ALIKE


# --- between the points ---------------------------------------------------------------------------

STEP, FINER, CLOSE_TO, SOON = 0.05, 50, 1e-3, 2500
"""Default step, how many parts of it are examined, relative distance of two events that are one,
and maximum points of a curve."""


def lightly_damped(first: int, count: int) -> Iterator[tuple[str, fc.Structure, Span, Any]]:
    """Plates, from seed 1000 on chains: name, structure, range [rad/s], law."""
    for seed in range(first, first + count):
        rng = np.random.default_rng(seed)
        ratio = float(np.exp(rng.uniform(np.log(5e-4), np.log(1e-2))))
        if seed < 1000:
            _, structure, law = new(
                crack__length=0.1 * float(rng.uniform(0.15, 0.45)),
                mesh__lip_elements=int(rng.integers(4, 9)),
                reduction__modes=int(rng.integers(10, 25)),
                damping__ratio=ratio,
            )
            near = float(fc.bilinear_frequencies(structure).omega_bilinear[0])
        else:
            structure, law = random_chain(seed)
            ratio = 0.5 * float(structure.damping.ratio)
            structure = structure.varied(damping=0.5)
            near = float(fc.solve_modes(structure, 1).omega[0])
        near *= float(rng.choice([1.0, 1.0 / 2.0, 1.0 / 3.0, rng.uniform(0.3, 3.0)]))
        yield f"{seed}, {100.0 * ratio:.2g} %", structure, (0.85 * near, 1.15 * near), law


def between(quick: bool) -> Iterator[Row]:
    """One row for each curve."""
    for first in 100, 1100:
        for name, structure, span, law in lightly_damped(first, 1 if quick else 5):
            row, curve = followed(name, structure, span, law, most_points=SOON)
            yield row | ({} if curve is None else false_verdicts(curve, span))


def false_verdicts(curve: fc.ResponseCurve, span: Span) -> Row:
    """Share of a curve's way through its range with another verdict than the reference's, and the
    widest stretch of it, over the resolution and over the longest step taken."""
    flow, omega = ReferenceFlow(curve.structure, curve.contact), curve.values
    spacing, shapes = STEP * (span[1] - span[0]) / FINER, curve.orbit(0).flow.modes.shapes
    way = np.append(0.0, np.cumsum(np.abs(np.diff(omega))))
    met = np.arange(spacing, way[-1], spacing)
    folded = {curve.nearest(one) for one in curve.bifurcations if one.kind == "fold"}
    wrong, judged = np.zeros(len(met), dtype=bool), 0
    for number, at in enumerate(met):
        place = int(np.searchsorted(way, at)) - 1
        if {place, place + 1} & folded:  # two orbits, of which Newton's method may find the other
            continue
        share = (at - way[place]) / (way[place + 1] - way[place])
        value = float(omega[place] + share * (omega[place + 1] - omega[place]))
        state = (1.0 - share) * curve.points[place] + share * curve.points[place + 1]
        start = flow.state(*(shapes @ part for part in np.split(state, 2)))
        try:
            orbit = flow.orbit(start, value, curve.subharmonic * 2.0 * np.pi / value)
        except (NoOrbit, np.linalg.LinAlgError):
            continue
        judged += 1
        wrong[number] = (abs(orbit.multipliers[0]) < 1.0) != stated_stable(curve, place, value)
    stretches = "".join("x" if one else " " for one in wrong).split()
    widest = spacing * max(map(len, stretches), default=0)
    longest = float(np.abs(np.diff(omega)).max())
    return {
        "judged": judged, "of": len(met), "false": float(wrong.mean()),
        "widest/resolution": widest / getattr(curve, "resolution", np.nan),
        "resolution/longest": getattr(curve, "resolution", np.nan) / longest,
    }  # fmt: skip


def stated_stable(curve: fc.ResponseCurve, place: int, value: float) -> bool:
    """What a curve states of a value between two points: its verdict changes at the events."""
    ends = curve.values[place], curve.values[place + 1]
    events = [one.value for one in curve.bifurcations if one.kind != "fold"]
    inside = sorted(one for one in events if min(ends) < one < max(ends))
    if not inside:
        return bool(curve.stable[place])
    nearer = abs(value - ends[0]) < abs(inside[0] - ends[0])
    return bool(curve.stable[place if nearer else place + 1])


def of_between(now: list[Row], before: list[Row]) -> Iterator[tuple[str, bool | None]]:
    """At most .1 % of each range false, and no stretch wider than the resolution, which is at most
    a fifth of the longest step taken."""
    for name, rows in named(now, before):
        known = [row for row in rows if "false" in row]
        worst = max(row["false"] for row in known)
        yield f"{name}: {spent(known, 'judged'):.0f} of {spent(known, 'of'):.0f} judged", None
        yield f"{name}: at most {100.0 * worst:.2g} % of a range false", worst <= 1e-3
        wide = [row["widest/resolution"] for row in known]
        yield f"{name}: widest over the resolution {max(wide):.2g}", max(wide) <= 1.0
        share = max(row["resolution/longest"] for row in known)
        yield f"{name}: resolution over longest step {share:.2g}", share <= 0.2
        yield f"{name}: {spent(rows):.1f} s", None
    if before:
        yield f"{spent(now) / spent(before):.2f} times as long as before", None


def events(quick: bool) -> Iterator[Row]:
    """One row for each plate."""
    for name, structure, span, law in lightly_damped(200, 4 if quick else 34):
        row, curve = followed(name, structure, span, law, most_points=SOON)
        if curve is None or not curve.complete:
            continue
        fine = followed(name, structure, span, law, most_points=5 * SOON, longest_step=STEP / 5)
        if fine[1] is None or not fine[1].complete:
            continue
        known = curve.bifurcations
        missing = apart(fine[1].bifurcations, known)
        count = {"events": len(known) + len(missing), "missing": len(missing)}
        yield row | count | {"fine": fine[0]["s"]}


def apart(some: list[Any], others: list[Any]) -> list[Any]:
    """Those events that are none of the others."""
    left, lacking = list(others), []
    for one in some:
        alike = [
            other for other in left
            if other.kind == one.kind and abs(other.value / one.value - 1.0) <= CLOSE_TO
        ]  # fmt: skip
        if alike:
            left.remove(min(alike, key=lambda other: abs(other.value - one.value)))
        else:
            lacking.append(one)
    return lacking


def of_events(now: list[Row], before: list[Row]) -> Iterator[tuple[str, bool | None]]:
    """97 % of the events by the default step."""
    for name, rows in named(now, before):
        count, lacking = spent(rows, "events"), spent(rows, "missing")
        yield (
            f"{name}: {count - lacking:.0f} of {count:.0f} events on {len(rows)} curves",
            count >= 100 and lacking <= 0.03 * count,
        )
        yield (
            f"{name}: {spent(rows):.1f} s, with a fifth of the step {spent(rows, 'fine'):.1f}",
            None,
        )
    if before:
        yield f"{spent(now) / spent(before):.2f} times as long as before", None


# --- processes ------------------------------------------------------------------------------------

BY_SNES = """
import json, sys, petsc4py
petsc4py.init(["x", *sys.argv[2:]])
sys.path.insert(0, sys.argv[1])
import common
import fenics_crack as fc
plate = common.plate("paper_plate")
found = fc.solve_harmonic_balance(plate, 2000.0, fc.UnilateralPenalty(1e11), harmonics=5)
if plate.comm.rank == 0:
    gap = found.gap_coefficients.tolist()
    print(json.dumps({"converged": found.converged, "iterations": found.iterations, "gap": gap}))
"""


def snes(quick: bool) -> Iterator[Row]:
    """The same solution by the kernel, and by SNES, on one and two processes."""
    known = None
    for words in (["kernel"], ["SNES"], ["kernel", "mpirun"], ["SNES", "mpirun"]):
        command = ["mpirun", "-n", "2"] if "mpirun" in words else []
        command += [sys.executable, "-c", BY_SNES, str(HERE)]
        command += ["-crack_hb_snes_monitor"] if "SNES" in words else []
        output = subprocess.run(
            command, capture_output=True, text=True, check=True, env=os.environ | ENVIRONMENT
        ).stdout
        line = next(line for line in output.splitlines() if line.startswith("{"))
        converged, iterations, gap = json.loads(line).values()
        known = np.array(gap) if known is None else known
        off = float(np.linalg.norm(np.array(gap) - known) / np.linalg.norm(known))
        yield {"way": " ".join(words), "converged": converged, "iterations": iterations,
               "monitored": output.count("SNES Function norm"), "apart": off}  # fmt: skip


def of_snes(now: list[Row], before: list[Row]) -> Iterator[tuple[str, bool | None]]:
    """SNES prints its residuals, and both find the same to 1e-10."""
    for name, rows in named(now, before):
        for row in rows:
            prints = bool(row["monitored"]) == row["way"].startswith("SNES")
            good = row["converged"] and prints and row["apart"] <= 1e-10
            yield f"{name}: {row['way']}, apart {row['apart']:.1e}", good


NEW = {"identify": "--identify", "timing": "--timing"}
COMMANDS = {
    "sweep": ["{demos}/sweep.toml"],
    "grow": ["{demos}/growth.toml"],
    "identify": ["identify.toml", "identify_measured.csv"],
    "timing": ["timing.toml"],
    "campbell": ["{demos}/rotating_blade.toml", "--speeds", "0", "18000", "13"],
}
SWEPT_ERRORS = [f"{name}_error" for name in ("truncation", "sampling", "reduction")]


def demos(quick: bool) -> Iterator[Row]:
    """Numbers of the commands, each with the error that it states, relative."""
    program = Path(sys.executable).with_name("fenics-crack")
    for command, words in COMMANDS.items():
        if quick and command == "identify":
            continue
        with tempfile.TemporaryDirectory() as folder:
            run = partial(subprocess.run, cwd=folder, capture_output=True)
            if command in NEW:
                run([program, "new", f"{command}.toml", NEW[command]])
            began = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
            words = [word.format(demos=common.DEMOS) for word in words]
            run([program, command, *words, "--output", "out"])
            seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - began
            names, values, errors = numbers(command, Path(folder, "out"))
            text = Path(folder, "out", "sweep.csv").read_text() if command == "sweep" else ""
        kinds = ("stable", "unstable", "undecided")
        verdicts = ", ".join(f"{text.count(f',{kind},')} {kind}" for kind in kinds if text)
        yield {"command": command, "numbers": len(values), "verdicts": verdicts, "s": seconds,
               "_names": names, "_values": values, "_errors": errors}  # fmt: skip


def numbers(command: str, out: Path) -> tuple[list[str], list[float], list[float]]:
    """Names, values and relative errors, as a command states them."""
    if command == "identify":
        found = json.loads((out / "identify.json").read_text())
        low, high = found["intervals"]["crack.length"]
        value = found["estimate"]["crack.length"]
        return ["crack.length"], [value], [(high - low) / 4.0 / value]
    name = {"grow": "growth"}.get(command, command)
    with open(out / f"{name}.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    if command == "campbell":
        names = [f"mode {row['mode']} at {row['rpm']}" for row in rows]
        return names, [float(row["omega_bilinear [rad/s]"]) for row in rows], [1e-6] * len(rows)
    if command == "timing":
        values = [float(row["amplitude [m]"]) for row in rows]
        errors = [float(row["amplitude_error [m]"]) for row in rows]
        names = [f"amplitude {row['multiple']}" for row in rows]
        return names, values, [error / abs(v) for error, v in zip(errors, values, strict=True)]
    if command == "grow":  # the number of cycles: what the vibration alone leaves unknown of it
        names = [f"cycles to {row['crack_length [m]']}" for row in rows[1:]]
        return names, [float(row["cycles"]) for row in rows[1:]], [0.29] * len(names)
    names = [f"{row['crack.length [m]']} {row['excitation.omega [rad/s]']}" for row in rows]
    errors = [sum(float(row[name]) for name in SWEPT_ERRORS) for row in rows]
    return names, [float(row["response [m]"]) for row in rows], errors


def of_demos(now: list[Row], before: list[Row]) -> Iterator[tuple[str, bool | None]]:
    """All numbers as before, within the errors stated."""
    for row, was in zip(now, before, strict=False):
        same = row["_names"] == was["_names"]
        apart, beyond = [], []
        for k in range(len(row["_names"]) if same else 0):
            apart.append(abs(row["_values"][k] / was["_values"][k] - 1.0))
            if not apart[-1] <= row["_errors"][k] + was["_errors"][k] + 1e-9:
                beyond.append(f"{row['_names'][k]} by {apart[-1]:.1e}")
        yield (
            f"{row['command']}: {len(apart)} numbers, {len(beyond)} apart beyond what is stated, "
            f"largest difference {max(apart, default=np.nan):.1e}, "
            f"{row['s']:.1f} s (before {was['s']:.1f})", same and not beyond,
        )  # fmt: skip
        for one in beyond[:10]:
            yield f"{row['command']}: {one}", None


SECTIONS: dict[str, tuple[Measure, Report]] = {
    "chains": (chains, of_chains), "lobes": (lobes, of_lobes),
    "population": (population, of_population), "few_pairs": (few_pairs, of_few_pairs),
    "between": (between, of_between), "events": (events, of_events),
    "independence": (independence, of_independence), "breathing": (breathing, of_breathing),
    "many": (many, of_many), "snes": (snes, of_snes), "demos": (demos, of_demos),
}  # fmt: skip


if __name__ == "__main__":
    main()
