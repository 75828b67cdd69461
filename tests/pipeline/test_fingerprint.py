"""The fingerprint of a stage's code: what changes it, and what does not."""

import ast
import json
import re
import subprocess
import sys
from functools import lru_cache
from importlib import import_module
from pathlib import Path

import pytest

from kincal.pipeline.run.fingerprint import PACKAGES, Code
from kincal.pipeline.stages.registry import STAGES
from tests.sources import sources

NAMES = list(STAGES)
PLACES = {name: (function.__module__, function.__name__) for name, (function, _) in STAGES.items()}


@pytest.fixture
def project(copy_project, tmp_path) -> Path:
    """The project's own packages, to be edited."""
    return copy_project(tmp_path / "project")


@lru_cache
def _memo() -> dict:
    """What is known of the project's unchanged files; `test_a_memo_changes_no_answer` shows that it may be used."""
    code = Code()
    for name in NAMES:
        code.fingerprint(*PLACES[name])
    return code.used


def stages(root: Path) -> dict[str, dict[str, str]]:
    code = Code(root, memo=dict(_memo()))
    return {name: code.fingerprint(*PLACES[name]) for name in NAMES}


def append(file: Path, text: str) -> None:
    file.write_text(file.read_text() + text)


@pytest.mark.parametrize("text", ["\n# a comment\n", "\n\n\n", "    # indented\n"])
def test_comments_and_blank_lines_do_not_count(project, text):
    before = stages(project)
    for package in PACKAGES:
        for file in (project / package).rglob("*.py"):
            append(file, text)
    assert stages(project) == before


def test_a_module_that_was_edited_before_it_was_imported(project):
    """What ran was perhaps not what had been digested; comments are no edit, and later ones change nothing."""
    code = Code(project, memo=dict(_memo()))
    code.fingerprint(*PLACES["identify"])
    file = project / "kincal" / "urdf" / "errors.py"
    append(file, "\n# a comment\n")
    assert code.edited(*PLACES["identify"]) is None
    append(file, "EDITED = 1\n")
    assert code.edited(*PLACES["identify"]) is None
    code = Code(project, memo=dict(_memo()))
    code.fingerprint(*PLACES["identify"])
    for text in ("EDITED = 2\n", "def half(:\n"):
        append(file, text)
        assert code.edited(*PLACES["identify"]) == "kincal.urdf.errors"


def test_docstrings_do_not_count(project):
    before = stages(project)
    edited = 0
    for package in PACKAGES:
        for file in (project / package).rglob("*.py"):
            text = file.read_text()
            new = re.sub(r'^( *)"""(?=[A-Z])', r'\1"""Said otherwise. ', text, flags=re.MULTILINE)
            edited += new != text
            file.write_text(new)
    assert edited > 10
    assert stages(project) == before


KINEMATIC = {"model", "plan", "measure", "identify", "evaluate"}


@pytest.mark.parametrize(
    "file, must, must_not",
    [
        ("kincal/urdf/rigid_motion.py", KINEMATIC, set()),  # three imports away
        ("kincal/identification/estimators.py", {"identify"}, {"model", "plan"}),
        ("kincal/identification/accuracy.py", {"evaluate"}, {"model", "plan", "measure"}),
        ("kincal/pipeline/virtual/robot.py", {"measure", "evaluate"}, {"model", "plan", "identify", "report"}),
        ("kincal/pipeline/report/page.py", {"report"}, KINEMATIC),
        ("kincal/pipeline/commands/app.py", set(), set(NAMES)),
        ("kincal/pipeline/store/store.py", set(), set(NAMES)),
    ],
)
def test_a_helper_counts_for_the_stages_that_import_it(project, file, must, must_not):
    """What is in neither set may run again: too much is safe."""
    before = stages(project)
    append(project / file, "\ndef _new_helper():\n    return 1\n")
    after = stages(project)
    changed = {name for name in NAMES if before[name] != after[name]}
    assert must <= changed
    assert not changed & must_not


def test_the_difference_names_the_module(project):
    before = stages(project)["identify"]
    append(project / "kincal/urdf/rigid_motion.py", "\n_X = 1\n")
    after = stages(project)["identify"]
    assert [name for name in after if before[name] != after[name]] == ["kincal.urdf.rigid_motion"]


def test_page_templates_count_for_the_report_alone(project):
    before = stages(project)
    append(project / "kincal/pipeline/report/templates/page.html", "<!-- changed -->")
    after = stages(project)
    assert {name for name in NAMES if before[name] != after[name]} == {"report"}


def test_a_memo_changes_no_answer(project):
    cold = Code(project)
    plain = {name: cold.fingerprint(*PLACES[name]) for name in NAMES}
    memo = json.loads(json.dumps(cold.used))  # as it comes back from the store
    warm = Code(project, memo=dict(memo))
    assert {name: warm.fingerprint(*PLACES[name]) for name in NAMES} == plain
    append(project / "kincal/urdf/kinematics.py", "\n_X = 1\n")
    changed = Code(project, memo=dict(memo))
    assert {name: changed.fingerprint(*PLACES[name]) for name in NAMES} == stages(project) != plain


