"""A short run of the fuzz suite, and whether it would notice: `make fuzz` is the long one."""

from pathlib import Path

import pytest

from kincal.urdf.errors import InputError
from tests.fuzz.campaign import campaign
from tests.fuzz.case import MEGABYTES, run
from tests.fuzz.targets import TARGETS, Target

CASES = 600


def test_spoiled_files_are_taken_or_refused():
    """Each target's first case is a valid file, which must be taken."""
    results = campaign(CASES, workers=1)
    assert [r for r in results if r.outcome == "defect"] == []
    assert {r.target for r in results} == {t.name for t in TARGETS}
    assert len(results) > CASES - len(TARGETS)
    assert sum(r.outcome == "refused" for r in results) > CASES / 3


def _hold(folder: Path) -> None:
    bytearray(int(1.2 * MEGABYTES * 2**20))


def _loop(folder: Path) -> None:
    while True:
        pass


def _stray(folder: Path) -> None:
    Path("stray").touch()


def _change(folder: Path) -> None:
    (folder / "file").write_text("other")


def _long(folder: Path) -> None:
    raise InputError("no such thing")


@pytest.mark.parametrize(
    "read, said",
    [
        (lambda folder: int("nonsense"), "ValueError"),
        (_loop, "longer than"),
        (_hold, "MB"),
        (_stray, "written"),
        (_change, "written"),
        (_long, "names no file"),
    ],
    ids=["exception", "hang", "memory", "stray file", "changed file", "no file named"],
)
def test_defects_are_noticed(read, said, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    seconds = 0.5 if read is _loop else 30.0
    result = run(Target("t", lambda: [{"file": b"content"}], read, seconds=seconds), 1, tmp_path)
    assert result.outcome == "defect"
    assert said in result.said
