"""The house rules, read from the code: who imports whom, how long a function may be."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from graphlib import TopologicalSorter
from itertools import pairwise
from pathlib import Path

import pytest
from helpers import ROOT, catch_error

import fenics_crack as fc

PACKAGE = ROOT / "fenics_crack"
MOST_STATEMENTS = 55
"""Lines without the docstring, which says what is returned and gives an example."""
MAX_PARAMETERS = 10
WITH_ONE_MORE = {"solve_harmonic_balance"}
"""Functions that have one parameter more: two for its form and the tolerance of its equations."""
DOORS = {"basics", "files"}
"""Folders that open, make, copy and remove files; all others go through them."""
OPENERS = {
    "os": {
        "fdopen", "link", "makedirs", "memfd_create", "mkdir", "mkfifo", "open", "remove", "rename",
        "replace", "rmdir", "symlink", "truncate", "unlink",
    },
    "h5py": {"File"},
    "gmsh": {"merge", "open", "write"}, "io": {"FileIO", "open"}, "np": {"load", "save"},
}  # fmt: skip
"""What opens a file, or changes a folder, of modules that have more than that."""
OPENING_MODULES = {
    "bz2", "dbm", "fileinput", "gzip", "lzma", "mmap", "pickle", "shelve", "shutil", "sqlite3",
    "tarfile", "tempfile", "zipfile",
}  # fmt: skip
OPENING_METHODS = {
    "SetFileName", "fromfile", "genfromtxt", "hardlink_to", "imread", "imsave", "lchmod", "loadtxt",
    "memmap", "mkdir", "mmread", "mmwrite", "open", "open_code", "open_memmap", "read_bytes",
    "read_csv", "read_text", "rename", "rmdir", "savefig", "savemat", "savetxt", "savez",
    "savez_compressed", "symlink_to", "tofile", "touch", "unlink", "write_bytes", "write_text",
}  # fmt: skip
"""The same of any object: of paths, arrays, figures, and of NumPy and other libraries."""
FILLED = "is filled in while it exists"
EXCEPTIONS = {
    "fenics_crack": "reads its own names",
    "fenics_crack.version read_packaged_text": "reads a text of the package",
    "fenics_crack.cli.command_line _discard_output_of_this_rank": "/dev/null",
    "fenics_crack.cli.command_line _redirect_stdout_to_null": "/dev/null",
    "fenics_crack.draw.figure Picture.save_with_title.write_file": "draws into memory",
    "fenics_crack.fem.plate write_msh": "gmsh writes to the hidden place of whole_file",
    "fenics_crack.fem.solid_mesher _import_part": "the program of its own that reads a copy",
    "fenics_crack.fem.solid_mesher read": "the program of its own that reads a copy",
    "fenics_crack.kernel.build make_builder": "has no package yet",
    "fenics_crack.kernel.build sort_headers": "has no package yet",
    "fenics_crack.kernel.build build": "has no package yet",
    "fenics_crack.sweep.file SweepFile.__init__": FILLED,
    "fenics_crack.sweep.file SweepFile.close": FILLED,
    "fenics_crack.sweep.file _make_file_and_header_unless_exists": FILLED,
    "fenics_crack.sweep.file _write_datasets_and_make_header": FILLED,
    "fenics_crack.sweep.file _copy_written_parts": FILLED,
}
"""Functions that do so elsewhere, and why."""
NEED_MPI_FIRST = {"mpi4py", "petsc4py", "slepc4py", "dolfinx"}


def module_name(path: Path) -> str:
    """``fenics_crack.model.modes``; of a folder's __init__.py the folder's."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}
FACE = {"fenics_crack", "fenics_crack.__main__"}
"""They lead to every floor."""
WINGS = {"monitoring", "fatigue"}
ABOVE_WINGS = {"cli", "draw"}


@cache
def tree(module: str) -> ast.Module:
    """Return the syntax tree of a module."""
    return ast.parse(MODULES[module].read_text())


@cache
def nodes(module: str) -> list[ast.AST]:
    """Return all nodes of a module's tree."""
    return list(ast.walk(tree(module)))


def floors() -> list[str]:
    """Return the folders in the order of docs/contributing.md, top to bottom."""
    page = (ROOT / "docs" / "contributing.md").read_text()
    section = page.split("## How it is built")[1].split("\n## ")[0]
    return re.findall(r"^    (\w+)/ ", section, re.M)


FLOORS = {
    "cyclic": "model",
    "wheel": "model",
    "sector": "fem",
    "bladed_disk": "study",
    "plot_disk": "draw",
}
"""Files of disk/, which crosses the floors, and the folder on whose floor each stands."""


