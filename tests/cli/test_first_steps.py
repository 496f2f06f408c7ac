"""What ``new`` writes runs, what is missing is shown, nothing is replaced unsaid; completion."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from helpers import ROOT, catch_error
from surroundings import RunCommand, main

import fenics_crack as fc
from fenics_crack.cli.given import parse_changes
from fenics_crack.study.sharing import LAST_STRUCTURE_OR_EMPTY_LIST

pytestmark = pytest.mark.usefixtures("not_drawn")

KINDS = ("blade", "timing", "identify")
COARSE = (
    "mesh.size=0.05", "mesh.lip_elements=2", "reduction.modes=5", "curve.stability=false",
    "harmonic_balance.tolerance=none", "harmonic_balance.harmonics=3", "mesh.error=false",
    "contact.friction_error=false",
)  # fmt: skip


def sets(*changes: str) -> list[str]:
    return [word for change in changes for word in ("--set", change)]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("kinds", [[], *([kind] for kind in KINDS), [*KINDS]], ids="-".join)
def test_new_writes_a_scene(kinds: list[str], here: Path) -> None:
    """With any of its kinds; a blade turns, and has its load's order, probes, an unknown crack."""
    assert main(["new", "own.toml", *(f"--{kind}" for kind in kinds), "--quiet"]) == 0
    scene = fc.Scene.load("own.toml")
    turns = bool({"blade", "timing"} & {*kinds})
    assert (scene.speed > 0.0) == turns == (scene.excitation.order is not None)
    frequency = 800.0 if turns else 780.0
    assert scene.excitation.omega / (2.0 * 3.14159265) == pytest.approx(frequency, rel=1e-6)
    assert (scene.tip_timing is not None) == ("timing" in kinds)
    assert (scene.identify is not None) == ("identify" in kinds)
    assert (here / "own_measured.csv").exists() == ("identify" in kinds)
    assert scene.curve is not None and (scene.curve.parameter == "rpm") == turns


def test_every_command_runs_on_what_new_wrote(here: Path) -> None:
    """A blade with probes and measurements takes all of them."""
    assert main(["new", "own.toml", *(f"--{kind}" for kind in KINDS), "--quiet"]) == 0
    few_options = ["sweep.over={'crack.length' = [0.02, 0.03]}", "curve.stop=2905.0"]
    words = sets(*COARSE, *few_options, "integration.periods=3", "integration.settle=10.0")
    for command in ("check", "modes", "campbell", "solve", "curve", "integrate", "sweep", "timing"):
        more_options = (
            ["--speeds", "0", "3000", "2", "--count", "1"] if command == "campbell" else []
        )
        assert main([command, "own.toml", *words, *more_options, "--quiet"]) == 0, command


@pytest.mark.nightly
def test_the_crack_of_the_sample_is_found(here: Path, run_command: RunCommand) -> None:
    """From the measurements that new wrote."""
    assert main(["new", "plain.toml", "--identify", "--quiet"]) == 0
    coarse_options = sets("mesh.size=0.04", "mesh.lip_elements=3", "identify.finer=1.0")
    *_, row = run_command(
        "identify", "plain.toml", "plain_measured.csv", *coarse_options, "--quiet"
    ).out.splitlines()
    assert float(row.split()[1]) == pytest.approx(0.025, rel=0.05)


@pytest.mark.nightly
def test_commands_run_on_the_solid_that_new_wrote(here: Path, run_command: RunCommand) -> None:
    """The commands of a plate, with pictures and a report; its first mode is the flap."""
    assert (
        "--solid = 'with --blade'"
        in run_command("new", "own.toml", "--solid", "--blade", code=2).err
    )
    assert main(["new", "own.toml", "--solid", "--quiet"]) == 0
    few_options = [
        "sweep.over={'crack.depth' = [0.002, 0.003]}",
        "curve.stop=604.0",
        "mesh.size=0.015",
    ]
    few_options += ["mesh.lip_elements=1", "reduction.modes=6"]
    words = sets(*few_options, "integration.periods=3", "integration.settle=10.0")
    for command in ("check", "modes", "solve", "curve", "integrate", "sweep"):
        more_options = sets(f"mesh.error={'true' if command == 'solve' else 'false'}")
        more_options += ["--count", "2"] if command == "modes" else []
        assert main([command, "own.toml", *words, *more_options, "--quiet"]) == 0, command
    results = [f"output/own/{name}.h5" for name in ("modes", "solution")]
    for result in results:
        assert main(["plot", result, "--quiet"]) == 0, result
    assert main(["report", results[0], "--quiet"]) == 0
    rows = np.genfromtxt("output/own/modes.csv", delimiter=",", names=True)
    assert rows[rows.dtype.names[2]][0] == pytest.approx(616.0, rel=0.03)  # Hz, on a coarse mesh
    picture_names = {path.name for path in Path("output/own").glob("*.*")}
    assert {
        "modes.png",
        "solution_contact_map.png",
        "solution_breathing_crack.gif",
    } <= picture_names


