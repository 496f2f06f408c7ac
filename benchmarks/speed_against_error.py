"""Speed against error: what the command ``solve`` answers, how far off it is, and what it costs.

Five demos, each as its scene says, and to 10 %, 1 % and .1 % (``harmonic_balance.tolerance``; then
the tolerance chooses the modes, and mesh and friction are left as they are). Each row is one run of
the command in a process of its own, from the mesh to errors and verdict: the amplitude, its stated
error and the largest cause of it, the true error, processor time, and memory.

The true error is the distance from a reference: an exact periodic orbit, which has no error by
harmonics, or, where none can be found, the solution to .1 % or the best one; sought from the
scene's solution, with more modes (:data:`REFERENCE_MODES`), or with all where it has few dofs.
Where a row states an error of the mesh, elements of the reference are three times shorter, with a
stiffness of each pair three times smaller; where it states one of friction that the scene leaves
out, the reference has that friction. Both are left out where such a reference cannot be solved
(:data:`FIXED_MESH_DEMOS`). An answer that misses its tolerance is "not reached", with what the
program says would help; so is a row without an answer in ten minutes of processor time.

Rows are kept in ``docs/pictures/speed_against_error.json``, each with its commit and day; the
tables of ``README.md`` and ``benchmarks/README.md`` and the picture are made from it.

    OMP_NUM_THREADS=1 python benchmarks/speed_against_error.py [--quick] [--only DEMO]
        [--rows RUNG,RUNG] [folder]

``--quick`` leaves out .1 %; ``--rows scene,1%`` runs these rungs alone.
"""

from __future__ import annotations

import datetime
import json
import os
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import common

import fenics_crack as fc
from fenics_crack.draw.figure import CURVE_COLOUR_CODE_BY_NAME
from fenics_crack.study.meshes import refine_scene_or_none

ROOT = Path(__file__).parents[1]
RECORD = ROOT / "docs" / "pictures" / "speed_against_error.json"
DEMOS = ("paper_plate", "breathing_plate", "blade", "friction", "solid_blade")
RUNGS = {"scene": None, "10%": 0.1, "1%": 0.01, "0.1%": 0.001}
"""By name: the tolerance, None for the settings of the scene."""
REFERENCE_MODES = {
    "breathing_plate": (200,), "blade": (80,), "friction": (40, 80, 160), "solid_blade": (80,),
}  # fmt: skip
"""Four times those of the scene or more, and those up to which orbits are followed for tolerances
that choose more; the paper's plate has all of its 50."""
FIXED_MESH_DEMOS = ("breathing_plate",)
"""Demos whose reference has the scene's mesh and friction: on a finer mesh they have 54 pairs."""
REFERENCE_ERROR = 1e-3
"""By harmonics, where no orbit can be found."""
PATIENCE = 600
"""Processor time [s] after which a row ends without an answer."""
MESH_REFINEMENT = 3.0
"""Elements of the scene over those of the reference."""
MARKS = "<!-- speed against error -->\n", "<!-- end -->\n"
"""Around the tables of the pages."""
Row = dict[str, Any]


def main() -> None:
    """Run the rows asked for, and make tables and picture of all that are kept."""
    common.run(
        __doc__,
        {name: ladder(name) for name in DEMOS},
        rows={"help": f"rungs, with commas between: {', '.join(RUNGS)}"},
    )


def ladder(demo: str) -> common.Part:
    """A part of the benchmark: the rungs of a demo."""

    def run(arguments: common.Arguments) -> None:
        rungs = arguments.rows.split(",") if arguments.rows else list(RUNGS)
        if arguments.quick and not arguments.rows:
            rungs.remove("0.1%")
        references: dict[Any, float] = {}
        for rung in rungs:
            row = run_rung(demo, rung, references)
            keep(row)
            print(" | ".join(cells(row)), flush=True)
        rows = kept_rows()
        write_tables(rows)
        draw(rows).savefig(RECORD.with_suffix(".png"))

    return run


# --- rows -----------------------------------------------------------------------------------------


CAUSES_LEFT_OUT = {"mesh.error": False, "contact.friction_error": False}
"""Keys by which neither the mesh nor friction is varied."""