def folder_of(module: str) -> str | None:
    """Its folder, None for a module beside the folders."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and (PACKAGE / parts[1]).is_dir() else None


def floor_of(module: str) -> str | None:
    """Return the folder on whose floor a module stands: its own, but in disk/."""
    folder = folder_of(module)
    return FLOORS.get(module.rpartition(".")[2], folder) if folder == "disk" else folder


@cache
def imports(module: str) -> list[tuple[str, list[str]]]:
    """Modules of the package that a module imports anywhere in its text, and the names it takes.

    A text that names a module, "study.run:solve" too, counts as an import.
    """
    module_imports: list[tuple[str, list[str]]] = []
    for node in nodes(module):
        if isinstance(node, ast.Import):
            module_imports += [
                (a.name, []) for a in node.names if a.name.startswith("fenics_crack")
            ]
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("fenics_crack"):
            for alias in node.names:
                full_name = f"{node.module}.{alias.name}"
                module_imports += [
                    (full_name, []) if full_name in MODULES else (str(node.module), [alias.name])
                ]
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            place, colon, _ = node.value.partition(":")
            place = f"fenics_crack.{place}" if colon else place
            module_imports += [(place, [])] if place in MODULES.keys() - {"fenics_crack"} else []
    return module_imports


@cache
def packages(module: str) -> list[str]:
    """Other packages that a module imports, in the order of its text."""
    package_names = []
    for node in nodes(module):
        if isinstance(node, ast.Import):
            package_names += [(node.lineno, alias.name.split(".")[0]) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            package_names.append((node.lineno, node.module.split(".")[0]))
    return [name for _, name in sorted(package_names)]


def functions() -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Every function and method, with the place where it begins."""
    for module in MODULES:
        for node in nodes(module):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                yield f"{module}:{node.lineno} {node.name}", node


def names_in(node: ast.AST) -> set[str]:
    """Names and attributes that an expression mentions."""
    parts = list(ast.walk(node))
    attributes = {part.attr for part in parts if isinstance(part, ast.Attribute)}
    return attributes | {part.id for part in parts if isinstance(part, ast.Name)}


def test_page_shows_the_folders() -> None:
    """Each folder once."""
    folder_names = [path.name for path in PACKAGE.iterdir() if (path / "__init__.py").exists()]
    assert sorted(floors()) == sorted(folder_names)


def test_folders_import_only_from_below() -> None:
    """In that page's order; what stands beside the folders imports from none."""
    order = floors()
    wrong_imports = []
    for module in MODULES.keys() - FACE:
        for target, _ in imports(module):
            own_floor, target_floor = floor_of(module), floor_of(target)
            if target in FACE or (target_floor is not None and own_floor is None):
                wrong_imports.append(f"{module} -> {target}")
            elif own_floor and target_floor and order.index(own_floor) > order.index(target_floor):
                wrong_imports.append(f"{module} -> {target}")
    assert not wrong_imports


def test_wings_stand_at_the_side() -> None:
    """Nothing but the program, its pictures and the face imports one; none imports another."""
    wrong_imports = [
        f"{module} -> {target}"
        for module in MODULES.keys() - FACE
        for target, _ in imports(module)
        if folder_of(target) in WINGS - {folder_of(module)} and folder_of(module) not in ABOVE_WINGS
    ]
    assert not wrong_imports


def test_no_circle_of_files() -> None:
    """Files can be put in an order in which each imports only from those before it."""
    graph = {module: {target for target, _ in imports(module)} for module in MODULES.keys() - FACE}
    assert list(TopologicalSorter(graph).static_order())  # raises CycleError


def test_no_private_name_is_imported() -> None:
    """What begins with an underscore is its module's own."""
    private_imports = {
        f"{module}: {target}.{name}"
        for module in MODULES
        for target, names in imports(module)
        for name in names
        if name.startswith("_")
    }
    assert not private_imports


def test_functions_are_short() -> None:
    """No function has more statements than fill a page or two, however long its names are."""
    statement_counts = {
        place: sum(isinstance(child, ast.stmt) for child in ast.walk(node)) - 1
        for place, node in functions()
    }
    assert not {place: n for place, n in statement_counts.items() if n > MOST_STATEMENTS}


def test_functions_take_few_parameters() -> None:
    """Constructors too, self left out; the fields of a dataclass are no parameters."""
    long_signatures = {}
    for place, node in functions():
        all_arguments = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
        count = len([a for a in all_arguments if a.arg not in ("self", "cls")])
        if count > MAX_PARAMETERS + (node.name in WITH_ONE_MORE):
            long_signatures[place] = count
    assert not long_signatures


