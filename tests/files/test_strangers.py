"""Files from strangers: what they can do is to be read or to be refused, by one line."""

from __future__ import annotations

import dataclasses
import itertools
import os
import random
import re
import shutil
import signal
import site
import subprocess
import sys
import tempfile
import time
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gmsh
import h5py
import numpy as np
import pytest
from helpers import DEMOS, ROOT, catch_error, chain, changed, gmsh_model
from mpi4py import MPI
from ranks import LIMIT
from surroundings import RunCommand, no_rank

import fenics_crack as fc
from fenics_crack import SweepResult, run_sweep
from fenics_crack.basics.caches import check_private_folder, replace_unusable_caches
from fenics_crack.basics.untrusted_files import file_sha256, run_reader_for_arrays
from fenics_crack.fem.solid import read_part_triangles_and_owners
from fenics_crack.files.store import read_result_file, read_result_file_without_numbers
from fenics_crack.scene.result_tables import Sweep

SCRIPT = 'SystemCall "touch PWNED";\n'
"""What gmsh runs where it takes a file for a script, in the folder of the program."""
MESH = (ROOT / "meshes" / "inclined_crack.msh").read_text()
FROM_FILE = fc.Scene.load(DEMOS / "inclined_crack.toml")


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder in which the program runs."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def structure() -> fc.Structure:
    """A small one."""
    return chain()


@pytest.fixture
def result(structure: fc.Structure, home: Path) -> Path:
    """A result without a scene."""
    fc.save(fc.solve_linear(structure, 1.3), home / "result.h5")
    return home / "result.h5"


def refused(run_command: RunCommand, *words: object) -> str:
    """The one line with which a command refuses its input; nothing was run."""
    [line] = run_command(*words, code=2).err.splitlines()
    assert not Path("PWNED").exists()
    return str(line)


# --- meshes ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("evil.msh", SCRIPT, "$MeshFormat"),
        ("evil.geo", SCRIPT, "$MeshFormat"),
        ("late.msh", f"\n{SCRIPT}{MESH}", "$MeshFormat"),
        ("headed.msh", f"$MeshFormat\n{SCRIPT}", "$MeshFormat"),
        ("future.msh", f"$MeshFormat\n5.0 0 8\n$EndMeshFormat\n{SCRIPT}", "$MeshFormat"),
        ("bare.msh", f"$MeshFormat\n4.1 0 8\n$EndMeshFormat\n{SCRIPT}", "a plane mesh"),
        ("first.geo", f"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n{SCRIPT}{MESH[33:]}", "mesh.file"),
    ],
)
def test_a_script_is_no_mesh(
    home: Path, run_command: RunCommand, name: str, text: str, reason: str
) -> None:
    """Whatever it is called, and wherever the script stands; gmsh ran the first of these."""
    (home / name).write_text(text)
    line = refused(run_command, "check", FROM_FILE.replace({"mesh.file": str(home / name)}))
    assert "mesh.file" in line and reason in line


def test_nothing_beside_a_mesh_is_run(home: Path) -> None:
    """gmsh runs mesh.msh.opt, and what follows the elements of a mesh is left alone."""
    (home / "mesh.msh").write_text(MESH + SCRIPT)
    for file_name in ("mesh.msh.opt", "mesh.opt", "mesh.geo"):
        (home / file_name).write_text(SCRIPT)
    fc.prepare(FROM_FILE.replace({"mesh.file": "mesh.msh"}), MPI.COMM_SELF)
    assert not Path("PWNED").exists()