def changes_of(rung: str) -> dict[str, Any]:
    """Return the keys of the scene that a rung changes."""
    if RUNGS[rung] is None:
        return {}
    return {"harmonic_balance.tolerance": RUNGS[rung], "reduction": None} | CAUSES_LEFT_OUT


def run_rung(demo: str, rung: str, references: dict[Any, float]) -> Row:
    """Run the command for a rung of a demo, and compare its answer with the reference."""
    row = answer(demo, rung)
    if row["amplitude [m]"] is None:
        return row | {"true": None}
    modes = REFERENCE_MODES.get(demo, ())
    key = row["mesh"], row["friction"], modes
    if key not in references:
        references[key] = reference(demo, *key)
    row["reference [m]"] = references[key]
    row["true"] = abs(row["amplitude [m]"] / references[key] - 1.0)
    return row


MEMORY_PROGRAM = """
import resource, subprocess, sys
code = subprocess.call(sys.argv[1:], stdout=subprocess.DEVNULL)
print(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss)
sys.exit(code)
"""
"""Small program that runs a command, and prints its memory [KiB].

The memory of a process is at least that of the process which forks it, here a large one.
"""


def answer(demo: str, rung: str) -> Row:
    """Run ``solve`` in a process of its own; what it states, its time [s], its memory [MiB]."""
    settings = [
        f"--set={key}={str(value).lower()}" for key, value in changes_of(rung).items()
    ]  # None is "none"
    with tempfile.TemporaryDirectory() as output:
        folder = Path(output) / demo
        command = [sys.executable, "-c", MEMORY_PROGRAM, sys.executable, "-m", "fenics_crack",
                   "solve", f"demos/{demo}.toml", "--output", str(folder), *settings]  # fmt: skip
        log = Path(output) / "log"
        with log.open("w") as errors:
            child = subprocess.Popen(
                command, cwd=ROOT, stdout=subprocess.PIPE, stderr=errors, preexec_fn=limit_time
            )
        assert child.stdout is not None
        kibibytes = int(child.stdout.read())
        _, code, usage = os.wait4(child.pid, 0)
        results = sorted(folder.rglob("solution.json"))
        messages = log.read_text()
        quantities = json.loads(results[0].read_text()) if results else []
    seconds = usage.ru_utime + usage.ru_stime
    if not results and seconds < PATIENCE:
        raise RuntimeError(f"{' '.join(command)} ended with {code}: {messages}")
    statements = statements_of(demo, rung, quantities, messages) if results else NO_ANSWER
    return {
        "demo": demo, "rung": rung, **statements,
        "seconds": seconds,
        "mebibytes": kibibytes / 1024.0,
        "commit": common.commit(),
        "date": str(datetime.date.today()),
    }  # fmt: skip


def limit_time() -> None:
    """Limit the processor time of a process."""
    resource.setrlimit(resource.RLIMIT_CPU, (PATIENCE, PATIENCE))


NO_ANSWER = {
    "amplitude [m]": None, "stated": None, "most by": "", "verdict": "",
    "missed": f"no answer within {PATIENCE} s of processor time", "mesh": False, "friction": False,
}  # fmt: skip
"""Statements of a row that ends without an answer."""


def statements_of(demo: str, rung: str, quantities: list[Row], messages: str) -> Row:
    """Return what a run states, by its quantities and its messages."""
    values = {quantity["name"]: quantity["value"] for quantity in quantities}
    amplitude = next(entry for entry in quantities if entry["name"].endswith("amplitude"))
    helps = re.search(r"error ([^,;]+), [^,;]+ was requested; what helps: ([^;(]*[^;( ])", messages)
    conclusion, error = values["conclusion"], amplitude["error [%]"]
    is_varied = rung == "scene" and demo not in FIXED_MESH_DEMOS
    return {
        "amplitude [m]": amplitude["value"],
        "stated": None if error is None else error / 100.0,
        "most by": amplitude["most by"],
        "verdict": values.get("verdict", ""),
        "missed": f"error of the gap {helps[1]}, helps: {helps[2]}" if helps else "",
        "mesh": is_varied and error is not None and "mesh" not in left_out(conclusion),
        "friction": is_varied and "friction left out: it would change" in conclusion,
    }


