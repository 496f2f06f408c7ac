"""The whole path of an engineer, from a new scene to a report, by the program's commands alone."""

import base64
import contextlib
import csv
import io
import json
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers import few_frames
from PIL import Image
from surroundings import ROOT, main

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
def ask(folder: Path, capsys: pytest.CaptureFixture[str]) -> object:
    """Run a command on the coarse plate, and return what it printed."""

    def asked(command: str, *changes: str, output: str = "output/plate") -> str:
        capsys.readouterr()
        words = [word for change in (*COARSE, *changes) for word in ("--set", change)]
        places = [] if command.startswith("check") else ["--output", output]
        assert main([*command.split(), "plate.toml", *words, *places]) == 0
        return capsys.readouterr().out

    return asked


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def column(rows: list[dict[str, str]], ending: str) -> np.ndarray:
    """Numbers of the column whose name ends so."""
    [name] = [name for name in rows[0] if name.endswith(ending)]
    return np.array([float(row[name]) for row in rows])


@pytest.mark.nightly
def test_from_a_new_scene_to_a_report(folder: Path, ask: object) -> None:
    assert callable(ask)
    results = folder / "output/plate"
    checked = {r["what"]: r["value"] for r in json.loads(ask("check --format json"))}
    opened, tied = (
        checked[f"first natural frequency, crack faces {how} [Hz]"] for how in ("open", "bonded")
    )
    breathing = 2.0 * opened * tied / (opened + tied)
    assert checked[BREATHING] == pytest.approx(breathing, rel=2e-3)
    modes = json.loads(ask("modes --count 3 --format json"))
    assert modes[0]["frequency [Hz]"] == pytest.approx(opened)
    solved = {r["name"]: r["value"] for r in json.loads(ask("solve --format json"))}
    assert solved["over_bilinear"] == pytest.approx(780.0 / breathing, rel=1e-3)  # of 8 modes

    # The curve: half of each period open, half closed.
    around = [f"curve.start={0.98 * breathing}", f"curve.stop={1.02 * breathing}"]
    printed = ask("curve", *around)
    [largest] = [line.split() for line in printed.splitlines() if line.startswith("largest")]
    assert float(largest[1]) == pytest.approx(breathing, rel=0.01)
    assert opened < float(largest[1]) < tied
    points = rows_of(results / "curve.csv")
    frequency, amplitude = column(points, "frequency [Hz]"), column(points, "amplitude [m]")
    assert frequency[amplitude.argmax()] == pytest.approx(breathing, rel=0.01)

    # The ratio 2/1 over the crack's length and the frequency: linear plates have none.
    printed = ask(
        "sweep",
        "sweep.over={'excitation.frequency' = {start = 780.0, stop = 880.0, count = 5}, "
        "'crack.length' = [0.015, 0.02, 0.025, 0.03]}",
        "output.quantities=['ratio_2_1', 'closed_share']",
    )
    assert len(printed.splitlines()) <= 20 and "ratio_2_1" in printed
    cases = rows_of(results / "sweep.csv")
    assert len(cases) == 20 and np.all(column(cases, "ratio_2_1") > 1e-6)
    shares = column(cases, "closed_share")
    assert np.all((shares > 0.3) & (shares < 0.7))

    # A crack pressed together, under two loads.
    preload = ["crack.clearance=-5e-7", *around]
    peaks = {}
    for name, force in LOADS.items():
        force_sin = f"excitation.force_sin=[{force}, 0.0]"
        ask("curve", force_sin, *preload, "curve.stability=false", output=f"output/{name}")
        points = rows_of(folder / f"output/{name}/curve.csv")
        frequency, amplitude = column(points, "frequency [Hz]"), column(points, "amplitude [m]")
        peaks[name] = frequency[amplitude.argmax()], amplitude.max() / force
    assert peaks["weak"][0] > peaks["strong"][0]  # preload stiffens; a strong load opens the crack
    assert peaks["strong"][0] == pytest.approx(breathing, rel=0.01)

    assert_drawn(folder, results)


def assert_drawn(folder: Path, results: Path) -> None:
    """The map, the overlay, and a report of all of it."""
    assert main(["plot", "output/plate/sweep.h5", "--quiet"]) == 0
    assert (results / "sweep_ratio_2_1_map.png").stat().st_size > 10000
    curves = [f"output/{name}/curve.h5" for name in LOADS]
    assert main(["plot", *curves, "--output", "output/loads", "--quiet"]) == 0
    [overlay] = (folder / "output/loads").glob("*.png")
    with Image.open(overlay) as picture:
        assert min(picture.size) > 300
    names = ("modes", "solution", "curve", "sweep")
    given = [f"output/plate/{name}.h5" for name in names]
    page = results / "report.html"
    assert main(["report", *given, curves[0], "--output", str(page), "--quiet"]) == 0
    text = page.read_text()
    embedded = re.findall(r"data:image/(?:png|gif);base64,([A-Za-z0-9+/=]+)", text)
    assert len(embedded) >= 10
    for data in embedded:
        Image.open(io.BytesIO(base64.b64decode(data))).verify()
    written = re.sub(r"http://www.w3.org\S*|data:image/[^\"]*", "", text)  # pictures may say it
    assert "<h2" in text and "http" not in written


# --- docs/short_answers.md ------------------------------------------------------------------------

PAGE = (ROOT / "docs" / "short_answers.md").read_text()
ANSWERS = re.findall(r"```python\nimport fenics_crack as fc\n(.*?)```", PAGE, re.S)
ROWS = re.findall(r"^\| `([^`]+)` \| ([^|]+?) \|$", PAGE, re.M)


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
    """Every line of the table, in its order and in one folder, of a coarser plate."""
    assert len(ROWS) >= 20
    coarse = {"mesh.size": 0.04, "mesh.lip_elements": 3}
    scene = fc.Scene.load("plate.toml").replace(coarse)
    Path("plate.toml").write_text(scene.as_toml())
    things = {"fenics_crack": fc, "scene": scene, "run": fc.modes(scene, 1)}
    for written, answer in ROWS:
        capsys.readouterr()
        if written.startswith("fenics-crack "):
            with contextlib.suppress(SystemExit):
                main(shlex.split(written)[1:])
            said = "".join(capsys.readouterr())
            if written.startswith("fenics-crack new blade.toml"):
                blade = fc.Scene.load("blade.toml").replace(coarse)
                Path("blade.toml").write_text(blade.as_toml())
        else:
            with pytest.raises(AttributeError) as caught:
                eval(written, dict(things))
            said = str(caught.value)
        parts = [re.escape(part) for part in answer.split(" ... ")]
        assert re.search(".*".join(parts), said, re.S), (written, said)
