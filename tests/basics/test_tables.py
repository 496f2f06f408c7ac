"""Tables, and results that describe themselves: one line, HTML, plain numbers, CSV."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import two_masses

import fenics_crack as fc
from fenics_crack.basics.tables import (
    Described,
    Table,
    Tabular,
    percent,
    quantity,
    ranging,
    readable,
)
from fenics_crack.scene.tables import Sweep
from fenics_crack.scene.words import differences, value_in_words
from fenics_crack.sweep.file import COLUMNS

TABLES = ("modes", "curve", "backbone", "sweep")
RESULTS = ("solution", "judged", "linear", "report", "stability", "bifurcation", "orbit", *TABLES)


@pytest.fixture(scope="module")
def results(paper_scene: fc.Scene) -> dict[str, Any]:
    """One result of each kind, of two masses with a stop."""
    masses, law = two_masses(), fc.UnilateralPenalty(1.0)
    solution = fc.solve_harmonic_balance(masses, 1.0, law)
    stability = fc.floquet(masses, solution)
    curve = fc.continue_frequency(masses, 0.5, 1.2, law, harmonics=3, stability=True)
    return {
        "solution": solution,
        "judged": replace(solution, stability=stability),
        "linear": fc.solve_linear(masses, 1.0),
        "report": solution.report,
        "stability": stability,
        "bifurcation": curve.bifurcations[0],
        "orbit": fc.shoot(masses, solution),
        "modes": fc.solve_modes(masses, 2),
        "curve": curve,
        "backbone": fc.follow_backbone(masses, law, 1, 1.0, 10.0, harmonics=3),
        "sweep": made_sweep(paper_scene),
    }


def made_sweep(scene: fc.Scene) -> fc.SweepResult:
    """Two lengths by three frequencies, one case failed, one pending."""
    over = {"crack.length": [0.03, 0.05], "excitation.omega": [1900.0, 2000.0, 2100.0]}
    numbers = np.arange(6.0).reshape(2, 3)
    columns: dict[str, np.ndarray] = {
        name: numbers.astype(str if kind.startswith("S") else kind)
        for name, (_, kind) in COLUMNS.items()
    }
    columns["state"] = np.array([[1, 1, 2], [1, 1, 0]])
    swept = replace(scene, sweep=Sweep.from_mapping({"over": over}))
    return fc.SweepResult(Path("sweep.h5"), swept, columns)


def plain(value: object) -> bool:
    """Whether a value is one of Python's own kinds."""
    return type(value) in (int, float, str, bool)


@pytest.mark.parametrize("name", RESULTS)
def test_results_describe_themselves(name: str, results: dict[str, Any]) -> None:
    """One short line, a table in a notebook, and a dict as pandas takes it."""
    result = results[name]
    assert isinstance(result, Described)
    line = repr(result)
    assert line.startswith(f"{type(result).__name__}(") and line.endswith(")")
    assert "\n" not in line and len(line) < 140 and "array" not in line
    page = result._repr_html_()
    assert page.startswith("<table>") and page.count("<table>") == page.count("</table>") == 1
    found = result.to_dict()
    assert all(type(key) is str for key in found)
    if name in TABLES:
        assert isinstance(result, Tabular)
        assert len({len(column) for column in found.values()}) == 1
        assert all(plain(value) for column in found.values() for value in column)
    else:
        assert all(map(plain, found.values()))


@pytest.mark.parametrize("name", TABLES)
def test_tables_read_back(name: str, results: dict[str, Any], tmp_path: Path) -> None:
    """The file has the columns of the dict, to the last digit, with their units."""
    path = tmp_path / "new" / f"{name}.csv"
    results[name].to_csv(path)
    with open(path, newline="") as file:
        header, *rows = csv.reader(file)
    found = results[name].to_dict()
    assert [column.split(" [")[0] for column in header] == list(found)
    assert any("[rad/s]" in column for column in header)
    for column, values in zip(zip(*rows, strict=True), found.values(), strict=True):
        for text, value in zip(column, values, strict=True):
            assert text == str(value)
    with pytest.raises(fc.InputError, match="path"):
        results[name].to_csv(path / "no folder.csv")


def test_what_the_lines_say(results: dict[str, Any]) -> None:
    """Frequency, harmonics, pairs, opening and error; counts; how it ended."""
    solution = results["solution"]
    opening = -solution.gap(np.linspace(0.0, solution.period, 1024, endpoint=False)).min()
    assert repr(solution) == (
        f"PeriodicSolution(1 rad/s, H = 5, 1 pair, opening {opening:.4g} m, "
        f"error {solution.report.total:.2g}, converged)"
    )
    assert results["stability"].verdict in repr(results["judged"])
    assert "linear, converged" in repr(results["linear"])
    assert "NOT CONVERGED" in repr(replace(solution, converged=False))
    assert "period of 2 loads" in repr(replace(solution, subharmonic=2))
    assert f"{len(results['curve'])} points" in repr(results["curve"])
    assert "fold at " in repr(results["bifurcation"]) or "doubling" in repr(results["bifurcation"])
    assert repr(results["sweep"]) == (
        "SweepResult(2 crack.length x 3 excitation.omega, 1 pending, 4 converged, 1 failed)"
    )
    assert repr(results["modes"]).startswith("Modes(2 modes, ")


