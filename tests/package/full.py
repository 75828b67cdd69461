"""`make package`: install wheel and sdist with their dependencies in fresh environments, and run a robot there.

This Python runs the whole pipeline. Python 3.12 and 3.13, where pyenv has them, do so too if a torch wheel is at hand
without an index (pip's `find-links`). Else torch would bring gigabytes of CUDA: they install all other dependencies
and run the stages that need no torch.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
import time
import tomllib
from pathlib import Path

from kincal.version import __version__
from tests.package.distributions import build, command, copy_of_checkout, hostile_folder, output
from tests.sources import ROOT

OTHER = ("3.12", "3.13")
ROBOT = "ups3_s"
WITHOUT_TORCH = "identify"  # the last stage that needs no torch


def say(text: str) -> None:
    print(text, flush=True)


def interpreters() -> dict[str, Path]:
    """{version: interpreter} of the other Pythons that pyenv has."""
    versions = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    this = f"{sys.version_info.major}.{sys.version_info.minor}"
    found = {}
    for version in OTHER:
        installed = sorted(versions.glob(f"{version}.*/bin/python"))
        if version != this and installed:
            found[version] = installed[-1]
        elif version != this:
            say(f"Python {version}: not tested, pyenv has no such interpreter")
    return found


def environment(interpreter: Path | str, folder: Path) -> Path:
    """A fresh virtual environment; return its Python."""
    output(interpreter, "-m", "venv", folder, cwd=folder.parent)
    return folder / "bin" / "python"


def install(python: Path, *what: str | Path) -> None:
    output(python, "-m", "pip", "install", "--quiet", *what, cwd=python.parent)


def requirements() -> tuple[str, list[str]]:
    """The requirement of torch, and the other dependencies."""
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    torch = [requirement for requirement in listed if re.match(r"torch\b", requirement)]
    return torch[0], [requirement for requirement in listed if requirement not in torch]


def torch_at_hand(python: Path, requirement: str) -> bool:
    """Whether pip finds a torch wheel for this Python without an index."""
    search = (python, "-m", "pip", "install", "--dry-run", "--no-deps", "--no-index", requirement)
    return command(*search, cwd=python.parent).returncode == 0


def check(python: Path, user: Path, *, until: str | None = None) -> None:
    """Run the installed command in a user's folder that shadows the old module names."""
    kincal = python.parent / "kincal"
    hostile_folder(user)
    for variables in ({}, {"PYTHONPATH": "."}):
        printed = output(kincal, "--version", cwd=user, **variables).strip()
        assert printed == __version__, f"kincal --version prints {printed}, not {__version__}"
        file = Path(output(python, "-c", "import kincal; print(kincal.__file__)", cwd=user, **variables).strip())
        assert python.parents[1] in file.parents, f"kincal is imported from {file}"
        last = ("--until", until) if until else ()
        printed = output(kincal, "run", ROBOT, *last, cwd=user, **variables)
    if not until:
        assert "hybrid" in printed, f"kincal run does not print the comparison:\n{printed}"
        pages = [file for file in (user / ".kincal").rglob("*.html") if __version__ in file.read_text()]
        assert pages, f"kincal run wrote no report with the version {__version__} below {user / '.kincal'}"


def main() -> int:
    torch, others = requirements()
    start, n = time.perf_counter(), 0

    def passed(text: str) -> None:
        nonlocal n
        n += 1
        say(f"{text}: passed after {time.perf_counter() - start:.0f} s")

    with tempfile.TemporaryDirectory(prefix="kincal-package-") as name:
        folder = Path(name)
        source = copy_of_checkout(folder / "checkout")
        files = {kind: build(kind, source, folder / kind) for kind in ("wheel", "sdist")}
        here = f"Python {sys.version_info.major}.{sys.version_info.minor}"
        for kind, file in files.items():
            python = environment(sys.executable, folder / f"environment-{kind}")
            install(python, file)
            check(python, folder / f"user-{kind}")
            passed(f"{here}, {kind} with all dependencies, kincal run {ROBOT}")
        for version, interpreter in interpreters().items():
            python = environment(interpreter, folder / f"environment-{version}")
            until = None if torch_at_hand(python, torch) else WITHOUT_TORCH
            install(python, *others, *([] if until else [torch]))
            for kind, file in files.items():
                install(python, "--no-deps", "--force-reinstall", file)
                check(python, folder / f"user-{version}-{kind}", until=until)
                scope = f"WITHOUT torch (no wheel at hand), kincal run {ROBOT} --until {until}" if until else ""
                passed(f"Python {version}, {kind}, {scope or f'all dependencies, kincal run {ROBOT}'}")
    say(f"package: {n} passed, 0 failed")
    return 0


if __name__ == "__main__":
    sys.exit(main())