@pytest.mark.parametrize("how", ["polyglot", "no digest", "any digest", "script with its digest"])
def test_a_result_runs_nothing(
    home: Path, structure: fc.Structure, run_command: RunCommand, how: str
) -> None:
    """Its scene names a script as mesh, or itself, with the script before its own beginning."""
    path, evil = home / "result.h5", home / "evil.msh"
    evil.write_text(SCRIPT)
    named_path = path if how == "polyglot" else evil
    scene = FROM_FILE.replace({"mesh.file": str(named_path)})
    fc.save(fc.solve_linear(structure, 1.3), path, scene)
    with changed(path) as file:
        if how in ("polyglot", "no digest"):
            del file.attrs["meshes"]
        else:
            file.attrs["meshes"] = file_sha256(evil) if "script" in how else "0" * 64
    if how == "polyglot":
        with (
            h5py.File(path) as old_file,
            h5py.File(home / "new", "w", userblock_size=512) as new_file,
        ):
            new_file.attrs.update(old_file.attrs)
            for name in old_file:
                old_file.copy(name, new_file)
        content = (home / "new").read_bytes()
        path.write_bytes(SCRIPT.encode() + content[len(SCRIPT) :])
    reasons = {
        "polyglot": "not an HDF5 file", "no digest": "older versions", "any digest": "unchanged",
        "script with its digest": r"\$MeshFormat",
    }  # fmt: skip
    for words in (["plot", path], ["report", path], ["plot", path, path, "--label", "a"]):
        if "--label" not in words or how != "script with its digest":
            assert refused(run_command, *words) and not Path("PWNED").exists()
    key, value = ("path", path) if how in ("polyglot", "no digest") else ("mesh.file", evil)
    catch_error(lambda: fc.load_run(path), key, str(value), names=reasons[how])
    assert not Path("PWNED").exists()


@pytest.mark.parametrize("kind", ["device", "pipe", "folder", "missing"])
def test_what_a_result_names_is_a_regular_file(
    home: Path, structure: fc.Structure, kind: str
) -> None:
    """Neither a device nor a pipe is opened: they would not end."""
    os.mkfifo(home / "pipe")
    named_path = {"device": "/dev/zero", "folder": str(home)}.get(kind, str(home / kind))
    scene = FROM_FILE.replace({"mesh.file": named_path})
    began = time.perf_counter()
    fc.save(fc.solve_linear(structure, 1.3), home / "result.h5", scene)
    with changed(home / "result.h5") as file:
        file.attrs["meshes"] = "0" * 64
    catch_error(lambda: fc.load_run(home / "result.h5"), "mesh.file", named_path)
    catch_error(lambda: fc.prepare(scene), "mesh.file", named_path)
    assert time.perf_counter() - began < LIMIT


# --- parts ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def box(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A box of 30 x 90 x 6 mm as a STEP file; beside it as a BREP file."""
    path = tmp_path_factory.mktemp("box") / "box.step"
    with gmsh_model() as model:
        model.add("box")
        model.occ.addBox(0, 0, 0, 30, 90, 6)
        model.occ.synchronize()
        for ending in (".step", ".brep"):
            gmsh.write(str(path.with_suffix(ending)))
    return path


END, PRODUCT = "ENDSEC;\nEND-ISO", "PRODUCT_DEFINITION('design','',#6,#9)"


def naming(text: str, name: object, words: str = "DOCUMENT_FILE") -> str:
    """The text of a STEP file that names another file, as AP 214 or, by a word with PR, AP 203."""
    document = f"#901 = DOCUMENT('','{name}',$,#900);"
    if not words.startswith("PR"):
        file_word, reference = (words.split() + ["APPLIED_DOCUMENT_REFERENCE"])[:2]
        document = (
            f"#901 = {file_word}('{name}','',$,#900,'',$);\n#902 = {reference}(#901,'',(#5));"
        )
    else:
        text = text.replace(PRODUCT, f"{words[3:]}('design','',#6,#9,(#901))")
    return text.replace(END, f"#900 = DOCUMENT_TYPE('');\n{document}\n{END}")


REFERENCES = (
    "DOCUMENT_FILE", "DCMFL APDCRF", "PR PRODUCT_DEFINITION_WITH_ASSOCIATED_DOCUMENTS", "PR PDWAD"
)  # fmt: skip
"""Long and short words of STEP, with which OpenCASCADE opens the file that is named."""
NO_NUMBERS = ("NAN", "-nan", "/* a */NANX", "INF", "1.E+0999")


@pytest.mark.parametrize("words", REFERENCES)
def test_a_part_names_no_file(
    home: Path, box: Path, run_command: RunCommand, words: str, tmp_path_factory: Any
) -> None:
    """Neither by an absolute nor by a relative path: a STEP file that does so is refused."""
    other_path = tmp_path_factory.mktemp("other") / "other.step"
    other_path.write_text(box.read_text())
    for name in (other_path, os.path.relpath(other_path, home)):
        (home / "part.step").write_text(naming(box.read_text(), name, words))
        line = refused(run_command, "new", "scene.toml", "--cad", "part.step")
        assert "geometry.file = 'part.step'" in line and "another file" in line