@pytest.mark.drawn(2)
@pytest.mark.parametrize(
    ("command", "gone"),
    [("timing", "tip_timing"), ("campbell", "rotation"), ("curve", "curve"), ("sweep", "sweep")],
)
def test_lines_to_paste(command: str, gone: str, here: Path, run_command: RunCommand) -> None:
    """The error shows a table; put behind the scene it does."""
    assert main(["new", "own.toml", "--quiet"]) == 0
    parts = Path("own.toml").read_text().split("\n\n")
    text = "\n\n".join(part for part in parts if not part.startswith(f"[{gone}"))
    Path("own.toml").write_text(text)
    message, _, lines = run_command(command, "own.toml", "--quiet", code=2).err.partition(
        "for example:\n\n"
    )
    assert message.startswith(f"fenics-crack: {gone} is missing: ") and message.count("\n") == 1
    Path("own.toml").write_text(f"{text}\n{lines}")
    coarse_options = [change for change in COARSE if not change.startswith(("curve", gone))]
    short_options = {
        "curve": ["curve.stop=780.5"],
        "sweep": ["sweep.over={'crack.length' = [0.02]}"],
    }
    assert (
        main([command, "own.toml", *sets(*coarse_options, *short_options.get(gone, [])), "--quiet"])
        == 0
    )


WRONG = {
    "height = 0.3 ": ("heigth = 3", "geometry.heigth = 3: .*; did you mean geometry.height?"),
    "thickness = 0.002": ("thickness = '2 mm'", "geometry.thickness = .* did you mean 0.002?"),
    'edge = "left"': ("", "crack.edge is missing: .*; for example edge = \"left\""),
    "length = 0.03": ("", "crack.length is missing: .*; for example length = 0.03"),
    "young = 2.1e11": ("", "material.young is missing: .*; for example young = 2.1e11"),
    "[damping]\n": ("[damnping]\n", "damnping = .*: not allowed; did you mean damping?"),
    "point = [0.1, 0.3]": ("", "excitation.point is missing: .*; for example point = [0.1, 0.3]"),
    "frequency = 780.0 ": ("", "excitation.omega is missing: .*; for example frequency = 780.0"),
    "lip_elements = 10": ("", "mesh.lip_elements is missing: .*; for example lip_elements = 10"),
    '[contact] ': ("[output.points]", "contact is missing: give a table [contact]"),
}  # fmt: skip
"""Text of a new scene, what takes its place, and the line about it."""


@pytest.mark.parametrize("command", ["check", "solve"])
def test_every_wrong_key_is_shown_at_once(
    command: str, here: Path, run_command: RunCommand
) -> None:
    """In all tables, by a line each with a proposal; Python raises the first."""
    assert main(["new", "own.toml", "--quiet"]) == 0
    text = Path("own.toml").read_text().partition("\n[output]")[0].replace("law = ", "# law = ")
    for right_key, (wrong_key, _) in WRONG.items():
        assert text.count(right_key) == 1, right_key
        text = text.replace(right_key, f"{wrong_key}  # " if "\n" not in wrong_key else wrong_key)
    Path("own.toml").write_text(text)
    message = (
        run_command(command, "own.toml", code=2)
        .err.partition("for example:\n\n[contact]")[0]
        .splitlines()
    )
    patterns = [
        "fenics-crack: " + re.escape(line).replace(r"\.\*", ".*") for _, line in WRONG.values()
    ]
    for pattern in patterns:
        assert sum(bool(re.match(pattern, line)) for line in message) == 1, (pattern, message)
    assert len(message) == len(WRONG)
    error = catch_error(lambda: fc.Scene.load("own.toml"), "damnping")
    assert f"fenics-crack: {error}" == message[0]


