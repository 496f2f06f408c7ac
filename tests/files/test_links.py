"""Links below a folder for results, which may come from somebody else: none is followed."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from surroundings import DEMOS, ROOT, main, no_rank

COARSE = ("mesh.size=0.05", "mesh.lip_elements=2", "mesh.error=false")
HARMONICS = "harmonic_balance.harmonics=5"
PLATE = ("check", "modes", "reduce", "solve", "verify", "curve", "integrate", "sweep")
RUNS: dict[str, tuple[str, tuple[str, ...], tuple[str, ...]]] = {
    "chain": ("", ("solve",), (HARMONICS,)),
    "crack": ("--quiet", ("solve",), COARSE),
    "plate": ("--quiet", PLATE, COARSE),
    "blade": ("--timing", ("campbell", "timing"), COARSE),
    "disk": ("--disk", ("disk",), ("mesh.error=false",)),
    "identify": ("--identify", ("identify",), (COARSE[2], "mesh.size=0.04", "identify.finer=1.0")),
    "growth": ("", ("grow",), (*COARSE, "growth.life_tolerance=0.5", HARMONICS)),
}
"""Option of ``new``, or a demo's name; commands, and changes that make them quick."""
DEAR = [pytest.param(kind, marks=pytest.mark.nightly) for kind in [*RUNS][2:]]
TEXT = "somebody's own"


def commands(kind: str, folder: Path) -> Callable[[Path], list[int]]:
    """Function that runs all commands of a kind into a folder, and returns their exit codes."""
    option, names, changes = RUNS[kind]
    scene = DEMOS / f"{kind}.toml"
    if option:
        scene = folder / "scene.toml"
        assert main(["new", str(scene), option, "--quiet"]) == 0
    more_options = [word for change in changes for word in ("--set", change)] + ["--quiet"]
    rows = [str(folder / "scene_measured.csv")] if kind == "identify" else []

    def run(output: Path) -> list[int]:
        places = {"check": [], "reduce": ["--output", str(output / "reduced_scene.h5")]}
        usual_options = ["--output", str(output)]
        words = [str(scene), *rows, *more_options]
        codes = [main([name, *words, *places.get(name, usual_options)]) for name in names]
        own_folder = folder / "first"
        if kind == "blade":  # a measured record
            codes.append(main(["timing", str(folder / "first" / "arrivals.csv"), *usual_options]))
        results = sorted(
            map(
                str,
                {*own_folder.glob("*.h5")}
                - {*own_folder.glob("*_*.h5"), own_folder / "prepared.h5"},
            )
        )
        results *= kind != "crack"  # drawn with "plate"
        codes += [main(["plot", one, "--quiet", "--output", str(output)]) for one in results]
        if results and kind != "chain":
            page = output / "report.html"
            codes.append(main(["report", *results, "--quiet", "--output", str(page)]))
        return codes

    return run


@pytest.mark.parametrize("kind", ["chain", *DEAR])
def test_no_link_is_followed(kind: str, tmp_path: Path) -> None:
    """In place of each file and folder that commands write, also where an earlier result is kept:
    a link is replaced by the file or refused, and what it leads to stays."""
    first_folder, outside_folder = tmp_path / "first", tmp_path / "outside"
    run = commands(kind, tmp_path)
    codes = run(first_folder)
    assert not {*codes} - {0, 3, 4}  # what does not converge is written, too
    written_files = [
        path.relative_to(first_folder) for path in first_folder.rglob("*") if path.is_file()
    ]
    folders = {"before", *(str(path.parent) for path in written_files)} - {"."}
    names = [*written_files, *(Path("before") / path for path in written_files)]
    for name in names:
        (outside_folder / name).parent.mkdir(parents=True, exist_ok=True)
        (outside_folder / name).write_text(TEXT)

    def link(own: Path, name: Path | str) -> None:
        (own / name).parent.mkdir(parents=True, exist_ok=True)
        (own / name).unlink(missing_ok=True)
        (own / name).symlink_to(outside_folder / name)

    links, kept_path = tmp_path / "links", tmp_path / "kept"
    for name in names:
        link(links, name)
    refusals = run(links)
    assert all(
        new_code in (2, old_code) for new_code, old_code in zip(refusals, codes, strict=True)
    )
    if refusals != codes:
        for path in [path for path in links.glob("*.h5") if path.is_symlink()]:  # of sweeps
            path.unlink()
        assert run(links) == codes
    assert not any((links / name).is_symlink() for name in written_files)
    shutil.copytree(first_folder, kept_path)
    for path in kept_path.iterdir():
        if path.suffix in (".csv", ".json"):
            path.write_text(path.read_text() + "\n")  # of another result
    for name in written_files:
        link(kept_path, Path("before") / name)
    assert run(kept_path) == codes
    assert [path for path in (kept_path / "before").iterdir() if not path.is_symlink()]
    first_writer_index = int(RUNS[kind][1][0] == "check")  # writes nothing into the folder
    for name in folders:
        link(tmp_path / f"around_{name}", name)
        refusals = run(tmp_path / f"around_{name}")
        assert refusals[first_writer_index] == 2 and {*refusals} <= {0, 2}
    outside_files = {
        path.relative_to(outside_folder) for path in outside_folder.rglob("*") if path.is_file()
    }
    assert outside_files == {*names} and all(
        (outside_folder / name).read_text() == TEXT for name in names
    )


