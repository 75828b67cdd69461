"""The sentences in kincal's code that people read: error messages, warnings, findings, help texts."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

from tests.sources import ROOT, sources


def messages() -> Iterator[tuple[Path, int, str]]:
    """(file, line, text) of strings that are raised, printed or handed on as findings; names in them are `..`."""
    for file in sources():
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and (name := _name(node.func)) and name.endswith("Error") and node.args:
                yield file.relative_to(ROOT), node.lineno, _text(node.args[0])
        if "commands" in file.parts:
            for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
                if isinstance(node, ast.FunctionDef) and (doc := ast.get_docstring(node)):
                    yield file.relative_to(ROOT), node.lineno, doc.partition("Parameters\n")[0]


def _name(function: ast.expr) -> str:
    return getattr(function, "id", getattr(function, "attr", ""))


def _text(node: ast.expr) -> str:
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return "".join(_text(part) if isinstance(part, ast.Constant) else "X" for part in node.values)
    if isinstance(node, ast.BinOp):
        return _text(node.left) + _text(node.right)
    return "X"
