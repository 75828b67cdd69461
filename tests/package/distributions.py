"""Builds kincal's wheel and sdist from a copy of the working tree, and makes a folder that shadows old module names."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tarfile
from pathlib import Path

from tests.sources import ROOT

HOSTILE = ("pipeline.py", "urdf.py", "learning/__init__.py", "identification.py")


def command(*words: str | Path, cwd: Path, **variables: str) -> subprocess.CompletedProcess[str]:
    """Run a command in `cwd` without PYTHONPATH; the variables are added to the environment."""
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"} | variables
    return subprocess.run([str(word) for word in words], cwd=cwd, env=environment, capture_output=True, text=True)


def output(*words: str | Path, cwd: Path, **variables: str) -> str:
    """The standard output of a command that must succeed. Raises AssertionError with all that it printed."""
    done = command(*words, cwd=cwd, **variables)
    line = " ".join(str(word) for word in words)
    assert done.returncode == 0, f"{line}\nexit status {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def copy_of_checkout(folder: Path) -> Path:
    """Copy the files that git knows or would add, links as links: nothing that an earlier build left behind."""
    for name in _listed():
        source, target = ROOT / name, folder / name
        if source.is_symlink() or source.exists():
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(source, target, follow_symlinks=False)
    return folder


def _listed() -> list[str]:
    if (ROOT / ".git").exists():
        listed = output("git", "ls-files", "-z", "--cached", "--others", "--exclude-standard", cwd=ROOT)
        return [name for name in listed.split("\0") if name]
    # the sources as an archive has them
    parts = ("pyproject.toml", "README.md", "LICENSE", "src", "urdf", "identification", "learning", "pipeline")
    found = [path for part in parts for path in (ROOT / part, *(ROOT / part).rglob("*"))]
    kept = [path for path in found if path.is_symlink() or path.is_file()]
    return [str(path.relative_to(ROOT)) for path in kept if not {"__pycache__", "kincal.egg-info"} & set(path.parts)]


def build(kind: str, source: Path, folder: Path) -> Path:
    """Build the `wheel` or the `sdist` of a source folder, without isolation: this needs no network."""
    options = [f"--{kind}", "--outdir", folder, "--no-isolation"]
    output(sys.executable, "-m", "build", *options, source, cwd=source)
    (file,) = folder.glob("*.whl" if kind == "wheel" else "*.tar.gz")
    return file


def unpacked(sdist: Path, folder: Path) -> Path:
    """Unpack an sdist; return its one folder."""
    with tarfile.open(sdist) as archive:
        archive.extractall(folder, filter="data")
    (source,) = folder.iterdir()
    return source


def hostile_folder(folder: Path) -> Path:
    """Make a user's folder whose modules have the names that kincal once installed. Importing one ends the program."""
    for name in HOSTILE:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text('raise SystemExit("imported")\n')
    return folder
