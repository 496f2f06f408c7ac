"""How programs are scored against the benchmark of exact orbits."""

import ast
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fenics_crack as fc

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks" / "orbits"))
import check
import problem
import score
import worker

ORBITS = Path(score.__file__).parent
OTHER_ORBITS = {"chain-20"}
"""Cases of which this package answers an orbit that they do not have."""


def test_the_table_is_the_record() -> None:
    """The table of docs/the_paper.md follows from the kept rows, program by program."""
    record = json.loads((ORBITS / "scores.json").read_text())
    page = (ORBITS.parents[1] / "docs" / "the_paper.md").read_text()
    for program, rows in record["rows_by_program"].items():
        numbers = " | ".join(score.line(program, rows)[1:])
        lines = [line for line in page.splitlines() if line.lower().startswith(f"| {program}")]
        assert len(lines) == 1 and lines[0].endswith(f" | {numbers} |"), numbers
    table = page[page.index("| program | version |") :].partition("\n\n")[0]
    assert len(table.splitlines()) == 2 + len(record["rows_by_program"])
    for text in (record["commit"], record["date"], f"{len(rows)} cases"):
        assert text in page


def case_of(name: str) -> dict[str, Any]:
    """A case of the benchmark."""
    return check.read(ORBITS / "cases" / f"{name}.json")


def answer_of(orbit: dict[str, Any], **changes: Any) -> dict[str, Any]:
    """An orbit as a program's answer."""
    answer = {"gap": orbit["gap"], "tangential": orbit.get("tangential_gap"), "converged": True,
              "periods": orbit["subharmonic"], "verdict": orbit["verdict"], "error": 1e-9,
              "seconds": 1.0, "version": "1", "message": ""}  # fmt: skip
    return answer | changes