@pytest.mark.parametrize("ending", [".step", ".brep"])
def test_a_part_has_finite_numbers(
    home: Path, box: Path, run_command: RunCommand, ending: str
) -> None:
    """NAN, of which gmsh did not return, and numbers too large; in names and remarks they may
    stand."""
    text = box.with_suffix(ending).read_text()
    before, number_text = {".step": ("(30.,", "30."), ".brep": ("\n1 30 ", "30")}[ending]
    assert before in text
    for number in NO_NUMBERS:
        (home / f"part{ending}").write_text(
            text.replace(before, before.replace(number_text, number))
        )
        line = refused(run_command, "new", "scene.toml", "--cad", f"part{ending}")
        assert f"geometry.file = 'part{ending}'" in line and "finite" in line
    if ending == ".step":
        words = "PRODUCT('PLATE (INF), NAN','it''s (NAN, 1.E999)'"
        text = re.sub(r"PRODUCT\('[^']*',\s*'[^']*'", words, text).replace(END, f"/* (NAN) */{END}")
        (home / "part.step").write_text(text)
        assert len(read_part_triangles_and_owners("part.step", None)["owners"]) > 6


TRACE = "trace=open,openat,openat2,creat"
OPENED = re.compile(r" = \d+<(/[^>]*)>")
"""What a system call has opened."""


@pytest.mark.nightly
@pytest.mark.skipif(shutil.which("strace") is None, reason="no strace")
def test_files_that_a_part_opens(home: Path, box: Path, tmp_path_factory: Any) -> None:
    """By all commands they lie in the scene's folder, that of the copy, the output, the caches, or
    are Python's, this program's and Debian's own. A file, a pipe and a device that parts name, or
    that are the parts, are not opened."""
    other_folder = tmp_path_factory.mktemp("other")
    temporary = tmp_path_factory.mktemp("temporary")
    (other_folder / "other.step").write_text(box.read_text())
    os.mkfifo(other_folder / "pipe.step")
    (other_folder / "zero.step").symlink_to("/dev/zero")
    shutil.copy(box, home / "part.step")
    for name, words in itertools.product(["other.step", "pipe.step", "/dev/zero"], REFERENCES):
        text = naming(box.read_text(), other_folder / name, words)
        (home / f"evil_{name.strip('/').replace('/', '_')}_{words.split()[-1]}.step").write_text(
            text
        )
    evil = [*home.glob("evil_*"), other_folder / "pipe.step", other_folder / "zero.step"]
    few_options = ["--quiet", "--set", "mesh.size=0.02", "--set", "mesh.lip_elements=2"]
    few_options += ["--set", "mesh.error=false"]
    commands = [
        (0, ["new", "part.toml", "--cad", "part.step", "--quiet"]),
        (0, ["check", "part.toml", *few_options]),
        (0, ["modes", "part.toml", *few_options]),
        *((2, ["new", "evil.toml", "--cad", str(path)]) for path in evil),
        *((2, ["check", "part.toml", "--set", f"geometry.file={path}"]) for path in evil[-2:]),
    ]  # fmt: skip
    log, began = other_folder / "log", time.perf_counter()
    tracer = ["strace", "-f", "--seccomp-bpf", "-y", "-qq", "-e", TRACE, "-A", "-o", str(log)]
    environment = no_rank() | {"TMPDIR": str(temporary)}
    for code, words in commands:
        program = [sys.executable, "-P", "-m", "fenics_crack", *words]
        done = subprocess.run(
            [*tracer, *program], check=False, env=environment, capture_output=True, text=True
        )
        assert done.returncode == code, (words, done.stderr)
        assert code == 0 or len(done.stderr.splitlines()) == 1
    assert time.perf_counter() - began < LIMIT
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    own = [ROOT, home, temporary, cache, sys.prefix, sys.base_prefix, *site.getsitepackages()]
    debian = [
        "/usr",
        "/lib",
        "/lib64",
        "/etc",
        "/proc",
        "/sys",
        "/dev/null",
        "/dev/shm",
        "/dev/urandom",
    ]
    roots = tuple(f"{os.path.realpath(root)}/" for root in [*own, *debian])
    opened_paths = {path for line in log.read_text().splitlines() for path in OPENED.findall(line)}
    assert any(path.endswith("/part.step") and str(temporary) in path for path in opened_paths)
    opened_paths.discard("/")  # by hwloc
    assert not {path for path in opened_paths if not f"{path}/".startswith(roots)}
    assert not [*temporary.iterdir()]


