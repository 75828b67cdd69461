"""A store that others can change is a warning; `kincal cache verify` says what a seal is worth."""

import os
from pathlib import Path
from types import SimpleNamespace

import pytest

from kincal.pipeline.store import ownership

POSES = ("--set", "plan.poses=12")


@pytest.fixture(autouse=True)
def _first_time(monkeypatch):
    monkeypatch.setattr(ownership, "_warned", set())


def warnings(answer) -> list[str]:
    return [line for line in answer.err.splitlines() if line.startswith("warning: ")]


@pytest.mark.parametrize(
    "mode, warned", [(0o700, False), (0o755, False), (0o775, False), (0o777, True), (0o1777, True)]
)
def test_a_store_that_everybody_can_write(cli, tmp_path, mode, warned):
    folder = tmp_path / "my store"
    folder.mkdir()
    folder.chmod(mode)
    answer = cli("run", "ups3_s", "--until", "model", "--store", folder)
    assert answer.status == 0
    expected = f"warning: store {folder}: every user can change its results (mode {mode:o}). "
    assert warnings(answer) == ([expected + f"Run chmod -R o-w '{folder}'"] if warned else [])


def test_its_artifacts_alone_and_once_a_process(cli, tmp_path):
    folder = tmp_path / "store"
    assert not warnings(cli("run", "ups3_s", "--until", "model", "--store", folder))
    (folder / "artifacts").chmod(0o757)
    (line,) = warnings(cli("run", "ups3_s", "rps3", "--until", "model", "--store", folder))
    assert f"store {folder}/artifacts: every user" in line
    assert not warnings(cli("cache", "gc", "--store", folder))
    ownership._warned.clear()
    assert warnings(cli("cache", "gc", "--store", folder)) == [line]


@pytest.mark.parametrize("mode", [0o700, 0o777])
def test_a_store_of_another_user(cli, tmp_path, monkeypatch, mode):
    folder, stat = tmp_path / "store", Path.stat

    def of_another(self, **options):
        real = stat(self, **options)
        is_store = self == folder
        return SimpleNamespace(st_uid=4242, st_mode=mode) if is_store else real

    folder.mkdir()
    monkeypatch.setattr(ownership.Path, "stat", of_another)
    ownership.warn_of_others(folder)
    (text,) = ownership._warned
    assert text.startswith(f"store {folder}: it belongs to another user, number 4242, who can change its results. ")
    assert text.endswith(f"run chown -R {os.geteuid()} {folder} && chmod -R go-w {folder}")


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away")
def test_a_store_that_was_given_away(cli, tmp_path):
    folder = tmp_path / "store"
    folder.mkdir()
    os.chown(folder, 4242, -1)
    answer = cli("run", "ups3_s", "--until", "model", "--store", folder)
    assert answer.status == 0
    assert len(warnings(answer)) == 1
    assert "number 4242" in answer.err


def test_verify_says_what_a_seal_promises(cli, tmp_path):
    store = tmp_path / "store"
    cli("run", "ups3_s", "--until", "model", "--store", store)
    answer = cli("cache", "verify", "ups3_s", "--store", store)
    assert answer.status == 0
    promise, limit = answer.out.splitlines()[-1].split(". ")
    assert promise == "A seal promises that an artifact is unchanged since kincal wrote it"
    assert limit == "It is no signature: a user who can write the store can write results and seals."