@pytest.mark.parametrize("name", ["fold", "tripled", "rub-two", "rub-constant"])
def test_every_orbit_of_a_case_is_accepted(name: str) -> None:
    """Each of several at one frequency, with its own verdict; shifted by periods of the load."""
    case = case_of(name)
    for orbit in case["orbits"]:
        turned_gap = np.roll(orbit["gap"], 256 // orbit["subharmonic"], axis=0)
        slide = orbit.get("tangential_gap")
        if slide is not None:
            slide = np.roll(slide, 256 // orbit["subharmonic"], axis=0).tolist()
        row = score.scored(case, answer_of(orbit, gap=turned_gap.tolist(), tangential=slide))
        assert row["error"] < 1e-9 and row["found"] and row["right"] and row["within"]


def test_what_is_wrong_is_not_honest() -> None:
    """By a tenth: wrong where it is called a solution and no error is stated."""
    case = case_of("bilinear-1")
    orbit = case["orbits"][0]
    deviating_gap = (1.1 * (gap := np.array(orbit["gap"])) - 0.1 * gap.mean(axis=0)).tolist()

    def row(**changes: Any) -> dict[str, Any]:
        return score.scored(case, answer_of(orbit, gap=deviating_gap, error=None) | changes)

    assert row()["error"] == pytest.approx(0.1, rel=1e-3)
    assert not row()["found"] and not row()["honest"]
    assert row(error=0.1)["honest"] and row(error=0.1)["within"]
    assert not row(error=0.05)["honest"]
    assert row(converged=False)["honest"]
    assert not score.scored(case, answer_of(orbit, gap=None))["found"]


@pytest.mark.parametrize("name", ["bilinear-10", "plate-5-penalty", "three-harmonics", "smooth-20"])
def test_equations_of_a_problem(name: str) -> None:
    """An orbit of the case fulfils them, with the pairs' places as degrees of freedom and in
    coordinates of the gaps: the balance of its first harmonics."""
    case = case_of(name)
    orbit = case["orbits"][0]
    original_problem = problem.problem_of(case)
    gap, count = np.array(orbit["gap"]), 3
    rows = np.fft.rfft(original_problem.contact(gap)[0], axis=0)[: count + 1] / len(gap)
    for variant in (original_problem.with_faces(), original_problem.in_gaps()):
        moved, size = [], 0.0
        load = variant.load(count)
        for order in range(count + 1):
            w, factor = order * original_problem.omega, 1.0 if order == 0 else 2.0
            f = load[0] if order == 0 else load[2 * order - 1] - 1j * load[2 * order]
            dynamic = variant.stiffness - w**2 * variant.mass + 1j * w * variant.damping
            q = np.linalg.solve(dynamic, f - variant.pairs @ (factor * rows[order]))
            moved.append(variant.pairs.T @ q - (order == 0) * variant.clearance)
            wave = factor * np.fft.rfft(gap, axis=0)[order] / len(gap)
            size = max(size, float(np.abs(moved[-1] - wave).max() / np.ptp(gap)))
        assert size < 2e-3  # the force's spectrum from 256 samples, near a resonance


def test_rate_is_that_of_the_equations() -> None:
    """z' at a state beside the equation of motion; its slope by differences."""
    case_problem = problem.problem_of(case_of("five-stops"))
    state = np.random.default_rng(1).normal(size=10)
    q, v = state[:5], state[5:]
    push = case_problem.contact(q @ case_problem.pairs - case_problem.clearance)[0]
    force_sum = (
        case_problem.mass @ case_problem.rate(0.3, state)[5:]
        + case_problem.damping @ v
        + case_problem.stiffness @ q
    )
    assert force_sum + case_problem.pairs @ push == pytest.approx(case_problem.force(0.3))
    perturbed_rates = np.array([case_problem.rate(0.3, state + step) for step in 1e-7 * np.eye(10)])
    slope = case_problem.rate_slope(state[:, None])[:, :, 0]
    assert (perturbed_rates - case_problem.rate(0.3, state)).T / 1e-7 == pytest.approx(
        slope, rel=1e-5, abs=1e-5
    )


def test_adapters_answer_through_their_own_process() -> None:
    """The worked example finds a case in a process of its own; orbits are not handed over."""
    case = case_of("bilinear-1")
    row = score.scored(case, score.asked(ORBITS / "adapters" / "plain.py", case, 60.0))
    assert row["found"] and row["within"] and row["error"] < 1e-4
    rigid = score.asked(ORBITS / "adapters" / "plain.py", case_of("plate-5"), 60.0)
    assert rigid["unsupported"] == "no rigid contact"
    assert worker.WARM.exists() and json.loads(worker.WARM.read_text())["name"] == "bilinear-1"


@pytest.mark.parametrize("path", sorted((ORBITS / "adapters").glob("*.py")), ids=lambda p: p.stem)
def test_adapters_are_short(path: Path) -> None:
    """40 lines without blank ones, comments, imports and docstrings; the example, a program of its
    own, 100."""
    text, skipped_numbers = path.read_text(), set()
    for node in ast.walk(ast.parse(text)):
        words = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        if words or isinstance(node, ast.Import | ast.ImportFrom):
            skipped_numbers |= set(range(node.lineno, (node.end_lineno or node.lineno) + 1))
    lines = [line.strip() for line in text.splitlines()]
    code_lines = [line for number, line in enumerate(lines, 1) if number not in skipped_numbers]
    code_lines = [line for line in code_lines if line and not line.startswith("#")]
    assert len(code_lines) <= (100 if path.stem == "plain" else 40)


def test_harmonics_of_an_adapter() -> None:
    """Those that are asked for, in place of its own: the error of a kink falls with them."""
    case, adapter = case_of("bilinear-10"), ORBITS / "adapters" / "plain.py"
    few_error, many_error = (
        score.scored(case, score.asked(adapter, case, 60.0, h))["error"] for h in (5, 40)
    )
    assert many_error < 0.05 * few_error


@pytest.mark.nightly
@pytest.mark.parametrize("path", sorted((ORBITS / "cases").glob("*.json")), ids=lambda p: p.stem)
def test_own_row(path: Path) -> None:
    """Ours: found, within the statement, the verdict right; or another exact orbit."""
    case = case_of(path.stem)
    row = score.scored(case, score.asked(ORBITS / "adapters" / "orbit.py", case, 300.0))
    assert row["found"] != (path.stem in OTHER_ORBITS) and row["right"] is not False
    assert (row["honest"] and row["within"] is not False) or path.stem in OTHER_ORBITS


@pytest.mark.nightly  # 8 s, most of it the search
@pytest.mark.parametrize("name", sorted(OTHER_ORBITS))
def test_orbits_that_cases_do_not_have(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second reference closes them, with the same gaps; both orbits are unstable."""
    monkeypatch.syspath_prepend(ORBITS / "adapters")
    import orbit as adapter

    case = case_of(name)
    structure, law = adapter.modelled(problem.problem_of(case))
    omega = case["load"]["omega"]
    orbit = fc.solve_harmonic_balance(structure, omega, law, tolerance=0.01).orbit
    assert orbit is not None and not orbit.is_stable
    assert case["orbits"][0]["verdict"] == "unstable"
    motions = np.split(orbit.state, 2) @ orbit.flow.modal_model.shapes.T
    state = motions.ravel()
    again = check.Motion(case).period(state, 1)
    assert np.abs(again["state"] - state).max() < 1e-11 * np.abs(state).max()
    gap = orbit.gap_at(orbit.period * np.arange(check.INSTANTS) / check.INSTANTS)
    assert np.abs(gap - again["gap"]).max() < 1e-11 * np.ptp(gap)
