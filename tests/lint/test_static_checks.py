"""What `make lint` asks of the static checks: no complaint, and every source file looked at, each once.

Most of the package lies behind the links of src/kincal, and each tool treats links in its own way. A tool that enters
none reports no error either. `make test` leaves these tests out: pyright takes about a minute.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import grimp

from tests.sources import ROOT, sources


def _run(*words: str) -> subprocess.CompletedProcess[str]:
    program = Path(sys.executable).parent / words[0]
    environment = os.environ | {"PYRIGHT_PYTHON_IGNORE_WARNINGS": "1"}
    return subprocess.run([program, *words[1:]], cwd=ROOT, env=environment, capture_output=True, text=True)


def _complaint(found: dict) -> str:
    """A diagnostic of pyright as its command line prints it."""
    start = found["range"]["start"]
    place = f"{found['file']}:{start['line'] + 1}:{start['character'] + 1}"
    return f"{place} - {found['severity']}: {found['message']} ({found.get('rule', 'syntax')})"


def _module(file: Path) -> str:
    """The dotted name under which a source file is imported."""
    parts = file.relative_to(ROOT).with_suffix("").parts
    parts = parts[1:] if parts[0] == "src" else ("kincal", *parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def test_pyright_checks_every_file_once_and_finds_no_error():
    run = _run("pyright", "--outputjson")
    assert run.stdout.startswith("{"), run.stdout + run.stderr
    report = json.loads(run.stdout)
    complaints = "\n".join(_complaint(found) for found in report["generalDiagnostics"])
    assert report["summary"]["errorCount"] == 0, complaints
    assert run.returncode == 0, complaints + run.stderr
    n = len(sources("*.py")) + len(sources("*.pyi"))
    assert report["summary"]["filesAnalyzed"] == n, f"{n} source files; the include list of tool.pyright is wrong"


def test_ruff_checks_every_file_once():
    run = _run("ruff", "check", "--show-files")
    assert run.returncode == 0, run.stdout + run.stderr
    listed = Counter(Path(line).resolve() for line in run.stdout.splitlines())
    assert not [str(file) for file in [*sources("*.py"), *sources("*.pyi")] if listed[file.resolve()] != 1]


def test_imports_keep_their_contracts():
    run = _run("lint-imports", "--no-cache")
    assert run.returncode == 0, run.stdout + run.stderr


def test_import_linter_sees_every_module():
    graph = grimp.build_graph("kincal", cache_dir=None)
    assert graph.modules == {_module(file) for file in sources()}
