"""What the program promises of solutions and curves: its words, files and exit codes."""

import json
from pathlib import Path

import judged
import numpy as np
import pytest
from judged import NEW
from surroundings import RunCommand, main

import fenics_crack as fc


def test_solution(tmp_path: Path, run_command: RunCommand) -> None:
    """Solved to the tolerance of the scene; what is printed, written and read again is one answer,
    and next to its exact orbit."""
    output = run_command("solve", NEW, "--output", tmp_path).out
    report = json.loads((tmp_path / "solution.json").read_text())
    solution = fc.load_run(tmp_path / "solution.h5").result
    assert isinstance(solution, fc.PeriodicSolution) and solution.converged
    assert solution.report.total < 1e-2 and judged.true_error(solution) < 1e-2
    assert solution.stability is not None and solution.stability.verdict in output
    exact = np.abs(judged.orbit_of(solution).multipliers[0])
    assert solution.stability.verdict == ("stable" if exact < 1.0 else "unstable")
    text = json.dumps(report)
    assert solution.stability.verdict in text and f"{solution.harmonics}" in text


def test_curve(tmp_path: Path) -> None:
    """Of a plate with four pairs: from start to stop, with verdicts; read again the same."""
    words = ["reduction.modes=8", "harmonic_balance.harmonics=5", "mesh.lip_elements=2"]
    words += ["harmonic_balance.tolerance=none", "curve.start=820.0", "curve.stop=850.0"]
    options = [part for word in words for part in ("--set", word)]
    assert main(["curve", str(NEW), "--output", str(tmp_path), "--quiet", *options]) == 0
    curve = fc.load_run(tmp_path / "curve.h5").result
    assert isinstance(curve, fc.ResponseCurve) and curve.complete
    assert curve.omega[[0, -1]] / (2.0 * np.pi) == pytest.approx([820.0, 850.0])
    assert set(curve.verdicts.tolist()) <= {"stable", "unstable", "undecided"}


@pytest.mark.parametrize(
    ("change", "code", "words"),
    [
        ("harmonic_balance.tolerance=-1", 2, "harmonic_balance.tolerance"),
        ("harmonic_balance.harmonics=0", 2, "harmonic_balance.harmonics"),
        ("contact.law=glue", 2, "contact.law"),
        ("harmonic_balance.tolerance=1e-3", 4, "0.1 % was requested; what helps: reduction.modes"),
        pytest.param(
            "harmonic_balance.tolerance=1e-12", 4,
            "1e-10 % was requested; what helps: reduction.modes = 10",
            marks=pytest.mark.nightly,
        ),
    ],
)  # fmt: skip
def test_exit_codes(
    tmp_path: Path, run_command: RunCommand, change: str, code: int, words: str
) -> None:
    """2 with the key that is wrong, 4 where the tolerance was not reached."""
    options = ["--set", change, "--set", "mesh.lip_elements=2", "--set", "reduction.modes=5"]
    if "harmonics" in change.split("=")[0].split(".")[1]:
        options += ["--set", "harmonic_balance.tolerance=none"]
    streams = run_command("solve", NEW, "--output", tmp_path, *options, code=code)
    assert words in streams.err + streams.out
