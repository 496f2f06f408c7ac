"""The mutants of benchmarks/mutants.py: which are drawn, and what they change."""

from __future__ import annotations

import ast
from collections import Counter
from pathlib import Path

import mutants
import pytest

PYTHON = '''
def energy(mass: int, speeds: list, most: float = 1.5) -> float:
    """Say "1 + 1"."""
    if len(speeds) <= 2:
        raise ValueError(f"{mass + 1} - 2", 1 - 2)
    total = 0.5 * mass * (  # by halves
        -speeds[0]
    )
    return total + scale(mass, most) + max(mass, most) + 2.0 * TOLERANCE
'''
C = """
#define HALF 0.5
/* Says "a + b". */
static double energy(const double *v, int n, double m) {
    double sum = 0.5 * m - work(v, n);  // 1 + 1
    for (int i = 0; i < n; i++) sum += v[i] * m;
    return sum + m * v[1];
}
"""


def changed_lines(path: str, source: str) -> set[tuple[str, str]]:
    """Return kind and changed line of each mutant."""
    edit = mutants.PythonMutations if path.endswith(".py") else mutants.CMutations
    lines = set()
    for mutation in edit(Path(path), source.encode()):
        mutant = source[: mutation.start] + mutation.replacement + source[mutation.end :]
        if path.endswith(".py"):
            ast.parse(mutant)
        pairs = zip(source.splitlines(), mutant.splitlines(), strict=False)
        lines.add(
            (
                mutation.kind,
                next(
                    line_after.strip()
                    for line_before, line_after in pairs
                    if line_before != line_after
                ),
            )
        )
    return lines


def test_mutants_of_python() -> None:
    """Messages, types, defaults, calls without an order and tolerances stay as they are."""
    assert changed_lines("a.py", PYTHON) == {
        ("comparison", "if len(speeds) >= 2:"),
        ("off by one", "if len(speeds) <= 3:"),
        ("constant", "total = 0.505 * mass * (  # by halves"),
        ("term", "total = 0.5  * (  # by halves"),
        ("term", "total = 0.5 * mass"),
        ("sign", "speeds[0]"),
        ("off by one", "-speeds[1]"),
        ("sign", "return total - scale(mass, most) + max(mass, most) + 2.0 * TOLERANCE"),
        ("sign", "return total + scale(mass, most) - max(mass, most) + 2.0 * TOLERANCE"),
        ("sign", "return total + scale(mass, most) + max(mass, most) - 2.0 * TOLERANCE"),
        ("term", "return total  + max(mass, most) + 2.0 * TOLERANCE"),
        ("term", "return total + scale(mass, most)  + 2.0 * TOLERANCE"),
        ("term", "return total + scale(mass, most) + max(mass, most)"),
        ("term", "return total + scale(mass, most) + max(mass, most) + 2.0"),
        ("arguments", "return total + scale(most, mass) + max(mass, most) + 2.0 * TOLERANCE"),
    }


def test_mutants_of_c() -> None:
    """Code in the bodies of functions is changed, and neither comments nor definitions."""
    assert changed_lines("a.c", C) == {
        ("sign", "double sum = 0.5 * m + work(v, n);  // 1 + 1"),
        ("constant", "double sum = 0.505000000000 * m - work(v, n);  // 1 + 1"),
        ("arguments", "double sum = 0.5 * m - work(n, v);  // 1 + 1"),
        ("off by one", "for (int i = 1; i < n; i++) sum += v[i] * m;"),
        ("comparison", "for (int i = 0; i > n; i++) sum += v[i] * m;"),
        ("sign", "for (int i = 0; i < n; i++) sum -= v[i] * m;"),
        ("sign", "return sum - m * v[1];"),
        ("term", "return sum;"),
        ("off by one", "return sum + m * v[2];"),
    }


def test_draw() -> None:
    """As many of each kind, the same for a seed."""
    path = "fenics_crack/disk/cyclic.py"
    choices = mutants.all_mutations(mutants.ROOT, path)
    mutations = mutants.draw(choices, 1, 12)
    assert mutations == mutants.draw(choices, 1, 12) != mutants.draw(choices, 2, 12)
    assert set(Counter(mutation.kind for mutation in mutations).values()) == {2}
    place, line_before, line_after = mutations[0].lines(mutants.ROOT)
    number = int(place.removeprefix(f"{path}:"))
    assert (
        line_before
        == (mutants.ROOT / path).read_text().splitlines()[number - 1].strip()
        != line_after
    )


def test_tests_that_reach_a_mutant(tmp_path: Path) -> None:
    """Those of its folder first, then the cheapest; all of a file whose fixtures reach it."""
    files = {
        "model/a.py": "def inner(x):\n    return (\n        -x\n    )\n",
        "model/b.py": "def outer(x):\n    kernel.sum_of(x)\n",
        "kernel/c.c": "double diff(double a) {\n    return 1 - a;\n}\n"
        "double sum_of(double a) {\n    return diff(a);\n}\n",
    }
    for name, text in files.items():
        (tmp_path / "fenics_crack" / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / "fenics_crack" / name).write_text(text)
    tests_of_lines = {
        "model/a.py": {
            2: ["", "tests/curves/test_d.py::test_dear|run", "tests/fem/test_e.py::test_cheap|run"],
            3: ["tests/model/test_f.py::test_first[1]|setup"],
        },
        "model/b.py": {2: ["tests/kernel/test_g.py::test_sum|run"]},
    }
    seconds = {
        "tests.curves.test_d::test_dear": 5.0, "tests.curves.test_d::test_other": 0.1,
        "tests.fem.test_e::test_cheap": 0.1, "tests.model.test_f::test_first[1]": 9.0,
        "tests.model.test_f::test_next": 9.0, "tests.kernel.test_g::test_sum": 1.0,
    }  # fmt: skip
    reach = mutants.Reach(
        tmp_path,
        lambda file: tests_of_lines[str(Path(file).relative_to(tmp_path / "fenics_crack"))],
        seconds,
    )
    in_python, *_, in_c = mutants.all_mutations(tmp_path)
    assert list(reach.tests_of(in_python).items()) == [
        (
            "tests/model/test_f.py",
            [f"tests/model/test_f.py::test_{n}" for n in ("first[1]", "next")],
        ),
        ("tests/fem/test_e.py", ["tests/fem/test_e.py::test_cheap"]),
        ("tests/curves/test_d.py", ["tests/curves/test_d.py::test_dear"]),
    ]
    assert reach.tests_of(in_c) == {"tests/kernel/test_g.py": ["tests/kernel/test_g.py::test_sum"]}


def test_mutant_is_undone(tmp_path: Path) -> None:
    """What a file held is returned."""
    (tmp_path / "a.py").write_text(PYTHON)
    mutation = next(iter(mutants.PythonMutations(Path("a.py"), PYTHON.encode())))
    assert mutation.apply(tmp_path) == PYTHON.encode() != (tmp_path / "a.py").read_bytes()


@pytest.mark.parametrize("number", ["0.0", "1e-12", "20000.0"])
def test_limits_are_no_factors(number: str) -> None:
    """Tiny and large numbers are tolerances and limits."""
    assert mutants.c_replacement("constant", number) == number