def test_nothing_is_imported(project):
    append(project / "kincal/urdf/rigid_motion.py", "\nraise SystemExit('imported')\n")
    assert "kincal.urdf.rigid_motion" in stages(project)["model"]


def test_the_project_has_no_import_that_a_syntax_tree_hides():
    """Relative and computed imports would be outside of the closure."""
    for file in sources():
        for node in ast.walk(ast.parse(file.read_text())):
            assert not (isinstance(node, ast.ImportFrom) and node.level), f"{file}: relative import"
            assert not (isinstance(node, ast.Name) and node.id == "__import__"), file
            assert not (isinstance(node, ast.Attribute) and node.attr == "import_module"), file


def test_what_a_stage_really_imports_is_in_its_closure(finished, tmp_path, environment):
    """Too little never: every project module that a running stage loads is among its units of code."""
    script = f"""
import json, sys
from pathlib import Path
import kincal.pipeline.commands.app
from kincal.pipeline.store.store import Store
from kincal.pipeline.run.fingerprint import PACKAGES
from kincal.pipeline.run.runner import Run
from kincal.urdf.description import load_robot
ours = lambda: {{m for m in sys.modules if m.partition(".")[0] in PACKAGES}}
run, found = Run(load_robot("ups3_s", {finished.settings}), Store(Path("store"))), {{}}
for stage in {NAMES}:
    before = ours()
    run.until(stage)
    found[stage] = sorted(ours() - before)
print(json.dumps(found))
"""
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, env=environment(), capture_output=True, text=True, check=True
    )
    loaded = json.loads(done.stdout)
    assert any(loaded.values())
    code = Code()
    for stage, modules in loaded.items():
        assert {m for m in modules if not _is_docstring(m)} <= set(code.fingerprint(*PLACES[stage]))


def _is_docstring(module: str) -> bool:
    """Of a package without code."""
    file = Path(import_module(module).__file__)
    return file.name == "__init__.py" and all(isinstance(node, ast.Expr) for node in ast.parse(file.read_text()).body)


# A project of a few lines, for one rule of scoping at a time.

STAGE = "from __future__ import annotations\n{top}\ndef stage(x: int):\n    {body}\n\ndef other():\n    return 0\n"


def small(root: Path, top: str = "", body: str = "return 0", **modules: str) -> dict[str, str]:
    for package in ("kincal", "kincal/urdf", "kincal/pipeline"):
        (root / package).mkdir(exist_ok=True)
        (root / package / "__init__.py").write_text("")
    for name, text in modules.items():
        (root / "kincal" / "urdf" / f"{name}.py").write_text(text)
    (root / "kincal" / "pipeline" / "stages.py").write_text(STAGE.format(top=top, body=body))
    return Code(root).fingerprint("kincal.pipeline.stages", "stage")


@pytest.mark.parametrize(
    "before, after",
    [
        ("X = 1", "X = 2"),
        ("X: int = 1", "X: int = 2"),
        ("X, Y = 1, 2", "X, Y = 3, 2"),
        ("X = Y = 1", "X = Y = 2"),
        ("X = 1\nX += 1", "X = 1\nX += 2"),
        ("X = 1\nX = X + 1", "X = 2\nX = X + 1"),
        ("if True:\n    X = 1", "if True:\n    X = 2"),
        ("Y = 1\nX = Y + 1", "Y = 2\nX = Y + 1"),
        ("X = {}\nX['a'] = 1", "X = {}\nX['a'] = 2"),
        ("X = []\nX.append(1)", "X = []\nX.append(2)"),
        ("def X():\n    return 1", "def X():\n    return 2"),
        ("async def X():\n    return 1", "async def X():\n    return 2"),
        ("X = lambda: 1", "X = lambda: 2"),
        ("class X:\n    def f(self):\n        return 1", "class X:\n    def f(self):\n        return 2"),
        ("def Y():\n    return 1\nX = {'a': Y}", "def Y():\n    return 2\nX = {'a': Y}"),
        ("try:\n    X = 1\nexcept Exception:\n    X = 0", "try:\n    X = 2\nexcept Exception:\n    X = 0"),
        ("for X in (1, 2):\n    pass", "for X in (1, 3):\n    pass"),
        ("from math import sin as X", "from math import cos as X"),
    ],
    ids=lambda text: text.replace("\n", "; "),
)  # fmt: skip
def test_what_a_stage_names_in_its_own_module_counts(tmp_path, before, after):
    assert small(tmp_path, before, "return X") != small(tmp_path, after, "return X")


