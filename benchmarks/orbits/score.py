"""Score programs against the benchmark of exact orbits.

Every file in ``adapters/`` is a program. It is asked in a process of its own, one for each case,
and gets nothing of the orbits. Where an adapter has REQUIREMENTS (of pip) or a SOURCE (a
repository and its commit) it runs in an environment of its own, which is made in ``environments/``
at the first run; ours and SciPy's run where this is run.

For each case the orbit nearest to the answer counts, shifted by periods of the load:

- found: the gaps are within 5 % of their motion, all instants and pairs;
- error, second: the difference of the gaps and of the largest second harmonic, over the motion;
- verdict: that of this orbit;
- honest: found; or not called a solution; or the stated error is at least two thirds of the error.

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
FOUND, UNDERSTATED = 0.05, 1.5
"""Largest error of what is found; the error over its statement that is still honest."""


# --- environments ---------------------------------------------------------------------------------


def constants(adapter: Path) -> dict[str, Any]:
    """What an adapter states of its program: read, not run."""
    found: dict[str, Any] = {}
    for node in ast.parse(adapter.read_text()).body:
        if isinstance(node, ast.Assign):
            targets, values = node.targets[0], node.value
            several = isinstance(targets, ast.Tuple) and isinstance(values, ast.Tuple)
            names = targets.elts if isinstance(targets, ast.Tuple) else [targets]
            parts = values.elts if several and isinstance(values, ast.Tuple) else [values]
            for name, value in zip(names, parts, strict=False):
                if isinstance(name, ast.Name) and name.id in ("REQUIREMENTS", "SOURCE"):
                    found[name.id] = ast.literal_eval(value)
    return found


def python_of(adapter: Path) -> Path:
    """The Python of a program; its environment is made if it is not there."""
    stated = constants(adapter)
    if not stated:
        return Path(sys.executable)
    place = HERE / "environments" / adapter.stem
    python = place / "bin" / "python"
    if not python.exists():
        print(f"making {place}", flush=True)
        subprocess.run([sys.executable, "-m", "venv", str(place)], check=True)
        pip = [str(python), "-m", "pip", "install", "--quiet", *stated["REQUIREMENTS"]]
        subprocess.run(pip, check=True)
        if "SOURCE" in stated:
            address, commit = stated["SOURCE"]
            subprocess.run(["git", "clone", "--quiet", address, str(place / "source")], check=True)
            at = ["git", "-C", str(place / "source"), "checkout", "--quiet", commit]
            subprocess.run(at, check=True)
            (packages,) = place.glob("lib/python*/site-packages")
            (packages / "source.pth").write_text(str(place / "source") + "\n")
    return python


def asked(adapter: Path, case: dict[str, Any], seconds: float) -> dict[str, Any]:
    """What a program answers to a case."""
    given = {name: case[name] for name in ("name", "structure", "load", "law", "clearance")}
    command = [str(python_of(adapter)), str(HERE / "worker.py"), str(adapter.absolute())]
    with tempfile.TemporaryDirectory() as folder:  # some programs write where they run
        try:
            ended = subprocess.run(
                command, input=json.dumps(given), capture_output=True, text=True, cwd=folder,
                timeout=seconds, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            return {"gap": None, "converged": False, "message": f"no answer in {seconds:g} s"}
    if ended.returncode:
        last = ended.stderr.strip().splitlines()[-1:] or ["no word"]
        return {"gap": None, "converged": False, "message": last[0]}
    return dict(json.loads(ended.stdout))


# --- scores ---------------------------------------------------------------------------------------


def shifted(gap: np.ndarray, share: float) -> np.ndarray:
    """A periodic motion later by a share of its period."""
    waves = np.fft.rfft(gap, axis=0)
    turned = waves * np.exp(2j * np.pi * share * np.arange(len(waves)))[:, None]
    return np.fft.irfft(turned, len(gap), axis=0) if share else gap


def second(gap: np.ndarray, periods: int) -> np.ndarray:
    """Amplitudes of the load's second harmonic."""
    return np.asarray(2.0 * np.abs(np.fft.rfft(gap, axis=0)[2 * periods]) / len(gap))


def scored(case: dict[str, Any], answer: dict[str, Any]) -> dict[str, Any]:
    """The answer against the nearest orbit of a case."""
    if "unsupported" in answer:
        return {"case": case["name"], "unsupported": answer["unsupported"]}
    kept = {name: answer.get(name) for name in ("message", "seconds", "verdict", "version")}
    row = {"case": case["name"], "stated": answer.get("error"), "claimed": answer["converged"],
           "error": np.inf, "second": np.inf, "true verdict": None, **kept}  # fmt: skip
    if answer.get("gap") is not None:
        gap = np.array(answer["gap"])
        for orbit in case["orbits"]:
            true, periods = np.array(orbit["gap"]), orbit["subharmonic"]
            if periods != answer["periods"] or true.shape != gap.shape:
                continue
            for turn in range(periods):
                here, size = shifted(true, turn / periods), np.ptp(true, axis=0).max()
                error = float(np.abs(gap - here).max() / size)
                if error < row["error"]:
                    change = np.abs(second(gap, periods) - second(here, periods)).max() / size
                    row |= {"error": error, "second": float(change)}
                    row["true verdict"] = orbit["verdict"]
    row["found"] = bool(row["claimed"] and row["error"] <= FOUND)
    stated = row["stated"]
    said = stated is not None and row["error"] <= UNDERSTATED * stated
    row["honest"] = bool(not row["claimed"] or row["found"] or said)
    row["within"] = None if stated is None or not row["claimed"] else bool(said)
    row["right"] = row["verdict"] == row["true verdict"] if row["verdict"] and row["found"] else None
    return row


def share(values: list[Any]) -> str:
    """How many of those that are known are true."""
    known = [value for value in values if value is not None]
    return f"{sum(known)} of {len(known)}" if known else "-"


def line(name: str, rows: list[dict[str, Any]]) -> list[str]:
    """The row of a program in the table."""
    tried = [row for row in rows if "unsupported" not in row]
    found = [row for row in tried if row["found"]]
    numbers = [np.median([row[key] for row in found]) if found else np.nan
               for key in ("error", "second", "seconds")]  # fmt: skip
    versions = {row["version"] for row in tried if row.get("version")}
    return [
        name, ", ".join(sorted(versions)), str(len(tried)), str(len(found)),
        *(f"{number:.1e}" for number in numbers[:2]), share([row["within"] for row in tried]),
        share([row["right"] for row in tried]),
        str(sum(not row["honest"] for row in tried)), f"{1e3 * numbers[2]:.3g}",
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
    given = parser.parse_args()
    files = sorted((HERE / "cases").glob("*.json"))
    cases = [check.read(path) for path in files if not given.cases or path.stem in given.cases]
    given.folder.mkdir(parents=True, exist_ok=True)
    table, every = [], {}
    for name in given.programs:
        adapter = HERE / "adapters" / f"{name}.py"
        rows = [scored(case, asked(adapter, case, given.seconds)) for case in cases]
        every[name] = rows
        table.append(line(name, rows))
        (given.folder / "scores.json").write_text(json.dumps(every, indent=1) + "\n")
        print("| " + " | ".join(table[-1]) + " |", flush=True)
    print("\n| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS))
    print(*("| " + " | ".join(one) + " |" for one in table), sep="\n")
    for name, rows in every.items():
        for row in rows:
            if "unsupported" not in row and not (row["found"] and row["honest"]):
                word = "not found" if row["honest"] else "WRONG"
                print(f"{name}, {row['case']}: {word}, error {row['error']:.2g}: {row['message']}")


if __name__ == "__main__":
    main()
