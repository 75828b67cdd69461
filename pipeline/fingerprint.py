"""What a stage's code is, from syntax trees alone: nothing is imported, comments and docstrings don't count.

A stage's fingerprint is the function, what it names in its own module, and the transitive import closure of the
project's modules that it names, whole modules each: methods, dispatch tables and constants count.
"""

from __future__ import annotations

import ast
import hashlib
from functools import lru_cache
from pathlib import Path

ROOT = Path(__file__).parent.parent
PACKAGES = ("urdf", "identification", "learning", "pipeline")


def fingerprint(module: str, function: str, root: Path = ROOT) -> dict[str, str]:
    """{unit of code: digest} of a stage function, by name, in a project module."""
    parsed = _parse(module, root)
    definitions = {n.name: n for n in parsed.body if isinstance(n, (ast.FunctionDef, ast.ClassDef))}
    assignments = {t.id: n for n in parsed.body if isinstance(n, ast.Assign) for t in n.targets if isinstance(t, ast.Name)}
    imports = _bindings(parsed, root)
    named, queue, imported = {}, [function], set()
    while queue:
        name = queue.pop()
        node = definitions.get(name) or assignments.get(name)
        if name in imports:
            imported.update(imports[name])
        if node is None or name in named:
            continue
        named[name] = ast.dump(node)
        imported.update(m for found in _bindings(node, root).values() for m in found)
        queue += [n.id for n in ast.walk(node) if isinstance(n, ast.Name)]
    own = hashlib.sha256("\n".join(named[n] for n in sorted(named)).encode()).hexdigest()
    return {f"{module}:{function}": own} | {m: _digest(m, root) for m in sorted(_closure(imported, root))}


def _closure(modules: set[str], root: Path) -> set[str]:
    found, queue = set(), list(modules)
    while queue:
        module = queue.pop()
        if module not in found:
            found.add(module)
            queue += [m for names in _bindings(_parse(module, root), root).values() for m in names]
    return found


def _bindings(node: ast.AST, root: Path) -> dict[str, tuple[str, ...]]:
    """{name: project modules that it comes from} of every import below `node`."""
    bound: dict[str, tuple[str, ...]] = {}
    for statement in ast.walk(node):
        if isinstance(statement, ast.ImportFrom) and statement.module and statement.level == 0:
            for alias in statement.names:
                inner = f"{statement.module}.{alias.name}"
                modules = [statement.module] + ([inner] if _file(inner, root) else [])
                _bind(bound, alias.asname or alias.name, modules)
        elif isinstance(statement, ast.Import):
            for alias in statement.names:
                _bind(bound, (alias.asname or alias.name).partition(".")[0], [alias.name])
    return bound


def _bind(bound: dict[str, tuple[str, ...]], name: str, modules: list[str]) -> None:
    """The project's modules among `modules`, their packages included: importing one runs those too."""
    ours: list[str] = []
    for module in modules:
        parts = module.split(".")
        if parts[0] in PACKAGES:
            ours += [".".join(parts[:k]) for k in range(1, len(parts) + 1)]
    if ours:
        bound[name] = (*bound.get(name, ()), *ours)


def _file(module: str, root: Path) -> Path | None:
    base = root / module.replace(".", "/")
    return next((f for f in (base.with_suffix(".py"), base / "__init__.py") if f.is_file()), None)


@lru_cache(maxsize=256)
def _parse(module: str, root: Path) -> ast.Module:
    file = _file(module, root)
    parsed = ast.parse(file.read_text(encoding="utf-8") if file else "")
    for node in ast.walk(parsed):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant) and isinstance(first.value.value, str):
                node.body = node.body[1:]
    return parsed


@lru_cache(maxsize=256)
def _digest(module: str, root: Path) -> str:
    # Data that a module loads by its own name (page templates) is part of it.
    file = _file(module, root)
    templates = sorted((file.parent / "templates").glob(f"{file.stem}.*")) if file else []
    content = [ast.dump(_parse(module, root)).encode(), *(t.read_bytes() for t in templates)]
    return hashlib.sha256(b"\n".join(content)).hexdigest()