# --- results --------------------------------------------------------------------------------------


def soft_link(file: h5py.File) -> None:
    file["new"] = h5py.SoftLink("/omega")


def external_link(file: h5py.File) -> None:
    file["new"] = h5py.ExternalLink("/etc/passwd", "/")


def external_storage(file: h5py.File) -> None:
    file.create_dataset("new", (100,), "u1", external=[("/etc/passwd", 0, 100)])


def virtual(file: h5py.File) -> None:
    layout = h5py.VirtualLayout((3,), "f8")
    layout[:] = h5py.VirtualSource(file.filename, "other", (3,))
    file.create_virtual_dataset("new", layout)


def long(file: h5py.File) -> None:
    file.create_dataset("new", (10**12,), "f8", chunks=(1000,))


def rather_long(file: h5py.File) -> None:
    file.create_dataset("new", (10**9,), "f8", chunks=(1000,), compression="gzip")


def bomb(file: h5py.File) -> None:
    dataset = file.create_dataset("new", (2**25,), "u1", chunks=(2**23,), compression=9)
    piece = zlib.compress(bytes(2**23))
    for start in range(0, 2**25, 2**23):
        dataset.id.write_direct_chunk((start,), piece)


def long_words(file: h5py.File) -> None:
    file.create_dataset("new", (10_000,), h5py.string_dtype(), fillvalue="x" * 60_000, chunks=(10,))


def large_pieces(file: h5py.File) -> None:
    file.create_dataset("new", (1,), "f8", chunks=(10**8,), maxshape=(None,))


def unknown_filter(file: h5py.File) -> None:
    file.create_dataset("new", (1000,), "f8", compression="lzf")


def group(file: h5py.File) -> None:
    file.create_group("new")


def pairs(file: h5py.File) -> None:
    file["new"] = np.zeros(3, dtype=[("a", "f8"), ("b", "i4")])


def number(file: h5py.File) -> None:
    file.attrs["new"] = np.zeros(3)


def many(file: h5py.File) -> None:
    for name in range(10_001):
        file.create_group(str(name))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (soft_link, "is a link"), (external_link, "is a link"),
        (external_storage, "another file"), (virtual, "another file"),
        (long, "would take more"), (rather_long, "would take more"), (bomb, "would take more"),
        (long_words, "[Mm]emory"), (large_pieces, "chunks"), (unknown_filter, "filter"),
        (group, "not a dataset"), (pairs, "neither numbers nor words"), (number, "not a text"),
        (many, "parts"),
    ],
)  # fmt: skip
def test_made_results(
    result: Path, structure: fc.Structure, change: Callable[[h5py.File], None], reason: str
) -> None:
    """What points out of a file, or is larger than it can be, is not read."""
    with h5py.File(result, "r+") as file:
        change(file)
    began = time.perf_counter()
    catch_error(lambda: fc.load(result, structure), "path", str(result), names=reason)
    assert time.perf_counter() - began < LIMIT


@pytest.mark.parametrize("attribute", ["digest", "version"])
def test_a_result_of_an_older_version(
    result: Path, structure: fc.Structure, run_command: RunCommand, attribute: str
) -> None:
    """It has no digest; without another attribute it is not what was written."""
    with h5py.File(result, "r+") as file:
        del file.attrs[attribute]
    reason = "older versions did not write" if attribute == "digest" else "damaged"
    catch_error(lambda: fc.load(result, structure), "path", str(result), names=reason)
    assert reason in refused(run_command, "plot", result)


def test_words_for_numbers(result: Path, structure: fc.Structure) -> None:
    """A forger's digest is right; what is not as save writes it is refused all the same."""
    values = {"omega": "fast", "gap_coefficients": 1.0, "error_sampling": "small"}
    values |= {"subharmonic": 0, "converged": 2.0, "status": 1}
    values |= {"force_coefficients": np.full((7, 1), 1e300)}
    for name, value in values.items():
        forged_path = result.with_name(f"{name}.h5")
        shutil.copy(result, forged_path)
        with changed(forged_path) as file:
            if name in file:
                del file[name]
            file[name] = value
        catch_error(partial(fc.load, forged_path, structure), "path")
    with changed(result) as file:
        del file.attrs["versions"]
    catch_error(lambda: fc.load(result, structure), "path", names="versions")


