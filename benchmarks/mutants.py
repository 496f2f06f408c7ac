"""Do the tests notice a wrong line in the mechanics? Mutants of the Python and C code.

Each mutant has one small mistake, drawn with a seed, as many of each kind:

    sign          + for - and - for +, or a minus left out
    term          the last term or factor left out
    arguments     two neighbouring arguments of a call swapped
    comparison    < for >, <= for >=, == for !=, and the reverse
    off by one    an integer in a sum, an index, a range or a comparison, plus 1
    constant      a factor or term such as 0.5 plus 1 %

Messages, type hints, defaults, limits of iterations and tolerances are left alone: there a change
of 1 % is no mistake. At first all of README's tests run once, to note which lines each of them
reaches (by ``pip install pytest-cov``; a quarter of an hour). A mutant is made in a copy of the
checkout in a temporary folder, where the tests that reach its statement run until one fails: those
of its own folder first, then the cheapest. A mutant is killed by a test that fails, crashes or
takes more than ``TEST_LIMIT``, or by the compiler. It survives if all these tests pass, or all that
were run within ``--limit`` seconds by the clock; of the others, only tests that start a process of
their own can reach it. At the end the tests that failed run once more, without a mistake.

    OMP_NUM_THREADS=1 python benchmarks/mutants.py [--seed N] [--number N] [--only PATTERN]
        [--limit SECONDS] [folder]

The folder keeps what the tests reach, by commit, and mutants-SEED.csv, to which rows are added as
they are found; a run goes on where it was stopped, and repeats what is taken out of the file.
"""

from __future__ import annotations

import argparse
import ast
import csv
import importlib
import os
import random
import re
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = Path("fenics_crack")
FOLDERS = (
    "model", "balance", "curves", "motion", "time", "fem", "disk", "numerics", "fatigue", "study",
    "kernel",
)  # fmt: skip
"""Folders of the package that compute."""
READERS = ("msh_file", "matrix_files", "model_pairs", "model_files", "matrix_formats", "matrices")
"""Modules there that read files."""
TEST_LIMIT = 60.0
"""Processor time of a test [s]; nearly all take less than a few seconds."""
MEMORY_LIMIT = 8 * 2**30
"""Address space of the tests [bytes]."""
KINDS = ("sign", "term", "arguments", "comparison", "off by one", "constant")
SIGNS = {"+": "-", "-": "+"}
COMPARISONS = {"<": ">", ">": "<", "<=": ">=", ">=": "<=", "==": "!=", "!=": "=="}
SYMBOLS: dict[type[ast.AST], str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Lt: "<", ast.Gt: ">",
    ast.LtE: "<=", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=",
}  # fmt: skip
EQUIVALENT_CALLS = re.compile(
    "(.*Error|isinstance|getattr|hasattr|zip|warn.*|info|debug|check.*|refuse.*|require.*)$"
)
"""Calls whose arguments are messages, or have no order that matters."""
SYMMETRIC_CALLS = {"min", "max", "maximum", "minimum", "hypot", "fmin", "fmax", "allclose", "vdot"}
TEXTS = (ast.JoinedStr, ast.List, ast.Tuple, ast.ListComp)
COLUMNS = ("number", "place", "function", "kind", "before", "after", "killed by", "seconds")
C_VALUE = r"[A-Za-z_]\w*(?:(?:->|\.)\w+|\[[^][]*\])*"
C_NUMBER = r"(?<![\w.])\d+\.\d*(?:e-?\d+)?"
C_PATTERNS = {
    "sign": r"(?<=[\w\])] )[+-](?==? )",
    "term": rf"(?<=[\w\])]) [+-] {C_VALUE}(?: [*/] {C_VALUE})*(?=[;,)\]]| [-+<>])",
    "arguments": rf"(?<=\w\(){C_VALUE}, {C_VALUE}(?=[,)])",
    "comparison": r"(?<= )(?:[<>]=?|[=!]=)(?= )",
    "off by one": r"(?<=[-+<>=] )\d+(?=[;,)\]]| [<>+-])|(?<=\[)\d+(?=\])",
    "constant": rf"(?<=[-+*/] ){C_NUMBER}|{C_NUMBER}(?= [-+*/] )",
}
"""What is changed in C, by kind."""

