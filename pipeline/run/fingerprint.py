"""What a stage's code is, from syntax trees alone: nothing is imported, comments and docstrings don't count.

A stage's fingerprint is the function, what it names in its own module, and the transitive import closure of the
project's modules that it names, whole modules each: methods, dispatch tables and constants count. A package whose
`__init__.py` has no code is no unit.
"""

from __future__ import annotations

import ast
import hashlib
import symtable
import sys
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).parents[3]  # of the package; links to the folders are not resolved
PACKAGES = ("kincal",)
_WHOLE = ""  # the unit that is a whole module

# {function: (digest, the project's modules that it imports)}, or {_WHOLE: the same}: functions are seldom asked for
Facts = dict[str, tuple[str, list[str]]]


@dataclass
class Code:
    """The project's code below `root`. `memo` holds what was found before, by the source's own digest."""

    root: Path = ROOT
    memo: dict[str, Facts] = field(default_factory=dict)
    used: dict[str, Facts] = field(default_factory=dict)
    _facts: dict[tuple[str, bool], Facts] = field(default_factory=dict)
    _confirmed: set[str] = field(default_factory=set)  # modules that were imported as they had been digested
    _templates: dict[Path, list[Path]] = field(default_factory=dict)  # {folder of a package: all of its templates}
    _found: dict[tuple[str, str], dict[str, str]] = field(default_factory=dict)

    def fingerprint(self, module: str, function: str) -> dict[str, str]:
        """{unit of code: digest} of a stage function, by name, in a project module."""
        if (module, function) not in self._found:
            self._found[module, function] = self._fingerprint(module, function)
        return self._found[module, function]

    def _fingerprint(self, module: str, function: str) -> dict[str, str]:
        digest, imports = self._of(module, whole=False)[function]
        units = {f"{module}:{function}": digest}
        queue = list(imports)
        while queue:
            name = queue.pop()
            if name not in units:
                units[name], imports = self._of(name, whole=True)[_WHOLE]
                queue += imports
        return {name: digest for name, digest in sorted(units.items()) if digest != _NO_CODE}

    def edited(self, module: str, function: str) -> str | None:
        """A module that the function names and that was edited after it had been digested: other code may have run.

        Stages import what they need as they run. A module that is imported stays as it is: one look each is enough.
        """
        now = Code(self.root, self.memo)
        for name in self.fingerprint(module, function):
            if name in sys.modules and name not in self._confirmed:
                try:
                    if now._of(name, whole=True) != self._of(name, whole=True):
                        return name
                except SyntaxError:  # saved half done
                    return name
                self._confirmed.add(name)
        return None

    def _of(self, module: str, whole: bool) -> Facts:
        if (module, whole) not in self._facts:
            file = _file(module, self.root)
            source = file.read_bytes() if file else b""
            # Page templates that a module loads by its own name are part of it.
            templates = self._templates_of(file) if file else []
            extra = b"\0".join(t.read_bytes() for t in templates)
            version = f"{module} {whole} {sys.version_info[:2]} ".encode()
            key = hashlib.sha256(version + source + b"\0" + extra).hexdigest()
            if key not in self.memo:
                self.memo[key] = _whole(source, extra, self.root) if whole else _by_name(source, self.root)
            self._facts[module, whole] = self.used[key] = self.memo[key]
        return self._facts[module, whole]

    def _templates_of(self, file: Path) -> list[Path]:
        if file.parent not in self._templates:
            self._templates[file.parent] = sorted((file.parent / "templates").glob("*"))
        return [t for t in self._templates[file.parent] if t.name.startswith(f"{file.stem}.")]


_NO_CODE = hashlib.sha256(ast.dump(ast.parse("")).encode()).hexdigest()  # of a package that is a docstring


def _whole(source: bytes, extra: bytes, root: Path) -> Facts:
    parsed = _parsed(source)
    return {_WHOLE: (_sha(ast.dump(parsed).encode() + extra), _modules(parsed, root))}