def test_parts_that_do_not_fit(structure: fc.Structure, home: Path) -> None:
    """A forger's curve: each part is a table of numbers, and not as long as the others."""
    law = fc.UnilateralPenalty(1.0)
    curve = fc.continue_frequency(structure, 0.5, 0.52, law, harmonics=3)
    fc.save(curve, home / "curve.h5")
    assert np.array_equal(fc.load(home / "curve.h5", structure, law).omega, curve.omega)
    values = {"unknowns": curve.points[:, :-1], "iterations": curve.iterations[1:]}
    values |= {"omega": curve.omega[:, None]}
    for name, value in values.items():
        shutil.copy("curve.h5", "forged.h5")
        with changed(home / "forged.h5") as file:
            del file[name]
            file[name] = value
        catch_error(lambda: fc.load(home / "forged.h5", structure, law), "path", names="fit")


def flipped(content: bytes, rng: random.Random) -> bytes:
    """With one to three bits turned, half of them where HDF5 keeps its own."""
    changed_bytes = bytearray(content)
    for _ in range(rng.choice([1, 1, 3])):
        last_place = len(changed_bytes) if rng.random() < 0.5 else 3000
        changed_bytes[rng.randrange(last_place)] ^= 1 << rng.randrange(8)
    return bytes(changed_bytes)


def same(one: dict, other: dict) -> bool:
    """Whether two sets of arrays and words are the same, nan included."""
    return one.keys() == other.keys() and all(
        np.asarray(one[name]).tobytes() == np.asarray(other[name]).tobytes() for name in one
    )


def content_of(path: Path) -> dict[str, object]:
    """Return all that a file holds, by its names."""
    if path.name != "sweep.h5":
        result_file = read_result_file(path)
        return result_file.datasets | result_file.attributes
    sweep = SweepResult.load(path)
    return sweep.columns | {f"gap {case}": sweep.gap(case) for case in range(4)}


@pytest.mark.parametrize("kind", ["result", "swept"])
def test_flipped_bits(kind: str, home: Path, request: pytest.FixtureRequest) -> None:
    """Found, or of no meaning: nothing else is read than was written, in the header of a sweep, its
    columns, or the waves of a case neither."""
    source_path, rng = request.getfixturevalue(kind), random.Random(3)
    path = source_path if kind == "result" else Path(shutil.copy(source_path.path, home))
    original_content, content, n_found = content_of(path), path.read_bytes(), 0
    for _ in range(8):
        path.write_bytes(flipped(content, rng))
        try:
            assert same(content_of(path), original_content)
        except fc.InputError as error:
            assert "\n" not in str(error)
            n_found += 1
    assert 1 <= n_found < 8