C_FUNCTION = re.compile(r"(?ms)^\w[^;{}=]*?(\w+)\([^;{}]*\)\s*\{.*?^\}")
FIRST_FILES = 4
"""Test files that run first, before the others are collected."""
ORDER = "FENICS_CRACK_TEST_ORDER"
"""Variable of the environment that names a file: the tests to be run, in their order."""


@dataclass(frozen=True)
class Mutation:
    """A change of bytes ``start`` to ``end`` of a file in the package."""

    path: Path
    function: str
    kind: str
    start: int
    end: int
    replacement: str

    def lines(self, root: Path) -> tuple[str, str, str]:
        """Return the place, and the lines that are changed before and after."""
        source = (root / self.path).read_bytes()
        line_start = source.rfind(b"\n", 0, self.start) + 1
        line_end = source.find(b"\n", self.end)
        mutant = (
            source[line_start : self.start]
            + self.replacement.encode()
            + source[self.end : line_end]
        )
        line = source.count(b"\n", 0, self.start) + 1
        line_before, line_after = (
            " ".join(text.decode().split()) for text in (source[line_start:line_end], mutant)
        )
        return f"{self.path}:{line}", line_before, line_after

    def apply(self, root: Path) -> bytes:
        """Change the file and return what it held."""
        file = root / self.path
        source = file.read_bytes()
        file.write_bytes(source[: self.start] + self.replacement.encode() + source[self.end :])
        return source


def all_mutations(root: Path, pattern: str = "") -> list[Mutation]:
    """Return all mutations of files whose path fits a regular expression."""
    mutations: list[Mutation] = []
    for folder in FOLDERS:
        for file in sorted((root / PACKAGE / folder).glob("*.[cp]*")):
            path = file.relative_to(root)
            is_mechanics = file.suffix in (".py", ".c") and file.stem not in (*READERS, "build")
            if is_mechanics and re.search(pattern, str(path)):
                edit = PythonMutations if file.suffix == ".py" else CMutations
                mutations += edit(path, file.read_bytes())
    return mutations


def draw(mutations: list[Mutation], seed: int, number: int) -> list[Mutation]:
    """Draw mutations, as many of each kind."""
    generator = random.Random(seed)
    pools = [[mutation for mutation in mutations if mutation.kind == kind] for kind in KINDS]
    for pool in pools:
        generator.shuffle(pool)
    mutations_in_turn = [
        pool[turn] for turn in range(max(map(len, pools))) for pool in pools if turn < len(pool)
    ]
    return mutations_in_turn[:number]


