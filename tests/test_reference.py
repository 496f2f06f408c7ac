"""The documentation's site builds without a warning and has every public name."""

import inspect
import subprocess
import sys
import zlib
from pathlib import Path

from helpers import ROOT
from numpydoc.validate import validate

import fenics_crack as fc


def test_site_builds_and_names_everything(tmp_path: Path) -> None:
    """Sphinx warns of text that it cannot read and of references that lead nowhere."""
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "docs", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    index = (
        (tmp_path / "objects.inv").read_bytes().split(b"\n", 4)[4]
    )  # behind its four first lines
    entries = [line.split() for line in zlib.decompress(index).decode().splitlines()]
    names = {name for name, kind, *_ in entries if kind.startswith("py:")}
    assert not {f"fenics_crack.{name}" for name in fc.__all__} - names
    pages = {page.stem for page in tmp_path.rglob("*.html")}
    assert {page.stem for page in (ROOT / "docs").glob("*.md")} <= pages


def test_functions_say_what_they_take() -> None:
    """Each public function explains all of its parameters and no other, above what it raises."""
    codes = ("PR01", "PR02", "GL07")  # not explained, unknown, order of the sections
    for name in fc.__all__:
        if inspect.isfunction(getattr(fc, name)):
            found = validate(f"fenics_crack.{name}")["errors"]
            assert not [words for code, words in found if code in codes], name