def left_out(conclusion: str) -> str:
    """Return what a conclusion says of the causes that its error does not include."""
    return "".join(re.findall(r"error (due to [^;:]*) not included", conclusion))


def reference(demo: str, mesh: bool, friction: bool, modes: tuple[int, ...]) -> float:
    """Return the amplitude [m] of the reference of a demo, by the watched displacement.

    On the scene's own mesh the orbit is sought from the solution of the scene, and from there with
    more and more modes.
    """
    scene = fc.Scene.load(common.DEMOS / f"{demo}.toml")
    assert scene.contact is not None
    changes: dict[str, Any] = {}
    if friction:
        changes["contact.friction"] = scene.contact.friction_error
    scene = scene.replace({"sweep": None, "curve": None} | CAUSES_LEFT_OUT)
    if scene.crack is not None and scene.crack.first_omega is not None:
        length = fc.find_crack_length(scene)
        scene = scene.replace({"crack.length": length, "crack.first_omega": None})
    if modes:
        changes["reduction.modes"] = modes[0]
    fine_scene = refine_scene_or_none(scene, MESH_REFINEMENT) if mesh else None
    if (
        fine_scene is not None
        and fine_scene.contact is not None
        and fine_scene.contact.stiffness is not None
    ):
        changes["contact.stiffness"] = fine_scene.contact.stiffness / MESH_REFINEMENT
    if friction and scene.contact.stiffness is not None:  # as stiff along the faces as across
        areas = fc.prepare(scene).structure.pairs.areas
        stiffness = scene.contact.stiffness / float(areas.mean())
        changes["contact.tangential_stiffness_per_area"] = stiffness
    if fine_scene is not None or friction:
        accurate = {"harmonic_balance.tolerance": REFERENCE_ERROR}
        run = fc.solve((fine_scene or scene).replace(changes | accurate))
        solution, dof = run.result, run.watched[0].dof
    else:
        study, initial = fc.prepare(scene.replace(changes)), fc.solve(scene).result
        assert study.contact is not None
        solution = fc.solve_harmonic_balance(
            study.structure, initial.omega, study.contact, tolerance=REFERENCE_ERROR,
            initial=initial, throw=False,
        )  # fmt: skip
        dof = study.watched[0].dof
    motion = solution.orbit or solution
    for count in modes[1:]:
        study = fc.prepare(scene.replace({"reduction.modes": count}))
        motion, dof = common.with_more_modes(motion, study), study.watched[0].dof
    return float(motion.amplitude(dof))


# --- what is kept of them -------------------------------------------------------------------------


def kept_rows() -> list[Row]:
    """Return all rows that are kept, in the order of demos and rungs."""
    rows = json.loads(RECORD.read_text()) if RECORD.exists() else []
    order = {pair: n for n, pair in enumerate((d, r) for d in DEMOS for r in RUNGS)}
    return sorted(rows, key=lambda row: order[row["demo"], row["rung"]])


def keep(row: Row) -> None:
    """Keep a row in place of the one before."""
    other_rows = [kept_row for kept_row in kept_rows() if key_of(kept_row) != key_of(row)]
    RECORD.write_text(json.dumps([*other_rows, row], indent=1) + "\n")


def key_of(row: Row) -> tuple[str, str]:
    """A demo and a rung."""
    return row["demo"], row["rung"]


def commits_of(rows: list[Row]) -> str:
    """By which commits and when rows were made."""
    return "; ".join(sorted({f"commit {row['commit']}, {row['date']}" for row in rows}))


def percentage(share: float | None) -> str:
    """An error in a table."""
    if share is None:
        return "-"
    return f"{100.0 * share:.2g} %" if share > 5e-7 else "< 0.0001 %"


def reason_of_miss(row: Row) -> str:
    """Say why a row misses its level, of the gap or of the amplitude; "" where it does not."""
    goal, stated_error = RUNGS[row["rung"]], row["stated"]
    if row["missed"] or goal is None or (stated_error is not None and stated_error <= goal):
        return str(row["missed"])
    return (
        "no error is stated" if stated_error is None else "the error of the amplitude is above it"
    )