class PythonMutations:
    """The mutations of a module, by the positions of its syntax tree's nodes."""

    def __init__(self, path: Path, source: bytes) -> None:
        self._path, self._source = path, source
        self._line_starts = [0]
        for line in source.splitlines(keepends=True):
            self._line_starts.append(self._line_starts[-1] + len(line))

    def __iter__(self) -> Iterator[Mutation]:
        for node in ast.walk(ast.parse(self._source)):
            if isinstance(node, ast.FunctionDef):
                for statement in node.body:
                    yield from self._in_node(statement, node, node.name)

    def _span(self, node: ast.AST) -> tuple[int, int]:
        """Return the bytes at which a node begins and ends."""
        start = self._line_starts[node.lineno - 1] + node.col_offset
        return start, self._line_starts[node.end_lineno - 1] + node.end_col_offset

    def _in_node(self, node: ast.AST, parent: ast.AST, function: str) -> Iterator[Mutation]:
        """Yield the mutations of a node, and of what it holds unless this is a message or type."""
        if isinstance(node, ast.Raise | ast.Assert | ast.JoinedStr | ast.FunctionDef):
            return
        if isinstance(node, ast.Call) and EQUIVALENT_CALLS.match(name_of_call(node)):
            return
        for kind, (start, end), replacement in self._edits(node, parent):
            yield Mutation(self._path, function, kind, start, end, replacement)
        for name, field in ast.iter_fields(node):
            for child in field if isinstance(field, list) else [field]:
                if isinstance(child, ast.AST) and name != "annotation":
                    yield from self._in_node(child, node, function)

    def _edits(self, node: ast.AST, parent: ast.AST) -> Iterator[tuple[str, tuple[int, int], str]]:
        """Yield kind, bytes and replacement of each mutation of a node."""
        if isinstance(node, ast.BinOp) and type(node.op) in SYMBOLS:
            if not any(
                isinstance(side, TEXTS) or is_text(side) for side in (node.left, node.right)
            ):
                symbol = self._operator(node.left, node.right, node.op)
                if (text := SYMBOLS[type(node.op)]) in SIGNS:
                    yield "sign", symbol, SIGNS[text]
                yield "term", (symbol[0], self._span(node)[1]), ""
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub):
            start = self._span(node)[0]
            yield "sign", (start, start + 1), ""
        elif isinstance(node, ast.Compare) and type(node.ops[0]) in SYMBOLS:
            symbol = self._operator(node.left, node.comparators[0], node.ops[0])
            yield "comparison", symbol, COMPARISONS[SYMBOLS[type(node.ops[0])]]
        elif isinstance(node, ast.Call) and name_of_call(node) not in SYMMETRIC_CALLS:
            for first_argument, second in zip(node.args, node.args[1:], strict=False):
                yield from self._swap_arguments(first_argument, second)
        elif isinstance(node, ast.Constant):
            kind = constant_kind(node, parent)
            if kind == "off by one":
                yield kind, self._span(node), str(node.value + 1)
            elif kind == "constant":
                yield kind, self._span(node), f"{1.01 * node.value:.12g}"

    def _operator(self, left: ast.AST, right: ast.AST, operator: ast.AST) -> tuple[int, int]:
        """Return the bytes of an operator between two nodes."""
        text = SYMBOLS[type(operator)].encode()
        start = self._source.index(text, self._span(left)[1], self._span(right)[0])
        return start, start + len(text)

    def _swap_arguments(
        self, left_argument: ast.AST, right_argument: ast.AST
    ) -> Iterator[tuple[str, tuple[int, int], str]]:
        """Yield two neighbouring arguments swapped, if they differ and none is starred."""
        (start, middle), (right_start, end) = self._span(left_argument), self._span(right_argument)
        left_text, right_text = self._source[start:middle], self._source[right_start:end]
        is_starred = isinstance(left_argument, ast.Starred) or isinstance(
            right_argument, ast.Starred
        )
        if left_text != right_text and not is_starred:
            swapped_text = right_text + self._source[middle:right_start] + left_text
            yield "arguments", (start, end), swapped_text.decode()


def name_of_call(node: ast.Call) -> str:
    """Return the last name of what is called."""
    return ast.unparse(node.func).rpartition(".")[2]


def is_text(node: ast.AST) -> bool:
    """Whether a node is a string."""
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def constant_kind(node: ast.Constant, parent: ast.AST) -> str:
    """Return the kind of mutation that a constant takes, or nothing."""
    is_range = isinstance(parent, ast.Call) and name_of_call(parent) == "range"
    if type(node.value) is int:
        counts = isinstance(parent, ast.BinOp | ast.Compare | ast.Slice | ast.Subscript)
        return "off by one" if counts or is_range else ""
    is_factor = type(node.value) is float and isinstance(parent, ast.BinOp)
    if not is_factor or not 1e-3 <= node.value <= 1e4:
        return ""
    return "" if re.search(r"\b[A-Z][A-Z_]+\b", ast.unparse(parent)) else "constant"