def test_readers_know_no_rank_and_end(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Their environment, their time and their memory are limited."""
    monkeypatch.setenv("OMPI_COMM_WORLD_RANK", "1")
    program = home / "reader.py"
    start = "import os, numpy as np\ndef read(path, most):\n    "
    program.write_text(f"{start}return {{'names': np.array(list(os.environ))}}")
    names = run_reader_for_arrays(program, program, int(LIMIT))
    assert isinstance(names, dict) and "HOME" in names["names"].tolist()
    assert not any(name.startswith(("OMPI_", "PMI")) for name in names["names"].tolist())
    program.write_text(f"{start}while True: pass")
    assert run_reader_for_arrays(program, program, 1) == (
        "reading it takes more than 1 s: the file is damaged, or too large; write it again, or "
        "smaller"
    )
    program.write_text(f"{start}return {{'zeros': np.ones(2**33)}}")
    assert "allocate" in str(run_reader_for_arrays(program, program, int(LIMIT)))
    program.write_text(f"{start}np.ones(2**25)")
    assert "allocate" in str(run_reader_for_arrays(program, program, int(LIMIT), 2**28))
    program.write_text(f"{start}os._exit(0)")
    assert run_reader_for_arrays(program, program, int(LIMIT)) == (
        "the program that reads it returned nothing: the file is damaged; write it again"
    )
    program.write_text(f"{start}os.abort()")
    assert run_reader_for_arrays(program, program, int(LIMIT)) == (
        "the program that reads it crashed: the file is damaged, or too large; write it again, or "
        "smaller"
    )


def test_one_reader_reads_every_file(home: Path) -> None:
    """Each in a copy of it; where it has been killed, another one does."""
    program = home / "reader.py"
    text = "import os, numpy as np\ndef read(path, most):\n    "
    program.write_text(f"{text}return {{'ids': np.array([os.getppid(), os.getpid()])}}")

    def ids() -> list[int]:
        answer = run_reader_for_arrays(program, program, int(LIMIT))
        return [int(one) for one in answer["ids"]]

    first_ids, second = ids(), ids()
    assert first_ids[0] == second[0] and first_ids[1] != second[1]
    os.kill(first_ids[0], signal.SIGKILL)
    while Path(f"/proc/{first_ids[0]}/stat").read_text().rpartition(")")[2].split()[0] != "Z":
        time.sleep(0.01)  # nobody is at the other end of the line then
    assert ids()[0] != first_ids[0]


# --- sweeps ---------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def swept(paper_scene: fc.Scene, tmp_path_factory: pytest.TempPathFactory) -> SweepResult:
    """Four cases."""
    over = {"excitation.omega": [1900.0, 2000.0], "crack.clearance": [0.0, 1e-7]}
    scene = paper_scene.replace({"contact.stiffness": 1e9, "damping.ratio": 0.02})
    scene = dataclasses.replace(scene, sweep=Sweep.from_mapping({"over": over}))
    return run_sweep(scene, tmp_path_factory.mktemp("swept") / "sweep.h5", MPI.COMM_SELF)


@pytest.mark.drawn(3)
@pytest.mark.parametrize("name", ["response", "gap", "state", "checksum", "seconds"])
def test_a_damaged_case_is_computed_again(swept: SweepResult, home: Path, name: str) -> None:
    """It is not read, and the others stay; the state alone is known from the checksum."""
    path = home / "sweep.h5"
    shutil.copy(swept.path, path)
    column = read_result_file_without_numbers(path).columns[name]
    content = bytearray(path.read_bytes())
    content[column.offset + column.n_bytes // 4] ^= 1  # the first byte of the second case
    path.write_bytes(content)
    if name == "state":
        assert same(SweepResult.load(path).columns, swept.columns)
        return
    catch_error(lambda: SweepResult.load(path).gap(1), "path", names="run the same command again")
    resumed_sweep = run_sweep(swept.scene, path, MPI.COMM_SELF)
    assert resumed_sweep.complete and np.array_equal(resumed_sweep["response"], swept["response"])
    assert np.array_equal(resumed_sweep.gap(1), swept.gap(1))
    is_kept = resumed_sweep["seconds"].ravel() == swept["seconds"].ravel()
    assert is_kept[[0, 2, 3]].all() and not is_kept[1]


FORGED: dict[str, Callable[[h5py.File], object]] = {
    "no digest": lambda file: file.attrs.pop("digest"),
    "no scene": lambda file: file.attrs.pop("scene"),
    "kind": lambda file: file.create_dataset("response", (2, 2), "f4"),
    "shape": lambda file: file.create_dataset("response", (2, 3), "f8"),
    "place": lambda file: file.create_dataset(
        "response", (2, 2), "f8", external=[("/etc/passwd", 0, 32)]
    ),
    "long": lambda file: file.create_dataset("response", (10**6, 10**6), "f8", chunks=(1, 1)),
}


@pytest.mark.drawn(3)
@pytest.mark.parametrize("change", FORGED)
def test_made_sweeps(swept: SweepResult, home: Path, run_command: RunCommand, change: str) -> None:
    """Neither read nor continued; no command draws or reports it."""
    path = Path(shutil.copy(swept.path, home))
    with h5py.File(path, "r+") if change.startswith("no") else changed(path) as file:
        if not change.startswith("no"):
            del file["response"]
        FORGED[change](file)
    before = path.read_bytes()
    catch_error(lambda: SweepResult.load(path), "path", str(path))
    catch_error(lambda: run_sweep(swept.scene, path, MPI.COMM_SELF), "path", str(path))
    for command in ("plot", "report"):
        assert "sweep.h5" in refused(run_command, command, path)
    assert path.read_bytes() == before


# --- text -----------------------------------------------------------------------------------------


def test_byte_order_marks(home: Path) -> None:
    """That of UTF-8, which spreadsheets write, is left out; the others are named."""
    rows = "quantity,value,deviation,mode\nfrequency_bilinear,841.1,0.8,1\n"
    texts = {"scene.toml": FROM_FILE.as_toml(), "rows.csv": rows, "times.csv": "revolution,probe\n"}
    readers = {
        "scene": fc.Scene.load,
        "measurements": fc.Measurements.from_csv,
        "path": fc.ArrivalTimes.from_csv,
    }
    for name, text in texts.items():
        (home / name).write_text(text, encoding="utf-8-sig")
    assert fc.Scene.load("scene.toml").material == FROM_FILE.material
    assert len(fc.Measurements.from_csv("rows.csv")) == 1
    catch_error(
        lambda: fc.ArrivalTimes.from_csv("times.csv"), "path", "times.csv", names=r"'angle \[rad\]'"
    )  # the first column is found
    for (name, text), (key, reader) in zip(texts.items(), readers.items(), strict=True):
        (home / name).write_text(text, encoding="utf-16")
        catch_error(partial(reader, name), key, name, names="UTF-16")


# --- caches ---------------------------------------------------------------------------------------


@pytest.fixture
def temporary(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder that takes the place of caches, not yet made."""
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    for name in ("HOME", "XDG_CACHE_HOME", "MPLCONFIGDIR"):  # to be put back
        monkeypatch.setenv(name, os.environ.get(name, str(tmp_path)))
    return place / f"fenics-crack-{os.geteuid()}"


@pytest.mark.parametrize("lost", ["HOME", "XDG_CACHE_HOME"])
def test_a_home_that_takes_no_files(
    lost: str, tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file in its place; a folder of this user's alone is used, and no other."""
    (tmp_path / "file").touch()
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv(lost, str(tmp_path / "file"))
    replace_unusable_caches.__wrapped__()
    assert os.environ[lost] == str(temporary) and temporary.stat().st_mode & 0o777 == 0o700
    temporary.chmod(0o755)
    monkeypatch.setenv(lost, str(tmp_path / "file"))
    catch_error(replace_unusable_caches.__wrapped__, lost, str(tmp_path / "file"))


@pytest.mark.parametrize("place", ["cache", "cache/fenics", "parent", "link"])
def test_a_cache_that_others_can_write(
    place: str, tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It, what it lies in or what it leads to: a folder of this user's alone takes its place."""
    parent = tmp_path / "parent"
    (parent / "cache" / "fenics").mkdir(0o755, parents=True)
    (tmp_path / "link").symlink_to(parent / "cache")
    cache = tmp_path / "link" if place == "link" else parent / "cache"
    monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    shared_path = {"parent": parent, "link": parent}.get(place, parent / place)
    for mode, is_kept in (
        (0o755, True),
        (0o1777, place in ("cache", "parent", "link")),
        (0o775, False),
    ):
        shared_path.chmod(mode)
        replace_unusable_caches.__wrapped__()
        assert (os.environ["XDG_CACHE_HOME"] == str(cache)) == is_kept
        monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
    assert temporary.is_dir() and temporary.stat().st_mode & 0o777 == 0o700


@pytest.mark.skipif(os.geteuid() != 0, reason="root alone gives folders away")
def test_a_cache_of_another_user(
    tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is not used, nor is one within that of this user."""
    cache = tmp_path / "cache"
    (cache / "fenics").mkdir(parents=True)
    for cache_path in (cache, cache / "fenics"):
        os.chown(cache_path, 1000, 1000)
        monkeypatch.setenv("XDG_CACHE_HOME", str(cache))
        replace_unusable_caches.__wrapped__()
        assert os.environ["XDG_CACHE_HOME"] == str(temporary)
        os.chown(cache_path, 0, 0)


def test_a_new_cache(tmp_path: Path, temporary: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It is made when it is used, for this user alone, whatever others may do with new files."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "new" / "cache"))
    replace_unusable_caches.__wrapped__()
    assert not temporary.exists() and not (tmp_path / "new").exists()
    earlier_mask = os.umask(0)
    try:
        check_private_folder(tmp_path / "new" / "cache")
    finally:
        os.umask(earlier_mask)
    for folder in ("new", "new/cache"):
        assert (tmp_path / folder).stat().st_mode & 0o777 == 0o700
