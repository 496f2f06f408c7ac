"""The documentation's code runs, and its lists are whole."""

import re

import pytest
from helpers import ROOT

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCKS = [
    pytest.param(code, id=f"{page.name} {number}")
    for page in PAGES
    for number, code in enumerate(re.findall(r"```python\n(.*?)```", page.read_text(), re.S))
]


@pytest.mark.parametrize("code", BLOCKS)
def test_python_block_runs(code: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each block is a whole program, run in the project's folder."""
    monkeypatch.chdir(ROOT)
    exec(compile(code, "documentation", "exec"), {"__name__": "documentation"})


def test_links_lead_somewhere() -> None:
    """Relative links and the files named in the README exist."""
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text()):
            assert (page.parent / target).exists(), f"{page.name}: {target}"
    for name in re.findall(r"`((?:demos|docs|tests)/[\w./]+\.\w+)`", PAGES[0].read_text()):
        assert (ROOT / name).exists(), name


def test_readme_starts_with_the_two_commands() -> None:
    """Exactly the two lines that a newcomer needs."""
    commands = re.findall(r"^    (sh install\.sh && .*)$", PAGES[0].read_text(), re.M)
    assert commands == [
        "sh install.sh && .venv/bin/python demos/paper_plate.py",
        "sh install.sh && .venv/bin/python -m pytest",
    ]