@pytest.mark.parametrize(
    "body",
    [
        "return [X for _ in range(3)]",
        "return lambda: X",
        "def inner():\n        return X\n    return inner",
        "def inner(y=X):\n        return y\n    return inner",
        "class Inner:\n        y = X\n    return Inner",
        "class Inner(X):\n        pass\n    return Inner",
        "global X\n    X += 1",
        "return f'{X}'",
    ],
)  # fmt: skip
def test_names_are_found_wherever_a_body_uses_them(tmp_path, body):
    assert small(tmp_path, "X = 1", body) != small(tmp_path, "X = 2", body)


@pytest.mark.parametrize(
    "body",
    [
        "other = 1\n    return other",
        "return [other for other in range(3)]",
        "return (lambda other: other)(x)",
        "def inner(other):\n        return other\n    return inner(x)",
        "return x.other",
    ],
)
def test_a_local_variable_does_not_couple_two_stages(tmp_path, body):
    before = small(tmp_path, body=body)
    file = tmp_path / "kincal" / "pipeline" / "stages.py"
    file.write_text(file.read_text().replace("return 0", "return 1"))
    assert Code(tmp_path).fingerprint("kincal.pipeline.stages", "stage") == before


@pytest.mark.parametrize(
    "before, after",
    [
        ("def f():\n    return 1", "def f():\n    return 2"),
        ("X = 1\ndef f():\n    return X", "X = 2\ndef f():\n    return X"),
        ("class f:\n    def g(self):\n        return 1", "class f:\n    def g(self):\n        return 2"),
        (
            "def g(): return 1\ndef h(): return 2\nT = {'g': g}\ndef f():\n    return T",
            "def g(): return 1\ndef h(): return 2\nT = {'g': h}\ndef f():\n    return T",
        ),
    ],
    ids=["function", "constant", "method", "dispatch table"],
)
@pytest.mark.parametrize("where", ["near", "far"])
def test_imported_modules_count_whole(tmp_path, before, after, where):
    """near: imported by the stage; far: three imports away."""
    body = "from kincal.urdf.a import f\n    return f()"

    def chain(end: str) -> dict[str, str]:
        if where == "near":
            return {"a": end}
        return {"a": "from kincal.urdf.b import f", "b": "import kincal.urdf.c\nf = kincal.urdf.c.f", "c": end}

    assert small(tmp_path, body=body, **chain(before)) != small(tmp_path, body=body, **chain(after))


@pytest.mark.parametrize(
    "body, name",
    [
        ("import kincal.urdf.a", "kincal"),
        ("from kincal.urdf import a", "a"),
        ("from kincal.urdf.a import f", "f"),
        ("import kincal.urdf.a as b", "b"),
    ],
)
@pytest.mark.parametrize("at", ["top", "inside"])
def test_every_way_to_import_counts(tmp_path, body, name, at):
    def found(text: str) -> dict[str, str]:
        if at == "top":
            return small(tmp_path, body, f"return {name}", a=text)
        return small(tmp_path, "", f"{body}\n    return {name}", a=text)

    assert found("f = 1") != found("f = 2")


def test_a_module_that_the_stage_does_not_import_does_not_count(tmp_path):
    body = "from kincal.urdf.a import f\n    return f"
    assert small(tmp_path, body=body, a="f = 1", z="g = 1") == small(tmp_path, body=body, a="f = 1", z="g = 2")


def test_circular_imports_end(tmp_path):
    found = small(tmp_path, body="import kincal.urdf.a", a="import kincal.urdf.b", b="import kincal.urdf.a")
    assert {"kincal.urdf.a", "kincal.urdf.b"} <= set(found)


def test_a_package_counts_as_soon_as_it_has_code(tmp_path):
    """Importing a module runs its packages."""
    before = small(tmp_path, body="import kincal.urdf.a", a="f = 1")
    assert "kincal.urdf" not in before
    (tmp_path / "kincal" / "urdf" / "__init__.py").write_text('"""A docstring."""\n')
    assert Code(tmp_path).fingerprint("kincal.pipeline.stages", "stage") == before
    (tmp_path / "kincal" / "urdf" / "__init__.py").write_text("import os\n")
    after = Code(tmp_path).fingerprint("kincal.pipeline.stages", "stage")
    assert set(after) - set(before) == {"kincal.urdf"}


# How many modules a stage may depend on: before kincal was one package they were 26, 42 and 45. More is no error, but a
# reason to look: a module that a stage needs not makes it run for nothing. Since then each kind of measurement became
# a file of its own, each mistake and each correction unit, too: identify and evaluate depend on all of them.
@pytest.mark.parametrize("stage, most", [("model", 26), ("identify", 66), ("evaluate", 78)])
def test_a_stage_depends_on_few_modules(stage, most):
    units = [name for name in Code().fingerprint(*PLACES[stage]) if ":" not in name]
    assert 15 < len(units) <= most
    assert not [name for name in units if name.startswith(("kincal.pipeline.interface", "kincal.pipeline.commands"))]