class CMutations:
    """The mutations of a file in C, by regular expressions on its code."""

    def __init__(self, path: Path, source: bytes) -> None:
        self._path, self._source = path, source

    def __iter__(self) -> Iterator[Mutation]:
        blank = lambda match: re.sub(rb"[^\n]", b" ", match[0])  # noqa: E731
        aside = rb'(?s)/\*.*?\*/|//[^\n]*|"(?:\\.|[^"\\])*"|(?m:^#[^\n]*)'
        code = re.sub(aside, blank, self._source).decode("latin-1")
        for body in C_FUNCTION.finditer(code):
            body_start = body[0].index("{") + body.start()
            for kind, pattern in C_PATTERNS.items():
                for match in re.compile(pattern).finditer(code, body_start, body.end()):
                    replacement = c_replacement(kind, match[0])
                    if replacement != match[0]:
                        span = (match.start(), match.end())
                        yield Mutation(self._path, body[1], kind, *span, replacement)


def c_replacement(kind: str, text: str) -> str:
    """Return the mutant of a piece of C."""
    if kind == "constant":
        is_factor = 1e-3 <= float(text) <= 1e4
        return f"{1.01 * float(text):#.12g}" if is_factor else text
    if kind == "arguments":
        return ", ".join(reversed(text.split(", ", 1)))
    if kind == "off by one":
        return str(int(text) + 1)
    return "" if kind == "term" else (SIGNS | COMPARISONS)[text]


TestsOfLines = Callable[[str], Mapping[int, Sequence[str]]]
"""The tests that ran each line of a file, with their phase: ``tests/test_a.py::test_b|run``."""


class Reach:
    """Tests that reach each statement of the package.

    A statement of Python is reached by the tests that ran one of its lines, a function in C by
    those that ran a call of it, or of a function that uses it, as ``kernel.NAME``. What a test
    reached while its fixtures were made counts for all tests of its file.
    """

    def __init__(
        self, root: Path, tests_of_lines: TestsOfLines, seconds: Mapping[str, float]
    ) -> None:
        self._root, self._tests_of_lines, self._seconds = root, tests_of_lines, seconds

    @classmethod
    def measured(cls, root: Path, folder: Path) -> Reach:
        """Run README's tests once, unless the folder has what they reached at this commit."""
        commit = common.commit()
        lines_file, times_file = folder / f"reach-{commit}.sqlite", folder / f"reach-{commit}.xml"
        if not times_file.exists():
            options = ("--cov=fenics_crack", "--cov-context=test", "--cov-report=")
            subprocess.run(
                [sys.executable, "-m", "pytest", "-q", *options, f"--junitxml={times_file}"],
                cwd=root, env={**os.environ, "COVERAGE_FILE": str(lines_file)}, check=False,
            )  # fmt: skip
        data = importlib.import_module("coverage").CoverageData(str(lines_file))
        data.read()
        cases = ElementTree.parse(times_file).iter("testcase")
        seconds = {
            f"{case.get('classname')}::{case.get('name')}": float(case.get("time", 0.0))
            for case in cases
        }
        return cls(root, data.contexts_by_lineno, seconds)

    def tests_of(self, mutation: Mutation) -> dict[str, list[str]]:
        """Return the tests that reach a mutation, by file, in the order in which they run."""
        contexts = set().union(*map(self._contexts, self._statements(mutation)))
        reaching_tests = {context.rpartition("|")[0] for context in contexts if context}
        shared_files = {
            context.partition("::")[0] for context in contexts if context.endswith("|setup")
        }
        tests, costs = defaultdict[str, list[str]](list), Counter[str]()
        for name, seconds in self._seconds.items():
            module, _, case = name.partition("::")
            file = module.replace(".", "/") + ".py"
            if file in shared_files or f"{file}::{case}" in reaching_tests:
                tests[file].append(f"{file}::{case}")
                costs[file] += seconds
        own_folder = f"tests/{mutation.path.parent.name}/"
        files = sorted(tests, key=lambda file: (not file.startswith(own_folder), costs[file]))
        return {file: tests[file] for file in files}

    def _contexts(self, place: tuple[Path, range]) -> set[str]:
        """Return the tests that ran one of the lines of a module, each with its phase."""
        path, lines = place
        tests_of_line = self._tests_of_lines(str(self._root / path))
        return {context for line in lines for context in tests_of_line.get(line, ())}

    def _statements(self, mutation: Mutation) -> Iterator[tuple[Path, range]]:
        """Yield file and lines of the statement that holds a mutation, or that calls it in C."""
        if mutation.path.suffix == ".py":
            source = (self._root / mutation.path).read_bytes()
            line = source.count(b"\n", 0, mutation.start) + 1
            first_line = max(
                node.lineno
                for node in ast.walk(ast.parse(source))
                if isinstance(node, ast.stmt) and node.lineno <= line <= node.end_lineno
            )
            yield mutation.path, range(first_line, line + 1)
            return
        calls = re.compile(rf"\bkernel\.({'|'.join(self._users(mutation.function))})\b")
        for file in sorted((self._root / PACKAGE).rglob("*.py")):
            for line, text in enumerate(file.read_text().splitlines(), 1):
                if calls.search(text):
                    yield file.relative_to(self._root), range(line, line + 1)

    def _users(self, function: str) -> set[str]:
        """Return a function of the kernel and all functions there that use it."""
        bodies = [
            (match[1], set(re.findall(r"\w+", match[0])))
            for file in (self._root / PACKAGE / "kernel").glob("*.c")
            for match in C_FUNCTION.finditer(file.read_text())
        ]
        users, count = {function}, 0
        while count < len(users):
            count = len(users)
            users |= {name for name, words in bodies if words & users}
        return users


