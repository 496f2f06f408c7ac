"""The report: one page, whole in itself, with the numbers of its results."""

import base64
import io
import json
import re
import shutil
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import pytest
from helpers import DEMOS, ROOT, few_frames
from PIL import Image
from surroundings import RunCommand, main

import fenics_crack as fc
from fenics_crack.cli.kinds import RESULT_KIND_BY_NAME, load_function

pytestmark = pytest.mark.usefixtures("not_laid_out")

SCENE = str(DEMOS / "paper_plate.toml")
COMMANDS = ("modes", "solve", "curve", "integrate", "sweep")
FILES = ("modes", "solution", "curve", "integration", "sweep")
VOID = {"meta", "img", "br", "link"}


class Page(HTMLParser):
    """Tags and attributes of a page, its words, and whether its tags close each other."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.words = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attributes)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words += data


@pytest.fixture(scope="module", autouse=True)
def short_animations() -> Iterator[None]:
    """Of four frames instead of 36."""
    with few_frames():
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The results of every command, and their page."""
    folder = tmp_path_factory.mktemp("plate & <co>")
    changes = {
        "contact.stiffness": "1e7", "damping.ratio": "0.05", "harmonic_balance.harmonics": "5",
        "curve.start": "2000", "curve.stop": "2100", "integration.periods": "5",
        "curve.stability": "false", "contact.friction_error": "false",
        "sweep.over": "{'excitation.omega' = [1900.0, 2000.0, 2100.0]}",
    }  # fmt: skip
    common_options = [
        word for key, value in changes.items() for word in ("--set", f"{key}={value}")
    ]
    for command in COMMANDS:
        assert main([command, SCENE, *common_options, "--output", str(folder), "--quiet"]) in (0, 3)
    files = [str(folder / f"{name}.h5") for name in reversed(FILES)]
    assert main(["report", *files, "--output", str(folder / "page.html"), "--quiet"]) == 0
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> Page:
    """The page, read."""
    return Page((folder / "page.html").read_text("utf-8"))


def test_it_is_whole(page: Page) -> None:
    """Every tag is closed, and nothing is fetched from anywhere: it opens offline."""
    assert not page.open
    for tag, attributes in page.tags:
        assert tag not in ("script", "link", "iframe", "object", "base")
        for name, value in attributes.items():
            if name in ("src", "href", "srcset", "poster", "data", "action"):
                assert value is not None and value.startswith(("data:image/", "#"))
            assert "url(" not in str(value)
    names = {attributes.get("id") for _, attributes in page.tags}
    links = {str(a["href"])[1:] for tag, a in page.tags if tag == "a"}
    assert links and links <= names


def test_nothing_is_external(folder: Path) -> None:
    """No address stands in the page, in its style neither."""
    text = (folder / "page.html").read_text("utf-8")
    text = re.sub(r"data:image/[a-z]+;base64,[A-Za-z0-9+/=]+", "", text)
    assert not re.search(r"https?:|//[a-z]|@import|url\(", text)