def test_tables_to_paste_make_a_scene(here: Path, run_command: RunCommand) -> None:
    """Of an empty file all are missing; what is shown is one that can be solved."""
    Path("own.toml").touch()
    message, _, lines = run_command("check", "own.toml", code=2).err.partition("for example:\n\n")
    assert message.count(" is missing: give a table [") == message.count("\n") == 5
    Path("own.toml").write_text(lines)
    assert main(["check", "own.toml", *sets("mesh.size=0.05", "mesh.error=false"), "--quiet"]) == 0


@pytest.mark.parametrize(
    ("kind", "changes", "unit"),
    [
        pytest.param(
            [],
            ["geometry.height=0.2", "excitation.point=[0.1, 0.2]"],
            "frequency",
            marks=pytest.mark.nightly,
        ),
        pytest.param(  # the second, or third
            [], ["excitation.omega=2.7e4", "sweep=none"], "omega", marks=pytest.mark.nightly
        ),
        pytest.param(
            ["--blade"],
            ["material.young=1.1e11", "material.density=4400.0"],
            "rpm",
            marks=pytest.mark.nightly,
        ),
    ],
    ids=["hertz", "second", "blade"],
)
def test_the_curve_to_paste_is_of_this_scene(
    kind: list[str], changes: list[str], unit: str, here: Path, run_command: RunCommand
) -> None:
    """Around its resonance nearest to the load's frequency, in its unit; it runs, and has a peak
    inside."""
    assert main(["new", "own.toml", "--quiet", *kind]) == 0
    options = [change for change in COARSE if not change.startswith("curve")]
    scene = fc.Scene.load("own.toml").replace(parse_changes([*options, *changes, "curve=none"]))
    Path("own.toml").write_text(scene.as_toml())
    message, _, lines = run_command("curve", "own.toml", code=2).err.partition("for example:\n\n")
    assert message.startswith(
        "fenics-crack: curve is missing: give a table [curve] with start, stop, which this command "
        "needs"
    )
    Path("own.toml").write_text(f"{scene.as_toml()}\n{lines}")
    words = ["--set", "curve.stability=false", "--set", "mesh.error=false", "--quiet"]
    words += ["--set", "harmonic_balance.tolerance=3e-2"]  # as its few modes allow
    assert main(["curve", "own.toml", *words]) == 0
    curve = fc.load_run("output/own/curve.h5").result
    assert fc.Scene.load("own.toml").curve.parameter == unit
    assert curve.complete and 0 < int(np.argmax(curve.amplitude())) < len(curve.omega) - 1


def test_commands_to_paste_quote_their_paths(here: Path, run_command: RunCommand) -> None:
    """A shell takes each as the words of a call that runs; also those in the scene itself."""
    name = "my 'plate' $x.toml"
    proposal_lines = run_command("new", name, "--identify").err.splitlines()
    assert shlex.split(proposal_lines[0].partition("next: ")[2])[1:] == ["check", name]
    rows = "my 'plate' $x_measured.csv"
    assert shlex.split(proposal_lines[1].partition("then: ")[2])[1:] == ["identify", name, rows]
    text = Path(name).read_text()
    assert f"check  {shlex.quote(name)} " in text
    assert f"identify {shlex.quote(name)} {shlex.quote(rows)}\n" in text
    [line] = [
        mode_line
        for mode_line in run_command("modes", name, "--count", "1", *sets(*COARSE)).err.splitlines()
        if "pictures: " in mode_line
    ]
    program, *words = shlex.split(line.partition("pictures: ")[2])
    assert program == "fenics-crack" and main([*words, "--quiet"]) == 0


def omega(folder: Path) -> float:
    """The first natural frequency in a folder's modes, by the table and by the file."""
    first_omega = float(json.loads((folder / "modes.json").read_text())[0]["omega [rad/s]"])
    assert fc.load_run(folder / "modes.h5").result.omega[0] == pytest.approx(first_omega)
    return first_omega


def test_another_result_is_kept_as_the_one_before(here: Path) -> None:
    """One generation, with all of its files; the same result again is none, and no other file of
    the folder is touched."""
    assert main(["new", "own.toml", "--quiet"]) == 0
    out = Path("output/own")
    out.mkdir(parents=True)
    for name in ("modes.toml", "notes.txt"):
        (out / name).write_text(name)
    words, seen = ["modes", "own.toml", *sets(*COARSE), "--quiet"], []
    for more in ([], [], sets("crack.length=0.02"), sets("crack.length=0.01")):
        LAST_STRUCTURE_OR_EMPTY_LIST.clear()  # as in a process of its own, to the last bit
        assert main([*words, *more]) == 0
        seen.append(omega(out))
        if (out / "before").exists():
            assert omega(out / "before") == seen[-2]
        assert (out / "before").exists() == (len(seen) > 2)
    assert seen[1] < seen[2] < seen[3]
    names = {"modes.h5", "modes.csv", "modes.json"}
    assert {path.name for path in (out / "before").iterdir()} == names
    assert {path.name for path in out.iterdir()} == names | {"before", "modes.toml", "notes.txt"}