def _by_name(source: bytes, root: Path) -> Facts:
    parsed, facts = _parsed(source), {}
    definitions = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    named = {n.name: n for n in parsed.body if isinstance(n, definitions)}
    # Any other statement counts for each name that it touches.
    others: dict[str, list[ast.AST]] = {}
    for statement in parsed.body:
        if statement not in named.values():
            for name in _touched(statement):
                others.setdefault(name, []).append(statement)
    scopes = {t.get_name(): t for t in symtable.symtable(source.decode(), "<source>", "exec").get_children()}
    for name in named:
        seen: dict[int, ast.AST] = {}
        queue = [name]
        done: set[str] = set()
        while queue:
            part = queue.pop()
            if part in done:
                continue
            done.add(part)
            for node in [*([named[part]] if part in named else []), *others.get(part, [])]:
                if id(node) not in seen:
                    seen[id(node)] = node
                    queue += _globals(node, scopes.get(part)) if node is named.get(part) else _names(node)
        text = "\n".join(sorted(ast.dump(node) for node in seen.values()))
        facts[name] = (_sha(text.encode()), sorted({m for node in seen.values() for m in _modules(node, root)}))
    return facts


def _touched(statement: ast.stmt) -> set[str]:
    """The names that a statement binds, changes or may change: X = .., X["a"] = .., X += .., X.append(..)."""
    names: set[str] = set()
    for node in ast.walk(statement):
        if isinstance(node, ast.Assign):
            targets: list[ast.AST] = list(node.targets)
        elif isinstance(node, (ast.AnnAssign, ast.AugAssign, ast.For, ast.NamedExpr)):
            targets = [node.target]
        elif isinstance(node, ast.Expr):
            targets = [node.value]
        elif isinstance(node, ast.withitem):
            targets = [node]
        else:
            targets = []
        names |= {n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)}
        if isinstance(node, (ast.Import, ast.ImportFrom)):
            names |= {alias.asname or alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            names.add(node.name)
    return names


def _globals(node: ast.AST, scope: symtable.SymbolTable | None) -> list[str]:
    """The module-level names that a definition uses: Python's own scoping for bodies, every name elsewhere."""
    if scope is None:
        return _names(node)
    names, scopes = [], [scope]
    while scopes:
        table = scopes.pop()
        names += [s.get_name() for s in table.get_symbols() if s.is_global()]
        scopes += table.get_children()
    # Annotations, defaults, decorators and bases are evaluated outside the body.
    for inner in ast.walk(node):
        parts = [getattr(inner, "annotation", None), getattr(inner, "returns", None)]
        parts += [*getattr(inner, "decorator_list", []), *getattr(inner, "bases", [])]
        parts += [*getattr(inner, "defaults", []), *getattr(inner, "kw_defaults", [])]
        names += [n.id for part in parts if part is not None for n in ast.walk(part) if isinstance(n, ast.Name)]
    return names


def _names(node: ast.AST) -> list[str]:
    return [n.id for n in ast.walk(node) if isinstance(n, ast.Name)]


def _sha(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _parsed(source: bytes) -> ast.Module:
    """Without docstrings."""
    parsed = ast.parse(source)
    for node in ast.walk(parsed):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)) and node.body:
            first = node.body[0]
            if (
                isinstance(first, ast.Expr)
                and isinstance(first.value, ast.Constant)
                and isinstance(first.value.value, str)
            ):
                node.body = node.body[1:]
    return parsed


def _modules(node: ast.AST, root: Path) -> list[str]:
    """The project's modules that anything below `node` imports, their packages included: importing one runs those."""
    modules: set[str] = set()
    for statement in ast.walk(node):
        names: Iterable[str] = ()
        if isinstance(statement, ast.ImportFrom) and statement.module and statement.level == 0:
            inner = (f"{statement.module}.{alias.name}" for alias in statement.names)
            names = [statement.module, *(m for m in inner if m.partition(".")[0] in PACKAGES and _file(m, root))]
        elif isinstance(statement, ast.Import):
            names = [alias.name for alias in statement.names]
        for name in names:
            parts = name.split(".")
            if parts[0] in PACKAGES:
                modules.update(".".join(parts[:k]) for k in range(1, len(parts) + 1))
    return sorted(modules)


def _file(module: str, root: Path) -> Path | None:
    base = root / module.replace(".", "/")
    return next((f for f in (base.with_suffix(".py"), base / "__init__.py") if f.is_file()), None)
