"""All sentences that the program prints, in one list that people read: ``messages.txt``.

``python tests/test_messages.py`` writes the list anew. An error reads ``key = value: sentence``.
Names in braces stand for what is there when the program runs.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator

from surroundings import ROOT

MESSAGE_LIST = ROOT / "tests" / "messages.txt"
PACKAGE = ROOT / "fenics_crack"
MIN_WORDS = 4
"""Minimum words of a sentence; shorter texts are names, keys and headings."""


def template(node: ast.AST) -> str:
    """Return an expression's text, with names in braces for what is not literal."""
    match node:
        case ast.Constant(value=str(text)):
            return text
        case ast.JoinedStr(values=parts):
            return "".join(map(template, parts))
        case ast.BinOp(left=left, right=right):
            return template(left) + template(right)
        case ast.IfExp(body=body, orelse=otherwise):
            return " | ".join(filter(None, map(template, (body, otherwise))))
        case ast.Name(id=name) | ast.Attribute(attr=name):
            return f"{{{name}}}"
        case ast.FormattedValue(value=value) | ast.Subscript(value=value):
            return template(value)
        case ast.Call(args=[argument, *_]):
            return template(argument)
        case ast.Call(func=function):
            return template(function)
    return "{}"


def sentences(node: ast.AST) -> Iterator[str]:
    """Yield the sentences below a node in their order, docstrings left out."""
    match node:
        case ast.Expr(value=ast.Constant()):
            return
        case ast.Call(func=ast.Name(id="InputError"), args=[key, value, allowed]):
            yield f"{template(key)} = {template(value)}: {template(allowed)}"
            return
        case ast.Constant(value=str()) | ast.JoinedStr() | ast.BinOp(op=ast.Add()):
            text = template(node)
            words = re.findall(r"(?<![\w.{])[A-Za-z][a-z']*(?![\w=(}])", text)
            if len(words) >= MIN_WORDS and " " in text.strip():
                yield text
                return
    for child in ast.iter_child_nodes(node):
        yield from sentences(child)


def list_messages() -> str:
    """Return the sentences of all modules, each module's below its name."""
    paragraphs = []
    for path in sorted(PACKAGE.rglob("*.py")):
        lines = dict.fromkeys(sentences(ast.parse(path.read_text())))
        if lines:
            paragraphs.append("\n".join([f"[{path.relative_to(PACKAGE)}]", *lines]))
    return "\n\n".join(paragraphs) + "\n"


def test_list_has_all_sentences() -> None:
    """A sentence that changes is read once more, in the list."""
    assert MESSAGE_LIST.read_text() == list_messages()


if __name__ == "__main__":
    MESSAGE_LIST.write_text(list_messages())