@pytest.mark.nightly
@pytest.mark.parametrize(("kind", "begin"), [("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_vector_graphics(folder: Path, tmp_path: Path, kind: str, begin: bytes) -> None:
    """Every picture but the animation, of every result, of a scene and of several curves."""
    for name in FILES:
        words = [str(folder / f"{name}.h5"), "--output", str(tmp_path / name)]
        assert main(["plot", *words, "--pictures", kind, "--quiet"]) == 0
    twice = 2 * [str(folder / "curve.h5")]
    shutil.copy(twice[0], tmp_path / "again.h5")
    both_words = [twice[0], str(tmp_path / "again.h5"), "--output", str(tmp_path / "both")]
    assert main(["plot", *both_words, "--pictures", kind, "--quiet"]) == 0
    assert main(["plot", SCENE, "--output", str(tmp_path), "--pictures", kind, "--quiet"]) == 0
    assert not [*tmp_path.rglob("*.png")] and len([*tmp_path.rglob("*.gif")]) == 1
    written_files = [*tmp_path.rglob(f"*.{kind}")]
    assert len(written_files) >= 15 and {path.parent.name for path in written_files} >= {
        *FILES,
        "both",
    }
    for path in written_files:
        content = path.read_bytes()
        assert content.startswith(begin) and b"/Type3" not in content


def test_pictures_decode(page: Page) -> None:
    """All of them, each with a caption; one is an animation."""
    pictures = [attributes for tag, attributes in page.tags if tag == "img"]
    assert len(pictures) >= 10
    animated = []
    for attributes in pictures:
        kind, data = str(attributes["src"]).removeprefix("data:image/").split(";base64,")
        with Image.open(io.BytesIO(base64.b64decode(data, validate=True))) as image:
            image.load()
            assert image.format == kind.upper() and min(image.size) > 100
            animated.append(getattr(image, "n_frames", 1) > 1)
        assert str(attributes["alt"]).endswith(".")
    assert sum(animated) == 1


def test_the_numbers_stand_there(page: Page, folder: Path) -> None:
    """Those of the tables that the commands wrote, and the verdict."""
    solution = json.loads((folder / "solution.json").read_text())
    value_by_quantity = {row["quantity"]: row["value"] for row in solution}
    sizes = {"n": 1e-9, "µ": 1e-6, "m": 1e-3, "": 1.0, "k": 1e3, "M": 1e6}
    for name, unit in (("largest opening", "m"), ("largest contact force of a pair", "N")):
        number_texts = re.findall(rf"([\d.]+) ([nµmkM]?){unit}\b", page.words)
        values = [float(number) * sizes[prefix] for number, prefix in number_texts]
        assert pytest.approx(value_by_quantity[name], rel=1e-3) in values
    for row in json.loads((folder / "modes.json").read_text()):
        assert f"{row['frequency [Hz]']:.6g}" in page.words
    assert value_by_quantity["conclusion"] in page.words.replace("Solved", "solved")
    assert f"; {value_by_quantity['verdict on the stability']}" in value_by_quantity["conclusion"]
    assert "Sweep complete; the largest response is " in page.words
    assert "young = " in page.words  # the scene
    for key, value in (
        ("load", "[100.0, 0.0] N"), ("point of the load", "[0.1, 0.1] m"),
        ("damping ratio", "0.05"),
        ("crack edge", "left"), ("height of the crack", "50 mm"), ("crack length", "50 mm"),
    ):  # fmt: skip
        assert re.search(rf"{key}\W*{re.escape(value)}", page.words), key
    for name in ("PETSc", "SLEPc", "DOLFINx", "gmsh", "NumPy"):
        assert re.search(rf"{name} \d", page.words), name
    assert f"fenics_crack {fc.__version__}" in page.words
    assert "Command: fenics-crack report" in page.words
    order = [page.words.index(f"{title}") for title in ("Scene", "Steady vibration", "Versions")]
    assert order == sorted(order)


def test_words_are_escaped(folder: Path, page: Page) -> None:
    """Names of files cannot become tags."""
    assert "plate & <co>" in page.words and "co" not in {tag for tag, _ in page.tags}


def test_results_of_one_kind_are_told_apart(folder: Path, tmp_path: Path) -> None:
    """By what differs between their scenes."""
    words = ["--set", "material.young=7e10", "--count", "2", "--output", str(tmp_path), "--quiet"]
    assert main(["modes", SCENE, *words]) == 0
    files = [str(folder / "modes.h5"), str(tmp_path / "modes.h5")]
    assert main(["report", *files, "--quiet", "--output", str(tmp_path / "two.html")]) == 0
    page = Page((tmp_path / "two.html").read_text("utf-8"))
    assert "material.young = 70 GPa" in page.words
    assert sum(tag == "section" for tag, _ in page.tags) == 5


def test_matrices_without_a_mesh(tmp_path: Path) -> None:
    """Their results are reported as well; what would be drawn on a mesh is left out. Words of the
    scene cannot become tags."""
    shutil.copytree(DEMOS.with_name("meshes") / "chain", tmp_path / "<b> & <i>")
    text = (DEMOS / "chain.toml").read_text().replace("../meshes/chain", "<b> & <i>")
    (tmp_path / "chain.toml").write_text(text)
    for command in ("modes", "solve"):
        words = [command, str(tmp_path / "chain.toml"), "--output", str(tmp_path), "--quiet"]
        assert main(words) == 0
    files = [str(tmp_path / f"{name}.h5") for name in ("modes", "solution")]
    assert main(["report", *files, "--quiet"]) == 0
    page = Page((tmp_path / "report.html").read_text("utf-8"))
    assert "Mode shapes" not in page.words and "No warnings and no remarks." in page.words
    assert sum(tag == "img" for tag, _ in page.tags) == 3
    assert "<b> & <i>" in page.words and not {"b", "i"} & {tag for tag, _ in page.tags}
    assert not page.open


def test_it_refuses(folder: Path, tmp_path: Path, run_command: RunCommand) -> None:
    """One line names what is wrong."""
    solution = str(folder / "solution.h5")
    for words, expected_message in (
        ([solution, "--output", str(tmp_path / "a.pdf")], "--output = "),
        ([str(tmp_path / "none.h5")], "path = "),
        ([SCENE], "path = "),
    ):
        assert run_command("report", *words, code=2).err.startswith(
            f"fenics-crack: {expected_message}"
        )


@pytest.mark.nightly
@pytest.mark.usefixtures("not_drawn")
def test_numbers_of_tips_that_a_scene_asks_for(tmp_path: Path) -> None:
    """A curve of them is drawn beside the plate without its crack, which has none; a page begins
    with what is asked for."""
    scene = str(ROOT / "benchmarks" / "plate.toml")
    quantities = "K_max", "K_II_max", "reaction_force"
    changes = {
        "output.quantities": json.dumps(quantities), "mesh.size": "0.05", "reduction.modes": "8",
        "harmonic_balance.tolerance": "none", "harmonic_balance.harmonics": "5",
        "curve.start": "790", "curve.stop": "792", "curve.stability": "false",
    }  # fmt: skip
    common_options = [
        word for key, value in changes.items() for word in ("--set", f"{key}={value}")
    ]
    for command in ("curve", "solve"):
        assert main([command, scene, *common_options, "--output", str(tmp_path), "--quiet"]) == 0
    files = [str(tmp_path / name) for name in ("curve.h5", "solution.h5")]
    assert main(["plot", files[0]]) == 0
    assert main(["report", *files, "--output", str(tmp_path / "page.html"), "--quiet"]) == 0
    words = Page((tmp_path / "page.html").read_text()).words
    requested_words = words[words.index("Requested by the scene") :]
    requested_words = requested_words[: requested_words.index("In numbers")]
    for name in ("largest stress intensity K_I", "K_II, of either sign", "force of the clamp"):
        assert name in requested_words


def test_every_kind_is_known_by_one_table() -> None:
    """Functions that are named there exist, and the kinds are those of their results."""
    for key, kind in RESULT_KIND_BY_NAME.items():
        for name in (
            kind.report_function_path,
            kind.reader_function_path,
            kind.drawing_function_path,
        ):
            assert callable(load_function(name)), name
        reader = kind.reader_function_path.partition(":")[2].partition(".")[0]
        if reader != "make_run_on_this_rank":
            assert (
                load_function(f"{kind.reader_function_path.partition(':')[0]}:{reader}").KIND == key
            )
    runs = (fc.Modes, fc.PeriodicSolution, fc.ResponseCurve, fc.TimeHistory)
    assert {run.KIND for run in runs} == {
        k
        for k, v in RESULT_KIND_BY_NAME.items()
        if v.reader_function_path.endswith("make_run_on_this_rank")
    }


def test_a_folder(tmp_path: Path, run_command: RunCommand) -> None:
    """All results in it, but for the sweeps that another result has made for itself; a sweep over
    words has no picture, and the page says why."""
    scene = fc.Scene.load(SCENE, {"contact.stiffness": 1e7, "harmonic_balance.harmonics": 5})
    fc.modes(scene, 2).save(tmp_path / "modes.h5")
    sweep_axes = {"sweep.over": {"crack.edge": ["left", "right"]}}
    fc.run_sweep(scene.replace(sweep_axes), tmp_path / "sweep.h5")
    fc.run_sweep(scene.replace(sweep_axes), tmp_path / "growth_1.h5", judged=False)
    assert "left out, as they are parts of other results: " in run_command("report", tmp_path).err
    page = Page((tmp_path / "report.html").read_text("utf-8"))
    assert sum(tag == "section" for tag, _ in page.tags) == 5
    assert "no picture: sweep.over = " in page.words.lower()
    assert main(["report", str(tmp_path / "growth_1.h5"), "--quiet"]) == 0
    empty_folder = tmp_path / "empty"
    empty_folder.mkdir()
    assert "must be a folder with results" in run_command("plot", empty_folder, code=2).err


def test_no_path_of_this_machine(tmp_path: Path, run_command: RunCommand) -> None:
    """The page names the mesh's file, not its folder."""
    scene, folder = str(DEMOS / "inclined_crack.toml"), str(tmp_path)
    run_command("modes", scene, "--set", "mesh.error=false", "--output", folder)
    run_command("report", str(tmp_path / "modes.h5"))
    page = (tmp_path / "report.html").read_text()
    assert "inclined_crack.msh" in page and str(ROOT) not in page