def test_a_link_is_no_folder_to_keep_in(here: Path) -> None:
    """Nothing is written where it leads."""
    assert main(["new", "own.toml", "--quiet"]) == 0
    words = ["modes", "own.toml", *sets(*COARSE), "--quiet"]
    assert main(words) == 0
    Path("elsewhere").mkdir()
    Path("output/own/before").symlink_to(here / "elsewhere")
    assert main([*words, *sets("crack.length=0.02")]) == 2
    assert not [*Path("elsewhere").iterdir()] and len([*Path("output/own").iterdir()]) == 4


@pytest.mark.parametrize(
    ("words", "question"),
    [
        (["slove", "own.toml"], "did you mean solve?"),
        (["simulate", "own.toml"], "did you mean integrate?"),
        (["eigenfrequencies", "own.toml"], "did you mean modes?"),
        (["frf", "own.toml"], "did you mean curve?"),
        (["solve", "own.toml", "--ouput", "x"], "did you mean --output?"),
        (["check", "own.toml", "--speeds", "x"], "--speeds x; it is an option of campbell only"),
        (["solve", "own.toml", "--set", "a.b=1", "a.c=2"], "--set KEY=VALUE --set KEY=VALUE"),
        (["solve", "own.toml", "--sets=x"], "did you mean --set?"),
        (["frobnicate", "own.toml"], None),
    ],
)
def test_wrong_words(
    words: list[str], question: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    """A command or an option that there is not."""
    assert catch_error(lambda: main(words), kind=SystemExit).code == 2
    messages = capsys.readouterr().err
    assert messages.rstrip().endswith(question) if question else "did you mean" not in messages


def completion(shell: str, capsys: pytest.CaptureFixture[str]) -> str:
    pytest.importorskip("shtab")
    assert catch_error(lambda: main(["--completion", shell]), kind=SystemExit).code == 0
    return capsys.readouterr().out


@pytest.mark.parametrize(
    ("typed", "offered"),
    [
        (["so"], ["solve"]),
        (["modes", "plate.toml", "--c"], ["--count"]),
        (["new", "--bl"], ["--blade"]),
        (["solve", "plate.toml", "--set", "crack.l"], ["crack.length"]),
        (["solve", "plate.toml", "--format", "c"], ["csv"]),
        (["solve", "pypro"], ["pyproject.toml"]),
    ],
)
def test_bash_completes(
    typed: list[str], offered: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    """Commands, options, keys, files."""
    words = ["fenics-crack", *typed]
    ask = f"COMP_WORDS=({' '.join(map(repr, words))}); COMP_CWORD={len(typed)}; "
    ask += f"_shtab_fenics_crack fenics-crack {words[-1]!r} {words[-2]!r}; echo ${{COMPREPLY[@]}}"
    process = subprocess.run(
        ["bash", "-c", completion("bash", capsys) + ask],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
    )
    assert process.stdout.split() == offered and not process.stderr


def known(kind: str, scene: fc.Scene, key: str) -> list[str]:
    """What a refusal says is known."""
    error = catch_error(lambda: scene.replace({key: 1.0}), key, 1.0)
    return error.allowed.partition(f"known {kind}: ")[2].split(", ")


@pytest.mark.parametrize("shell", ["zsh", "fish"])
def test_other_shells(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Their scripts have all words; a shell that is here reads them."""
    text = completion(shell, capsys)
    assert catch_error(lambda: main(["--help"]), kind=SystemExit).code == 0
    words = re.findall(r"^    (\w+) ", capsys.readouterr().out, re.M)
    scene = fc.Scene.load(ROOT / "benchmarks" / "plate.toml")
    for table in known("tables", scene, "rubbish"):
        keys = known("keys", scene, f"{table}.rubbish")
        words += [key if "." in key else f"{table}.{key}" for key in keys]
    assert len(words) > 100 and all(word in text for word in words)
    if shutil.which(shell):
        subprocess.run([shell, "-c", text], check=True)