class Copy:
    """A copy of the checkout in which mutants are made and tested."""

    def __init__(self, folder: Path, reach: Reach) -> None:
        self.root, self._objects, self._reach = folder / "checkout", folder / "kernel", reach
        command = ["git", "-C", str(ROOT), "ls-files", "-z"]
        names = subprocess.run(command, capture_output=True, check=True, text=True).stdout
        libraries = [str(file.relative_to(ROOT)) for file in ROOT.glob("fenics_crack/kernel/*.so")]
        for name in [*filter(None, names.split("\0")), *libraries]:
            (self.root / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, self.root / name)

    def killer(self, mutation: Mutation, limit: float) -> str:
        """Return the test that kills a mutant within a time [s], or nothing."""
        tests = self._reach.tests_of(mutation)
        files = list(tests)
        source = mutation.apply(self.root)
        try:
            is_built = mutation.path.suffix == ".py" or self._build(mutation.path)
            failures = [] if is_built else ["the compiler"]
            end = time.monotonic() + limit
            for group in (files[:FIRST_FILES], files[FIRST_FILES:]):
                if group and not failures and time.monotonic() < end:
                    names = [name for file in group for name in tests[file]]
                    failures = self.failures(names, end - time.monotonic())
        finally:
            (self.root / mutation.path).write_bytes(source)
        if mutation.path.suffix == ".c":
            self._build(mutation.path)
        return failures[0] if failures else ""

    def failures(self, tests: list[str], limit: float | None = None) -> list[str]:
        """Run tests up to the first failure and return it, or the signal that ended the run;
        without a limit, run all of them."""
        options = ["-q", "-n", "0", "-p", "no:cacheprovider", "-p", "mutants", "--tb=no"]
        options += ["-x"] if limit is not None else []
        order = self.root.parent / "order"
        order.write_text("\n".join(tests))
        files = dict.fromkeys(name.partition("::")[0] for name in tests)
        paths = os.pathsep.join(map(str, (self.root, self.root / "benchmarks")))
        process = subprocess.Popen(
            [sys.executable, "-m", "pytest", *options, *files], start_new_session=True,
            cwd=self.root, env={**os.environ, "PYTHONPATH": paths, ORDER: str(order)},
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT,) * 2),
        )  # fmt: skip
        try:
            output, _ = process.communicate(timeout=limit)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
            return []
        if process.returncode < 0:
            return [signal.Signals(-process.returncode).name]
        if process.returncode in (3, 4):
            raise RuntimeError(output)
        return re.findall(r"(?m)^(?:FAILED|ERROR) (tests/.*?)(?: - .*)?$", output)

    def _build(self, path: Path) -> bool:
        """Compile a file of the kernel and link it with the others; False if it is refused."""
        build = importlib.import_module("fenics_crack.kernel.build")
        if not self._objects.exists():
            build.make_builder(self._objects).compile(tmpdir=str(self._objects))
        (target,) = self._objects.rglob(f"{path.stem}.o")
        command = [
            "cc",
            *build.COMPILER_FLAGS,
            "-fPIC",
            "-c",
            str(self.root / path),
            "-o",
            str(target),
        ]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            return False
        objects = map(str, self._objects.rglob("*.o"))
        (library,) = self.root.glob("fenics_crack/kernel/*.so")
        library.unlink()
        subprocess.run(["cc", "-shared", *objects, "-o", str(library), "-lm"], check=True)
        return True