def opened_in(code: ast.AST, inside: str = "") -> Iterator[tuple[str, str]]:
    """What opens a file in some code: function or method, and the words that do it."""
    for node in ast.iter_child_nodes(code):
        words = ast.unparse(node) if isinstance(node, ast.Attribute | ast.Name) else ""
        name, _, method = words.rpartition(".")
        of_object = name and method in OPENING_METHODS | OPENERS.get(name, set())
        if of_object or words in {"open", *OPENING_MODULES}:
            yield inside, words
        elif isinstance(node, ast.Import | ast.ImportFrom):
            module, names = getattr(node, "module", None), {alias.name for alias in node.names}
            renamed_imports = {alias.name for alias in node.names if alias.asname}
            hidden = {module} if isinstance(node, ast.ImportFrom) else renamed_imports
            if hidden & OPENING_MODULES or names & OPENERS.get(str(module), set()):
                yield inside, ast.unparse(node)
        scope = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef)
        yield from opened_in(node, f"{inside}.{node.name}".strip(".") if scope else inside)


def test_files_have_doors() -> None:
    """No file is opened, made, copied or removed but behind them; no exception is out of date."""
    file_openers = {
        f"{module} {function}".strip()
        for module in MODULES
        if folder_of(module) not in DOORS
        for function, _ in opened_in(tree(module))
    }
    assert file_openers == EXCEPTIONS.keys()


@pytest.mark.parametrize(
    "text",
    [
        "open(p)", "f = open", "p.open('rb')", "(gzip.open or open)(p)", "os.open(p, 0)",
        "os.replace(p, q)", "from os import link", "from shutil import copy2 as c",
        "shutil.move(p)", "Path(p).read_text()", "Path(p).write_bytes(b'')", "p.unlink()",
        "(p / 'x').mkdir()",
        "np.loadtxt(p)", "np.load(p)", "np.savez(p)", "h5py.File(p)", "figure.savefig(p)",
        "tempfile.mkdtemp()", "import lzma as x",
    ],
)  # fmt: skip
def test_doors_are_recognised(text: str) -> None:
    """Code that opens a file in one of many ways."""
    assert list(opened_in(ast.parse(f"def function():\n    {text}")))


def test_laws_answer_for_themselves() -> None:
    """No module but that of the laws asks for a law's class."""
    home = module_name(PACKAGE / "model" / "contact.py")
    laws = {node.name for node in tree(home).body if isinstance(node, ast.ClassDef)}
    law_checks = {
        f"{module}:{node.lineno}"
        for module in MODULES.keys() - {home}
        for node in nodes(module)
        if isinstance(node, ast.Call)
        and names_in(node.func) & {"isinstance", "issubclass"}
        and names_in(node.args[-1]) & laws
    }
    assert laws and not law_checks


def test_no_module_keeps_objects() -> None:
    """What is computed of an object is kept with it: no module has a dictionary to be filled."""
    kept_objects = set()
    for module in MODULES:
        for node in tree(module).body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
                is_empty_dict = isinstance(node.value, ast.Dict) and not node.value.keys
                if is_empty_dict or names_in(node.value) & {
                    "WeakKeyDictionary",
                    "WeakValueDictionary",
                }:
                    kept_objects.add(f"{module}:{node.lineno}")
    assert not kept_objects


@pytest.mark.parametrize("name", fc.__all__)
def test_face(name: str) -> None:
    """Every name of the package is there, in the file that it is said to be from, and explained."""
    public_object = getattr(fc, name)
    assert name in dir(fc)
    text = public_object.__doc__
    assert text and not text.startswith(f"{name}(")  # what a dataclass without one says


def test_unknown_name_is_no_attribute() -> None:
    """As of any module."""
    catch_error(
        lambda: fc.solve_everything, names="no attribute 'solve_everything'", kind=AttributeError
    )


def test_mpi_is_imported_before_petsc() -> None:
    """PETSc would start MPI for one thread, and MPI read settings of the working folder: a folder
    that uses them imports ``basics.ranks`` first, as the program does."""
    ranks = module_name(PACKAGE / "basics" / "ranks.py")
    order = packages(ranks)
    assert order.index("mpi4py") < order.index("petsc4py")
    for module in MODULES.keys() - {ranks}:
        if folder_of(module) != "cli" and NEED_MPI_FIRST & set(packages(module)):
            first_import = imports(f"fenics_crack.{folder_of(module)}")[:1]
            assert first_import == [(ranks, [])], module


def test_types_of_others_are_not_followed() -> None:
    """mypy takes every other package as untyped: what it finds is the same on every machine."""
    used_packages = {name for module in MODULES for name in packages(module)}
    foreign_packages = used_packages - sys.stdlib_module_names - {"fenics_crack"}
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mypy"]
    (skipped_overrides,) = (
        override for override in settings["overrides"] if override.get("follow_imports") == "skip"
    )
    assert {f"{name}.*" for name in foreign_packages} <= set(skipped_overrides["module"])


def test_face_is_sorted() -> None:
    """The list of names reads in the order of the files."""
    lines = (PACKAGE / "__init__.pyi").read_text().splitlines()
    import_lines = [line for line in lines if line.startswith("from ")]
    assert all(
        line_above.split()[1] <= two.split()[1] for line_above, two in pairwise(import_lines)
    )
