"""The folder's own rule: nothing here knows the inside of the package."""

import ast
from pathlib import Path


def test_only_public_names() -> None:
    """``fenics_crack as fc``, the program, and no attribute with an underscore."""
    wrong = []
    for path in Path(__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [str(node.module)]
            elif isinstance(node, ast.Attribute) and node.attr.startswith("_"):
                wrong.append(f"{path.name}: {node.attr}")
            inner = {name for name in names if name.split(".")[0] == "fenics_crack"}
            wrong += [f"{path.name}: {name}" for name in inner - {"fenics_crack"}]
    assert not wrong