def cells(row: Row) -> list[str]:
    """Cells of a row: demo, rung, amplitude, stated and true error, ratio, time, memory, remark."""
    stated_error, true_error, reason = row["stated"], row["true"], reason_of_miss(row)
    cause = f", mostly {row['most by']}" if stated_error else ""
    size = "" if row["amplitude [m]"] is None else f"{1e6 * row['amplitude [m]']:.4g} um"
    prefix = "not reached: " if reason and size else "not reached" if reason else ""
    ratio = f"{true_error / stated_error:.2f}" if stated_error and stated_error > 5e-7 else "-"
    return [
        f"`{row['demo']}.toml`", row["rung"].replace("%", " %").replace("scene", "as it says"),
        f"{prefix}{size}",
        "not stated" if size and stated_error is None else percentage(stated_error) + cause,
        percentage(true_error), ratio, f"{row['seconds']:.1f} s", f"{row['mebibytes']:.0f} MiB",
        "; ".join(part for part in (row["verdict"], reason) if part),
    ]  # fmt: skip


HEADINGS = ["stated error", "true error", "true / stated", "processor time", "memory", "remark"]


def whole_table(rows: list[Row]) -> str:
    """The ladder of ``benchmarks/README.md``."""
    head = ["`solve demos/...`", f"settings ({commits_of(rows)})", "amplitude", *HEADINGS]
    return lines_of([head, ["---"] * len(head), *map(cells, rows)])


def short_table(rows: list[Row]) -> str:
    """README's five rows: as the scene says, and to 1 %."""
    head = [
        f"`solve demos/...` ({commits_of([row for row in rows if row['rung'] in ('scene', '1%')])})"
    ]
    for words in ("as the scene says", "to 1 %"):
        head += [f"{words}: amplitude", "stated error", "true error", "time, memory"]
    lines = [head, ["---"] * len(head)]
    by_key = {key_of(row): row for row in rows}
    for demo in DEMOS:
        line = [f"`{demo}.toml`"]
        for rung in ("scene", "1%"):
            cell = cells(by_key[demo, rung])
            line += [*cell[2:5], ", ".join(cell[6:8])]
        lines.append(line)
    return lines_of(lines)


def lines_of(table: list[list[str]]) -> str:
    """A table in Markdown."""
    return "\n".join("| " + " | ".join(line) + " |" for line in table) + "\n"


def tables(rows: list[Row]) -> dict[Path, str]:
    """The table of each page."""
    return {
        ROOT / "README.md": short_table(rows),
        ROOT / "benchmarks" / "README.md": whole_table(rows),
    }


def page_with_table(page: Path, table: str) -> str:
    """The text of a page with a table between the marks."""
    head, _, rest = page.read_text().partition(MARKS[0])
    return f"{head}{MARKS[0]}\n{table}\n{MARKS[1]}{rest.partition(MARKS[1])[2]}"


def write_tables(rows: list[Row]) -> None:
    """Write the tables into their pages."""
    for page, table in tables(rows).items():
        page.write_text(page_with_table(page, table))


def draw(rows: list[Row]) -> Any:
    """Draw stated and true errors over processor time, a panel for each demo."""
    figure, axes = common.figure(3, 2)
    for panel, demo in zip(axes, DEMOS, strict=False):
        steps = [row for row in rows if row["demo"] == demo]
        for name, colour, look in (("stated", "blue", "o-"), ("true", "orange", "x--")):
            points = [row for row in steps if row[name] is not None]
            panel.semilogy(
                [row["seconds"] for row in points],
                [max(row[name], 1e-6) for row in points],
                look, color=CURVE_COLOUR_CODE_BY_NAME[colour], label=f"{name} error",
            )  # fmt: skip
        for row in steps:
            place = row["seconds"], max(row["true"] or 0.0, 1e-6)
            panel.annotate(row["rung"], place, fontsize=8)
        panel.set(title=demo, xlabel="processor time [s]", ylabel="error of the amplitude [-]")
        panel.legend(fontsize=8)
    axes[-1].remove()
    figure.suptitle(f"Speed against error ({commits_of(rows)})", fontsize=9)
    return figure


if __name__ == "__main__":
    main()