def test_dicts_say_what_the_results_are(results: dict[str, Any]) -> None:
    """Values are those of the attributes."""
    curve, sweep = results["curve"].to_dict(), results["sweep"].to_dict()
    seen = results["curve"].indicators(results["curve"].structure.watched_dof)
    assert list(curve)[:5] == ["omega", "frequency", "iterations", "multiplier", "verdict"]
    assert curve["amplitude"] == seen.amplitude.tolist()
    assert curve["ratio_2_1"] == seen.ratio_2_1.tolist()
    assert curve["omega"] == results["curve"].omega.tolist()
    assert sweep["excitation.omega"] == 2 * [1900.0, 2000.0, 2100.0]
    assert sweep["crack.length"] == 3 * [0.03] + 3 * [0.05]
    assert sweep["state"][2] == "failed" and sweep["response"] == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    solution = results["judged"].to_dict()
    assert solution["multiplier"] == results["stability"].to_dict()["modulus"]
    assert solution["total_error"] == results["report"].to_dict()["total"]


def test_entries_of_contact(results: dict[str, Any]) -> None:
    """Extremes over the period as sampled by hand; without pairs there is no entry of contact."""
    solution = results["bifurcation"].solution
    time = np.linspace(0.0, solution.period, 1024, endpoint=False)
    gap, force = solution.gap(time), solution.contact_force(time)
    found = solution.to_dict()
    assert found["penetration"] == gap.max() > 0.0 and found["contact_force"] == force.max()
    assert found["closed_share"] == np.mean(force > 0.0)
    assert solution.amplitude(1) == np.ptp(solution.displacement(time, [1])) / 2.0
    free = fc.solve_linear(fc.Structure.from_matrices(np.eye(1), np.eye(1), None), 0.5)
    assert found.keys() - free.to_dict().keys() == {
        "opening", "penetration", "contact_force", "closed_share", "crack_force",
    }  # fmt: skip
    table = solution.table("contact_force", "omega")
    assert table.rows == [("contact_force [N]", force.max()), ("omega [rad/s]", solution.omega)]


def test_long_tables_are_cut_for_eyes_only() -> None:
    """In text and in a notebook; CSV and JSON have all rows."""
    table = Table(("n [<m>]", "word"), [[n, "<b>"] for n in range(50)])
    assert table.formatted("text").endswith("... and 10 more\n")
    page = table.html("a & b")
    assert page.count("<tr>") == 41 and "a &amp; b; the first 40 of 50 rows" in page
    assert "&lt;b&gt;" in page and "<b>" not in page and "n [&lt;m&gt;]" in page
    assert len(table.formatted("csv").splitlines()) == 51
    assert len(json.loads(table.formatted("json"))) == 50


def test_quantities() -> None:
    """A number with a prefix that suits it."""
    shown = {1.4514e-6: "1.451 µm", 0.0: "0 m", -2e-9: "-2 nm", 999.97e-6: "1000 µm", 12.0: "12 m"}
    assert {value: quantity(value, "m") for value in shown} == shown


@pytest.mark.parametrize(
    ("share", "words"),
    [(0.0, "0 %"), (0.0238, "2.4 %"), (0.994, "99 %"), (0.997, "100 %"), (1.4, "140 %")],
)
def test_shares_in_per_cent(share: float, words: str) -> None:
    """Without an exponent, also of an error as large as its number."""
    assert percent(share) == words


def test_ranges_in_words() -> None:
    """Ends that read alike are said once."""
    assert ranging(np.array([9, 9])) == "9" and ranging(np.array([40, 5, 7])) == "5 to 40"
    assert ranging(np.array([0.12, 0.1204]), ".2g") == "0.12"


def test_units_that_read_well() -> None:
    """Three digits before the point at most."""
    for largest, unit, factor, found in (
        (2e-7, "m", 1e9, "nm"), (1.7e-6, "m", 1e6, "µm"), (0.0, "m", 1.0, "m"),
        (3.3e4, "Pa", 1e-3, "kPa"), (5e-14, "m", 1e15, "10^-15 m"),
    ):  # fmt: skip
        assert readable(largest, unit) == (pytest.approx(factor), found)


def test_values_of_keys_in_words() -> None:
    """With the prefix that is usual; none of degrees, which were 500 mdegrees."""
    assert value_in_words("crack.length", 0.035) == "35 mm"
    assert value_in_words("excitation.omega", 2000.0) == "2000 rad/s"
    assert value_in_words("loads.1.phase", 0.5) == "0.5 degrees"


def test_a_default_of_a_listed_table_is_told(paper_scene: fc.Scene) -> None:
    """As that of any other: it was "none"."""
    one = paper_scene.replace({"loads.1.edge": "top", "loads.1.traction_sin": [1.0, 0.0]})
    lagging = one.replace({"loads.1.phase": 30.0})
    told = ["loads.1.phase = 0 degrees", "loads.1.phase = 30 degrees"]
    assert differences([one, lagging]) == told
    assert differences([paper_scene, one])[0].startswith("loads.1.edge = none")