def pytest_collection_modifyitems(items: list[Any]) -> None:
    """Leave the tests that are to be run, in their order."""
    order = {name: i for i, name in enumerate(Path(os.environ[ORDER]).read_text().splitlines())}
    items[:] = sorted(
        (item for item in items if item.nodeid in order), key=lambda item: order[item.nodeid]
    )


def pytest_runtest_setup() -> None:
    """End the process if a test takes more than its processor time."""
    signal.setitimer(signal.ITIMER_PROF, TEST_LIMIT)


def mutants(arguments: argparse.Namespace) -> None:
    """Draw, test and report mutants."""
    mutations = draw(all_mutations(ROOT, arguments.pattern), arguments.seed, arguments.number)
    file = arguments.folder / f"mutants-{arguments.seed}.csv"
    rows = list(csv.reader(file.read_text().splitlines()))[1:] if file.exists() else []
    reach = Reach.measured(ROOT, arguments.folder.resolve())
    with tempfile.TemporaryDirectory() as scratch:
        copy = Copy(Path(scratch), reach)
        known_numbers = {int(row[0]) for row in rows}
        for number, mutation in enumerate(mutations):
            if number in known_numbers:
                continue
            start_time = time.monotonic()
            killer = copy.killer(mutation, arguments.limit)
            place, line_before, line_after = mutation.lines(copy.root)
            seconds = f"{time.monotonic() - start_time:.0f}"
            description = (place, mutation.function, mutation.kind, line_before, line_after)
            rows.append([str(number), *description, killer, seconds])
            common.write_csv(file, COLUMNS, rows)
            print(f"{number:3} {place} ({mutation.kind}, {seconds} s): {killer or 'SURVIVES'}")
            print(f"      {line_before}\n   -> {line_after}", flush=True)
        killers = sorted({row[6] for row in rows if "::" in row[6]})
        failures = copy.failures(killers) if killers else []
    survivors = [row for row in rows if not row[6]]
    print(f"\n{len(rows) - len(survivors)} of {len(rows)} are killed; these survive:")
    print("\n".join(["Without a mistake, too, these fail:", *failures] if failures else []))
    for row in survivors:
        print(f"{row[1]} ({row[3]})\n      {row[4]}\n   -> {row[5]}")


if __name__ == "__main__":
    import common

    common.run(
        __doc__,
        {"mutants": mutants},
        seed={"type": int, "default": 1, "help": "of the draw"},
        number={"type": int, "default": 40, "help": "mutants"},
        limit={"type": float, "default": 300.0, "help": "seconds for the tests of a mutant"},
        only={"dest": "pattern", "default": "", "help": "files whose path fits this expression"},
    )
