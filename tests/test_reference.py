"""The documentation's site builds without a warning and has every public name."""

import doctest
import inspect
import re
import subprocess
import sys
import zlib
from pathlib import Path
from typing import Any

import pytest
from helpers import ROOT
from numpydoc.validate import validate

import fenics_crack as fc

pytestmark = pytest.mark.usefixtures("not_laid_out")


@pytest.mark.nightly
def test_site_builds_and_names_everything(tmp_path: Path) -> None:
    """Sphinx warns of text that it cannot read and of references that lead nowhere."""
    builder = ["sphinx", "-b", "singlehtml"]  # one page, which takes a fifth less
    command = [sys.executable, "-m", *builder, "-W", "--keep-going", "-q", "docs", str(tmp_path)]
    process = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    index = (
        (tmp_path / "objects.inv").read_bytes().split(b"\n", 4)[4]
    )  # behind its four first lines
    entries = [line.split() for line in zlib.decompress(index).decode().splitlines()]
    names = {name for name, kind, *_ in entries if kind.startswith("py:")}
    assert not {f"fenics_crack.{name}" for name in fc.__all__} - names
    pages = {name for name, kind, *_ in entries if kind == "std:doc"}
    assert {page.stem for page in (ROOT / "docs").glob("*.md")} <= pages


FUNCTIONS = [name for name in fc.__all__ if inspect.isfunction(getattr(fc, name))]


@pytest.mark.parametrize("name", FUNCTIONS)
def test_functions_say_what_they_take(name: str) -> None:
    """Each public function explains all of its parameters and no other, above what it raises, and
    what it returns, with an example."""
    errors = dict(validate(f"fenics_crack.{name}")["errors"])
    # Not explained, unknown, order of the sections; nothing said of what is returned, no example.
    assert not errors.keys() & {"PR01", "PR02", "GL07", "RT01", "EX01"}


@pytest.fixture(scope="module")
def names() -> dict[str, Any]:
    """What docs/reference/examples.md makes for the examples."""
    text = (ROOT / "docs" / "reference" / "examples.md").read_text()
    [block] = re.findall(r"```python\n(.*?)```", text, re.S)
    objects: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        exec(compile(block, "examples.md", "exec"), objects)
    return objects


DEAR = {"amplification", "draw_amplification", "draw_wheel"}
"""Functions whose examples solve many wheels."""
EXAMPLES = [pytest.param(name, marks=[pytest.mark.nightly] * (name in DEAR)) for name in FUNCTIONS]


@pytest.mark.drawn(15)
@pytest.mark.usefixtures("not_drawn")
@pytest.mark.parametrize("name", EXAMPLES)
def test_examples_run(
    name: str, names: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As they stand, one after the other."""
    monkeypatch.chdir(tmp_path)
    text = inspect.getdoc(getattr(fc, name))
    assert text
    namespace = dict(names)
    for example in doctest.DocTestParser().get_examples(text):
        if doctest.SKIP not in example.options:
            exec(compile(example.source, name, "exec"), namespace)
