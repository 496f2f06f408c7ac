"""The whole path of an engineer, from a new scene to a report, by the program's commands alone."""

import contextlib
import csv
import json
import re
import shlex
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import catch_error, few_frames
from surroundings import ROOT, RunCommand, main

import fenics_crack as fc

pytestmark = pytest.mark.usefixtures("not_laid_out")

BREATHING = "resonance at the load [Hz]"
LOADS = {"weak": 1.0, "strong": 100.0}
"""Forces in newtons: of the least, the preload keeps the crack closed."""
COARSE = (
    "mesh.size=0.05", "mesh.lip_elements=2", "reduction.modes=8",
    "harmonic_balance.tolerance=none", "harmonic_balance.harmonics=5",
)  # fmt: skip


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with a new scene; animations have four frames."""
    place = tmp_path_factory.mktemp("path")
    with few_frames() as patch:
        patch.chdir(place)
        assert main(["new", "plate.toml", "--quiet"]) == 0
        yield place


@pytest.fixture
def ask(folder: Path, run_command: RunCommand) -> object:
    """Run a command on the coarse plate, and return what it printed."""

    def asked(command: str, *changes: str, output: str = "output/plate") -> str:
        places = [] if command.startswith("check") else ["--output", output]
        sets = [*COARSE, *changes]
        return str(run_command(*command.split(), "plate.toml", *places, sets=sets).out)

    return asked


def column(path: Path, ending: str) -> np.ndarray:
    """Return the numbers of the column whose name ends so."""
    rows = [*csv.DictReader(path.read_text().splitlines())]
    [name] = [name for name in rows[0] if name.endswith(ending)]
    return np.array([float(row[name]) for row in rows])


@pytest.mark.nightly
def test_a_preload_and_the_length_of_a_crack(folder: Path, ask: object) -> None:
    """A crack breathes at every length and load frequency. One that is pressed together stays
    closed under a small load, and breathes under a large one."""
    assert callable(ask)
    value_by_text = {r["what"]: r["value"] for r in json.loads(ask("check --format json"))}
    breathing_frequency = value_by_text[BREATHING]
    printed_text = ask(
        "sweep",
        "sweep.over={'excitation.frequency' = {start = 780.0, stop = 880.0, count = 5}, "
        "'crack.length' = [0.015, 0.02, 0.025, 0.03]}",
        "output.quantities=['ratio_2_1', 'closed_share']",
    )
    assert len(printed_text.splitlines()) <= 20 and "ratio_2_1" in printed_text
    ratios, shares = (
        column(folder / "output/plate/sweep.csv", name) for name in ("ratio_2_1", "closed_share")
    )
    assert len(ratios) == 20 and np.all(ratios > 1e-6)
    assert np.all((shares > 0.3) & (shares < 0.7))
    peaks = []
    for name, force in LOADS.items():
        changes = [
            f"curve.start={0.98 * breathing_frequency}",
            f"curve.stop={1.02 * breathing_frequency}",
        ]
        changes += [f"excitation.force_sin=[{force}, 0.0]", "curve.stability=false"]
        ask("curve", *changes, "crack.clearance=-5e-7", output=f"output/{name}")
        points = folder / f"output/{name}/curve.csv"
        amplitude = column(points, "amplitude [m]")
        peaks.append(column(points, "frequency [Hz]")[amplitude.argmax()])
    assert peaks[0] > peaks[1] == pytest.approx(breathing_frequency, rel=0.01)


# --- docs/short_answers.md ------------------------------------------------------------------------

PAGE = (ROOT / "docs" / "short_answers.md").read_text()
ANSWERS = re.findall(r"```python\nimport fenics_crack as fc\n(.*?)```", PAGE, re.S)
ROWS = re.findall(
    r"^\| `([^`]+)` \| ([^|]+?) \|$", (ROOT / "tests" / "answers.txt").read_text(), re.M
)
"""What is written, and a part of what is answered."""


def test_answers_have_three_lines() -> None:
    """Behind the import; ten of them at least."""
    assert len(ANSWERS) >= 10
    assert max(len([*filter(None, answer.splitlines())]) for answer in ANSWERS) <= 3


@pytest.fixture
def coarse(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The new scene is coarse and short, and there is a pandas."""
    short = {"curve.stop": 781.0, "integration.periods": 2} | dict(
        zip(("mesh.size", "mesh.lip_elements", "reduction.modes"), (0.05, 2, 8), strict=True)
    )
    scene = fc.Scene.load(folder / "plate.toml").replace(short)
    (tmp_path / "plate.toml").write_text(scene.as_toml())
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "pandas", SimpleNamespace(DataFrame=dict))


@pytest.mark.usefixtures("coarse")
@pytest.mark.drawn(5)
@pytest.mark.parametrize("number", range(len(ANSWERS)))
def test_an_answer(number: int, capsys: pytest.CaptureFixture[str]) -> None:
    """As it stands on the page; what prints nothing writes files or makes a table."""
    names: dict[str, object] = {}
    exec("import fenics_crack as fc\n" + ANSWERS[number], names)
    said = capsys.readouterr().out
    assert said or "print(" not in ANSWERS[number]
    assert "NOT CONVERGED" not in said and "not complete" not in said.lower()


@pytest.mark.nightly
def test_what_is_answered(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every line of answers.txt, in its order and in one folder, of a coarser plate."""
    assert len(ROWS) >= 20
    coarse = {"mesh.size": 0.04, "mesh.lip_elements": 3}
    scene = fc.Scene.load("plate.toml").replace(coarse)
    Path("plate.toml").write_text(scene.as_toml())
    things = {"fenics_crack": fc, "scene": scene, "run": fc.modes(scene, 1)}
    for written_text, answer in ROWS:
        capsys.readouterr()
        if written_text.startswith("fenics-crack "):
            with contextlib.suppress(SystemExit):
                main(shlex.split(written_text)[1:])
            messages = "".join(capsys.readouterr())
            if written_text.startswith("fenics-crack new blade.toml"):
                blade = fc.Scene.load("blade.toml").replace(coarse)
                Path("blade.toml").write_text(blade.as_toml())
        else:
            error = catch_error(partial(eval, written_text, dict(things)), kind=AttributeError)
            messages = str(error)
        parts = [re.escape(part) for part in answer.split(" ... ")]
        assert re.search(".*".join(parts), messages, re.S), (written_text, messages)
