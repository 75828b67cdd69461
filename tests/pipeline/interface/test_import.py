"""`import kincal`: quick, quiet, and without a trace; every public name documented and tried."""

import ast
import doctest
import inspect
import json
import subprocess
import sys

import pytest

import kincal
from tests.sources import ROOT

HEAVY = ("torch", "casadi", "pinocchio", "pandas", "numpy", "scipy", "matplotlib", "rich", "cyclopts", "pydantic")
LOOK = f"""
import json, logging, os, sys
before = dict(os.environ), list(logging.root.handlers), list(sys.path)
import kincal
names = dir(kincal)
after = dict(os.environ), list(logging.root.handlers), list(sys.path)
print(json.dumps([before == after, [m for m in {HEAVY} if m in sys.modules], names,
                  logging.getLogger("kincal").handlers != []]))
"""


def test_importing_loads_nothing_heavy_and_changes_nothing(tmp_path, environment):
    done = subprocess.run(
        [sys.executable, "-c", LOOK], cwd=tmp_path, env=environment(), capture_output=True, text=True, check=True
    )
    assert done.stderr == ""
    unchanged, heavy, names, handlers = json.loads(done.stdout)  # and nothing else was printed
    assert unchanged
    assert heavy == []
    assert not handlers
    assert set(kincal.__all__) <= set(names)


def test_using_it_sets_no_environment_variable(tmp_path, environment):
    use = (
        "import os; before = dict(os.environ); import kincal;"
        "kincal.identify(kincal.load('ups3_s', {'plan.poses': 12}));"
        "changed = {k for k in {**before, **os.environ} if before.get(k) != os.environ.get(k)};"
        "assert changed <= {'KMP_DUPLICATE_LIB_OK'}, changed"  # threadpoolctl, as it is imported
    )
    done = subprocess.run([sys.executable, "-c", use], cwd=tmp_path, env=environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout == ""


def test_the_stub_names_what_there_is():
    stub = ast.parse((ROOT / "src" / "kincal" / "__init__.pyi").read_text())
    imported = {alias.name for node in stub.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assert imported == set(kincal.__all__)
    for name in kincal.__all__:
        assert getattr(kincal, name) is not None
    with pytest.raises(AttributeError):
        kincal.no_such_name  # noqa: B018


PUBLIC = [name for name in kincal.__all__ if inspect.isfunction(getattr(kincal, name))]
NOUNS = [name for name in kincal.__all__ if inspect.isclass(getattr(kincal, name))]
OWN_NOUNS = [name for name in NOUNS if getattr(kincal, name).__module__.startswith("kincal.pipeline.interface")]


@pytest.mark.parametrize("name", PUBLIC)
def test_a_function_is_documented(name):
    """NumPy style: parameters, returns, what is raised, and an example."""
    function = getattr(kincal, name)
    text = inspect.getdoc(function) or ""
    for section in ("Parameters", "Returns", "Raises", "Examples"):
        assert f"\n{section}\n{'-' * len(section)}\n" in text, section
    for parameter in inspect.signature(function).parameters:
        assert any(parameter in line.split(", ") for line in text.splitlines()), parameter


@pytest.mark.parametrize("name", OWN_NOUNS)
def test_a_noun_is_documented(name):
    noun = getattr(kincal, name)
    assert noun.__doc__
    for member, value in vars(noun).items():
        if not member.startswith("_") and (inspect.isfunction(value) or isinstance(value, property)):
            assert inspect.getdoc(value), member


@pytest.mark.parametrize("name", sorted({*PUBLIC, *OWN_NOUNS}))
def test_the_examples_run(name, tmp_path, monkeypatch):
    """Each in an empty folder."""
    monkeypatch.chdir(tmp_path)
    found = [test for test in doctest.DocTestFinder(recurse=False).find(getattr(kincal, name), name) if test.examples]
    if name in PUBLIC:
        assert found
    runner = doctest.DocTestRunner(optionflags=doctest.IGNORE_EXCEPTION_DETAIL & 0)
    for test in found:
        failed, tried = runner.run(test)
        assert failed == 0, name
        assert tried
