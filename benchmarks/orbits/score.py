"""Score programs against the benchmark of exact orbits.

Every file in ``adapters/`` is a program. It is asked in a process of its own, one for each case,
and gets nothing of the orbits. Where an adapter has REQUIREMENTS (of pip) or a SOURCE (a
repository and its commit) it runs in an environment of its own, which is made in ``environments/``
at the first run; ours and SciPy's run where this is run.

For each case the orbit nearest to the answer counts, shifted by periods of the load:

- error: root mean square of the difference of the gaps, with friction the tangential ones too, over
  that of what moves of them; second: likewise of the load's second harmonic;
- found: called a solution, with an error of at most 5 %;
- verdict: that of this orbit;
- wrong: called a solution, not found, and the error is above 1.5 times what is stated, if it is.

Medians of error, second and processor time are those of what was found.

    OMP_NUM_THREADS=1 python benchmarks/orbits/score.py [--programs NAME ...] [--cases NAME ...]
        [--seconds 120] [folder]

prints the table, writes ``scores.json``, and each answer that was wrong in the program's words.
"""

from __future__ import annotations

import argparse
import ast
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import check

HERE = Path(__file__).parent
FOUND, UNDERSTATED, ROUNDING = 0.05, 1.5, 1e-10
"""Largest error of what is found; the error over its statement that is still honest; the error to
which the references are stored."""


# --- environments ---------------------------------------------------------------------------------


def constants(adapter: Path) -> dict[str, Any]:
    """What an adapter states of its program: read, not run."""
    value_by_name: dict[str, Any] = {}
    for node in ast.parse(adapter.read_text()).body:
        if isinstance(node, ast.Assign):
            targets, values = node.targets[0], node.value
            is_tuple = isinstance(targets, ast.Tuple) and isinstance(values, ast.Tuple)
            names = targets.elts if isinstance(targets, ast.Tuple) else [targets]
            parts = values.elts if is_tuple and isinstance(values, ast.Tuple) else [values]
            for name, value in zip(names, parts, strict=False):
                if isinstance(name, ast.Name) and name.id in ("REQUIREMENTS", "SOURCE"):
                    value_by_name[name.id] = ast.literal_eval(value)
    return value_by_name


def python_of(adapter: Path) -> Path:
    """The Python of a program; its environment is made if it is not there."""
    adapter_constants = constants(adapter)
    if not adapter_constants:
        return Path(sys.executable)
    place = HERE / "environments" / adapter.stem
    python = place / "bin" / "python"
    if not python.exists():
        print(f"making {place}", flush=True)
        subprocess.run([sys.executable, "-m", "venv", str(place)], check=True)
        requirements = adapter_constants.get("REQUIREMENTS", ("numpy",))
        pip = [str(python), "-m", "pip", "install", "--quiet", *requirements]
        subprocess.run(pip, check=True)
        if "SOURCE" in adapter_constants:
            address, commit = adapter_constants["SOURCE"]
            subprocess.run(["git", "clone", "--quiet", address, str(place / "source")], check=True)
            checkout_command = ["git", "-C", str(place / "source"), "checkout", "--quiet", commit]
            subprocess.run(checkout_command, check=True)
            (packages,) = place.glob("lib/python*/site-packages")
            (packages / "source.pth").write_text(str(place / "source") + "\n")
    return python


