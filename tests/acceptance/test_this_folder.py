"""The folder's own rule: nothing here knows the inside of the package."""

import ast
from pathlib import Path


def test_only_public_names() -> None:
    """``fenics_crack as fc``, the program, and no attribute with an underscore."""
    private_names = []
    for path in Path(__file__).parent.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                names = [str(node.module)]
            elif isinstance(node, ast.Attribute) and node.attr.startswith("_"):
                private_names.append(f"{path.name}: {node.attr}")
            package_imports = {name for name in names if name.split(".")[0] == "fenics_crack"}
            private_names += [f"{path.name}: {name}" for name in package_imports - {"fenics_crack"}]
    assert not private_names
