"""The commands of the documentation: each one's arguments are checked, and those of the first pages run."""

import difflib
import os
import re
import shlex
from pathlib import Path

import pytest

from benchmarks.small import QUICK
from kincal.pipeline.commands.app import app
from tests.sources import ROOT

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
NAMES = [name for name in app if not name.startswith("-")]
_PLACEHOLDERS = {"[", "|", "..", "..."}


def blocks(page: Path, language: str = "") -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), flags=re.M | re.S)


def commands(page: Path) -> list[list[str]]:
    """Arguments of every `kincal ..` line, without comments and without synopses."""
    found = []
    for line in "\n".join(blocks(page)).replace("\\\n", " ").splitlines():
        match = re.match(r"(?:\$ )?(?:\.venv/bin/)?kincal (.*)", line)
        if match:
            words = shlex.split(match[1], comments=True)
            printed = not difflib.get_close_matches(words[0], NAMES, cutoff=0.6)  # a sentence that kincal prints
            if not printed and not any(word.startswith("[") or word in _PLACEHOLDERS for word in words):
                found.append(list(words[: words.index(">")] if ">" in words else words))
    return found


@pytest.mark.parametrize("page", [p for p in PAGES if commands(p)], ids=lambda p: p.stem)
def test_every_command_has_arguments_that_there_are(page):
    for words in commands(page):
        app.parse_args(words, exit_on_error=False, print_error=False)


def test_there_are_many():
    assert sum(len(commands(page)) for page in PAGES) > 40


def test_the_first_page_can_be_followed(cli, tmp_path):
    """docs/start_here.md from top to bottom, on small settings: its shell, its Python and its commands."""
    (tmp_path / "urdf").symlink_to(ROOT / "urdf")
    text = (ROOT / "docs" / "start_here.md").read_text(encoding="utf-8")
    steps = 0
    for language, block in re.findall(r"^```(\w*)\n(.*?)^```", text, flags=re.M | re.S):
        if language == "python":
            exec(compile(block, "start_here.md", "exec"), {})
            continue
        for line in block.splitlines():
            if line.startswith("kincal "):
                (tmp_path / "poses.csv").unlink(missing_ok=True) if "plan" in line else None
                answer = cli(*shlex.split(line)[1:])
                assert answer.status == 0, (line, answer.err)
                steps += 1
            elif not line.startswith("source "):
                assert os.system(line) == 0, line
    assert steps >= 6


def test_the_python_of_the_readme_runs(capsys):
    """On small settings."""
    (text,) = blocks(ROOT / "README.md", "python")
    small = text.replace('{"plan.poses": 40}', repr(list(QUICK)))
    assert small != text
    exec(compile(small, "README.md", "exec"), {})
    out = capsys.readouterr().out
    assert "identified" in out
    assert "hybrid" in out