TRACE = "trace=open,openat,creat,truncate,rename,renameat2,link,linkat,bind"
"""System calls by which files are opened, and ports."""


IN_PLACE = r"(sweep|(forward|uncracked|growth)_\w+)\.h5"
"""Sweeps, which go on where they stopped: links in their place are refused, not replaced."""
NEW_OR_OWN = re.compile(rf'/\.[0-9a-f]{{8}}\.[^"]*"|/{IN_PLACE}"|(\.json|/prepared\.h5)", O_RDONLY')
"""Files below the output folder that are opened: hidden new ones, by which also the folder is
opened, sweeps that go on, the table whose text is compared, and the structure that was kept."""


@pytest.mark.skipif(shutil.which("strace") is None, reason="no strace")
@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["crack", *DEAR])
def test_no_old_file_is_opened(kind: str, tmp_path: Path) -> None:
    """Of all commands, through a link below the output folder, for reading or writing; no port is
    bound, and no settings are written elsewhere."""
    output, log, outside_folder = tmp_path / "out", tmp_path / "log", tmp_path / "outside"
    first_folder, trace_path = tmp_path / "first", tmp_path / "traced"
    codes = commands(kind, tmp_path)(first_folder)
    outside_folder.write_text(TEXT)
    written_files = [
        path.relative_to(first_folder) for path in first_folder.rglob("*") if path.is_file()
    ]
    for name in [name for name in written_files if not re.fullmatch(IN_PLACE, str(name))]:
        (output / name).parent.mkdir(parents=True, exist_ok=True)
        (output / name).symlink_to(outside_folder)
    shutil.copytree(first_folder, trace_path / "first")
    source = (
        "from pathlib import Path; import test_links;"
        f"print(test_links.commands({kind!r}, Path({str(trace_path)!r}))(Path({str(output)!r})))"
    )
    folders = os.pathsep.join([str(Path(__file__).parent), str(ROOT / "tests"), str(ROOT)])
    tracer = ["strace", "-f", "--seccomp-bpf", "-y", "-qq", "-e", TRACE, "-o", str(log)]
    process = subprocess.run(
        [*tracer, sys.executable, "-c", source],
        capture_output=True, text=True, check=False, env=no_rank() | {"PYTHONPATH": folders},
    )  # fmt: skip
    assert process.returncode == 0 and process.stdout.splitlines()[-1] == str(codes), process.stderr
    lines = log.read_text().splitlines()
    opening_calls = [line for line in lines if re.search(r"\b(open|openat|creat|truncate)\(", line)]
    assert not [line for line in opening_calls if f"<{outside_folder}>" in line]
    calls_below = [line for line in opening_calls if f'"{output}/' in line and "ENOENT" not in line]
    assert calls_below and not [line for line in calls_below if not NEW_OR_OWN.search(line)]
    assert outside_folder.read_text() == TEXT
    assert not [line for line in opening_calls if "fltk.prefs" in line]
    assert not [line for line in lines if "bind(" in line and "AF_INET" in line]


def test_a_new_scene_replaces_a_link(tmp_path: Path) -> None:
    """One that leads to nothing yet; where there is a file, it is refused."""
    path, outside_path = tmp_path / "scene.toml", tmp_path / "outside"
    path.symlink_to(outside_path)
    assert main(["new", str(path), "--quiet"]) == 0
    assert not path.is_symlink() and not outside_path.exists()
    outside_path.symlink_to(path)
    assert main(["new", str(outside_path), "--quiet"]) == 2