def asked(
    adapter: Path, case: dict[str, Any], seconds: float, harmonics: int | None = None
) -> dict[str, Any]:
    """What a program answers to a case, with its own number of harmonics or another one."""
    case_parts = {name: case[name] for name in ("name", "structure", "load", "law", "clearance")}
    command = [str(python_of(adapter)), str(HERE / "worker.py"), str(adapter.absolute())]
    command += [] if harmonics is None else [str(harmonics)]
    with tempfile.TemporaryDirectory() as folder:  # some programs write where they run
        try:
            process = subprocess.run(
                command, input=json.dumps(case_parts), capture_output=True, text=True, cwd=folder,
                timeout=seconds, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return {"gap": None, "converged": False, "message": f"no answer in {seconds:g} s"}
    if process.returncode:
        last_line = process.stderr.strip().splitlines()[-1:] or ["no word"]
        return {"gap": None, "converged": False, "message": last_line[0]}
    return dict(json.loads(process.stdout))


# --- scores ---------------------------------------------------------------------------------------


def shifted(gap: np.ndarray, share: float) -> np.ndarray:
    """A periodic motion later by a share of its period."""
    waves = np.fft.rfft(gap, axis=0)
    turned_waves = waves * np.exp(2j * np.pi * share * np.arange(len(waves)))[:, None]
    return np.fft.irfft(turned_waves, len(gap), axis=0) if share else gap


def second(gap: np.ndarray, periods: int) -> np.ndarray:
    """Amplitudes of the load's second harmonic."""
    return np.asarray(np.sqrt(2.0) * np.abs(np.fft.rfft(gap, axis=0)[2 * periods]))


def whole(motion: dict[str, Any], *names: str, stuck: list[int]) -> np.ndarray | None:
    """Gaps beside tangential ones, where there are such: (256, p or 2p); those that stick by what
    moves of them."""
    if any(motion.get(name) is None for name in names):
        return None
    parts = [np.array(motion[name]) for name in names]
    if len(parts) > 1:
        parts[1][:, stuck] -= parts[1][:, stuck].mean(axis=0)
    return np.hstack(parts)


def scored(case: dict[str, Any], answer: dict[str, Any]) -> dict[str, Any]:
    """The answer against the nearest orbit of a case."""
    if "unsupported" in answer:
        return {"case": case["name"], "unsupported": answer["unsupported"]}
    answer_parts = {name: answer.get(name) for name in ("message", "seconds", "verdict", "version")}
    row = {"case": case["name"], "stated": answer.get("error"), "claimed": answer["converged"],
           "error": np.inf, "second": np.inf, "true verdict": None, **answer_parts}  # fmt: skip
    friction = case["law"]["kind"] == "friction"
    for orbit in case["orbits"]:
        periods, stuck = orbit["subharmonic"], orbit.get("stuck", [])
        own_waves = whole(answer, *("gap", "tangential")[: 1 + friction], stuck=stuck)
        true_waves = whole(orbit, *check.GAPS[: 1 + friction], stuck=stuck)
        if own_waves is None or true_waves is None or periods != answer["periods"]:
            continue
        if own_waves.shape != true_waves.shape:
            row["message"] = f"gaps of shape {own_waves.shape}, not {true_waves.shape}"
            continue
        size = np.linalg.norm(true_waves - true_waves.mean(axis=0))
        for turn in range(periods):
            shifted_waves = shifted(true_waves, turn / periods)
            error = float(np.linalg.norm(own_waves - shifted_waves) / size)
            if error < row["error"]:
                change = second(own_waves, periods) - second(shifted_waves, periods)
                row |= {"error": error, "second": float(np.linalg.norm(change) / size),
                        "true verdict": orbit["verdict"]}  # fmt: skip
    row["found"] = bool(row["claimed"] and row["error"] <= FOUND)
    stated_error = row["stated"]
    is_honest = stated_error is not None and row["error"] <= max(
        UNDERSTATED * stated_error, ROUNDING
    )
    row["honest"] = bool(not row["claimed"] or row["found"] or is_honest)
    row["within"] = None if stated_error is None or not row["claimed"] else bool(is_honest)
    row["right"] = (
        row["verdict"] == row["true verdict"] if row["verdict"] and row["found"] else None
    )
    return row


def share(values: list[Any]) -> str:
    """How many of those that are known are true."""
    known_verdicts = [value for value in values if value is not None]
    return f"{sum(known_verdicts)} of {len(known_verdicts)}" if known_verdicts else "-"


def line(name: str, rows: list[dict[str, Any]]) -> list[str]:
    """The row of a program in the table."""
    tried_rows = [row for row in rows if "unsupported" not in row]
    found_rows = [row for row in tried_rows if row["found"]]
    numbers = [np.median([row[key] for row in found_rows]) if found_rows else np.nan
               for key in ("error", "second", "seconds")]  # fmt: skip
    versions = {row["version"] for row in tried_rows if row.get("version")}
    return [
        name, ", ".join(sorted(versions)), str(len(tried_rows)), str(len(found_rows)),
        *(f"{number:.1e}" for number in numbers[:2]), share([row["within"] for row in tried_rows]),
        share([row["right"] for row in tried_rows]),
        str(sum(not row["honest"] for row in tried_rows)), f"{1e3 * numbers[2]:.3g}",
    ]  # fmt: skip


COLUMNS = ("program", "version", "tried", "found", "error", "second", "within its statement",
           "verdict right", "wrong, called solved", "ms")  # fmt: skip


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    programs = sorted(path.stem for path in (HERE / "adapters").glob("*.py"))
    parser.add_argument("folder", nargs="?", type=Path, default=Path("output/scores"))
    parser.add_argument("--programs", nargs="+", default=programs, choices=programs)
    parser.add_argument("--cases", nargs="+", help="names; default: all")
    parser.add_argument("--seconds", type=float, default=120.0, help="of clock time for each case")
    arguments = parser.parse_args()
    files = {path.stem: path for path in sorted((HERE / "cases").glob("*.json"))}
    if unknown := set(arguments.cases or ()) - set(files):
        parser.error(f"cases {', '.join(sorted(unknown))}: allowed are {', '.join(files)}")
    cases = [check.read(files[name]) for name in arguments.cases or files]
    arguments.folder.mkdir(parents=True, exist_ok=True)
    table, all_rows = [], {}
    for name in arguments.programs:
        adapter = HERE / "adapters" / f"{name}.py"
        rows = [scored(case, asked(adapter, case, arguments.seconds)) for case in cases]
        all_rows[name] = rows
        table.append(line(name, rows))
        (arguments.folder / "scores.json").write_text(json.dumps(all_rows, indent=1) + "\n")
        print("| " + " | ".join(table[-1]) + " |", flush=True)
    print("\n| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS))
    print(*("| " + " | ".join(one) + " |" for one in table), sep="\n")
    for name, rows in all_rows.items():
        for row in rows:
            if "unsupported" not in row and not (row["found"] and row["honest"]):
                word = "not found" if row["honest"] else "WRONG"
                message = row["message"].partition("\n")[0][:110]
                print(f"{name}, {row['case']}: {word}, error {row['error']:.2g}: {message}")


if __name__ == "__main__":
    main()
