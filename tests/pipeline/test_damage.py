"""The rules of the store that no other test would miss, and a short run of `benchmarks.damage`."""

import os
import time
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest

from benchmarks import damage_cases
from benchmarks.damage import tallied
from benchmarks.damage_store import Clean, content
from benchmarks.small import QUICK
from kincal.pipeline.results import Fit
from kincal.pipeline.run import runner
from kincal.pipeline.store import garbage
from kincal.pipeline.store import store as artifacts
from kincal.pipeline.store.codec import encode
from kincal.pipeline.store.store import Store
from kincal.urdf.description import load_robot


@pytest.fixture(scope="module")
def clean(finished, start) -> Clean:
    """The finished run, as the benchmark has it."""
    assert set(finished.settings) == set(QUICK)
    run, _ = start(finished.store, *finished.settings)
    stages = list(runner.all_stages())
    values = dict(zip(stages, run.until(*stages), strict=True))
    return Clean(finished.store, {name: content(encode(value)) for name, value in values.items()}, values)


SHORT = {
    "kill -9 before a write": damage_cases.killed(after=False, step=37),
    "kill -9 after a write": damage_cases.killed(after=True, step=37),
    "kill -9 while all is made anew": damage_cases.killed(after=True, begun=True, step=61),
    "eight at once": damage_cases.together(8, 1),
    "eight at once, damaged": damage_cases.together(8, 1, damaged=True),
    "two while all is being freed": damage_cases.together(2, 1, freeing=True),
    "swapped": damage_cases.swapped,
    "clocks": damage_cases.clocks,
    "notes": damage_cases.notes,
}


@pytest.mark.parametrize("kind", SHORT)
def test_nothing_wrong_is_served_and_nothing_lost(clean, tmp_path, kind):
    tally = tallied(kind, SHORT[kind], clean, tmp_path)
    assert tally.tried == tally.healed, tally.first
    assert tally.tried >= (1 if "at once" in kind or "freed" in kind else 4)


def fit(size: float) -> Fit:
    return Fit(np.arange(2), np.full(3, size), np.zeros(3))


def test_what_a_stage_hands_on_is_read_back_from_the_store(clean, tmp_path, monkeypatch):
    """Rule 3, also of the first run: every value that is used or handed out is one that `load` has made."""
    read: list[object] = []
    load = Store.load

    def loading(*arguments):
        read.append(load(*arguments))
        return read[-1]

    monkeypatch.setattr(Store, "load", loading)
    used: list[object] = []
    with clean.known():
        monkeypatch.setattr(artifacts, "decode", lambda files, kind: object())
        for name, stage in runner.all_stages().items():
            answer = stage.function

            def watching(answer=answer, **given):
                used.extend(given.values())
                return answer(**given)

            watching.__module__, watching.__name__ = answer.__module__, answer.__name__
            object.__setattr__(stage, "function", watching)
            assert runner.all_stages()[name].function is watching
        run = runner.Run(load_robot("ups3_s", QUICK), Store(tmp_path / "store"))
        handed = run.until("evaluate", "report")
    live = {id(value) for value in clean.values.values()}
    assert len(used) > 20
    assert not live & {id(value) for value in (*used, *handed)}
    assert {id(value) for value in handed} <= {id(value) for value in read}


def test_an_artifact_is_flushed_before_it_is_in_place(tmp_path, monkeypatch):
    """Rule 4: all its files and its folder, then the rename, then the folder that holds it."""
    done: list[tuple[str, object]] = []
    fsync, rename = os.fsync, os.rename
    monkeypatch.setattr(
        os,
        "fsync",
        lambda number: done.append(("flushed", os.path.realpath(f"/proc/self/fd/{number}"))) or fsync(number),
    )
    monkeypatch.setattr(os, "rename", lambda a, b: done.append(("renamed", str(a))) or rename(a, b))
    entry = Store(tmp_path / "store").save("plan", 64 * "a", fit(0.0), {})
    (at,) = (k for k, (what, _) in enumerate(done) if what == "renamed")
    aside = Path(done[at][1])
    assert {path for what, path in done[:at]} == {str(aside), *(str(aside / f.name) for f in entry.folder.iterdir())}
    assert done[at + 1 :] == [("flushed", str(entry.folder.parent))]


def test_correctness_does_not_depend_on_the_lock(clean, tmp_path, monkeypatch):
    """Rule 4: eight runs at once, and none waits for another."""
    monkeypatch.setattr(Store, "lock", lambda *_: nullcontext())
    tally = tallied("unlocked", damage_cases.together(8, 1), clean, tmp_path)
    assert tally.healed == 1, tally.first


def test_who_comes_second_takes_what_the_first_has_stored(tmp_path):
    """Though its bytes were others: what is handed on is what is stored."""
    store = Store(tmp_path / "store")
    first, second = (store.save("plan", 64 * "a", fit(size), {}) for size in (0.0, 1.0))
    assert second.manifest == first.manifest
    np.testing.assert_array_equal(store.load(second, Fit).registered, store.load(first, Fit).registered)
    assert not list((tmp_path / "store" / "tmp").iterdir())


def test_what_was_first_is_freed_before_it_counts(tmp_path, monkeypatch):
    """Between the rename that it refused and the look at what it stored."""
    store = Store(tmp_path / "store")
    first = store.save("plan", 64 * "a", fit(0.0), {})
    content = artifacts.file_content

    def freed_first(file):
        if file == first.folder / "manifest.json":
            store.discard(first.folder)
        return content(file)

    monkeypatch.setattr(artifacts, "file_content", freed_first)
    second = store.save("plan", 64 * "a", fit(1.0), {})
    np.testing.assert_array_equal(store.load(second, Fit).registered, fit(1.0).registered)


def test_a_result_that_is_freed_time_and_again_is_made_again(clean, tmp_path, monkeypatch):
    """More often than one that is damaged each time would be."""
    load, freed = Store.load, []

    def freed_first(store, entry, kind):
        if entry.folder.parent.name == "model" and len(freed) < 20:
            freed.append(store.discard(entry.folder))
        return load(store, entry, kind)

    monkeypatch.setattr(Store, "load", freed_first)
    with clean.known():
        runner.Run(load_robot("ups3_s", QUICK), Store(tmp_path / "store")).until("plan")
    assert freed == 20 * [True]


def test_nobody_begins_in_a_leftover_that_is_being_removed(tmp_path, monkeypatch):
    store = Store(tmp_path / "store")
    leftover = tmp_path / "store" / "tmp" / ("0" * 32)
    leftover.mkdir(parents=True)
    remove, tried = garbage.shutil.rmtree, []

    def begun_first(folder, **options):
        if folder == leftover:
            with pytest.raises(BlockingIOError):
                artifacts.lock_folder(folder, wait=False)
            tried.append(folder)
        remove(folder, **options)

    monkeypatch.setattr(garbage.shutil, "rmtree", begun_first)
    assert garbage.free(store, garbage.garbage(store).found)
    assert tried == [leftover]
    assert not leftover.exists()


def test_a_library_counts_by_its_major_and_minor_version(clean, start, store, monkeypatch):
    """Rule 1."""
    version = runner.version
    found = {}
    for change in ("2.999.1", "patch"):
        monkeypatch.setattr(
            runner,
            "version",
            lambda name, change=change: (
                version(name) if name != "numpy" else f"{version(name)}9" if change == "patch" else change
            ),
        )
        found[change] = {state for _, state, _ in start(store, *QUICK)[0].status()}
    assert found == {"2.999.1": {"stale"}, "patch": {"fresh"}}


def test_who_when_and_where_are_no_part_of_the_key(clean, tmp_path, monkeypatch):
    """Rule 7: other clock, command and store; the same keys and payload. The manifests tell the difference."""
    made = []
    for k in range(2):
        with monkeypatch.context() as patched, clean.known():
            patched.setattr(time, "gmtime", lambda *_, k=k: time.struct_time((2000 + k, 1, 1, 0, 0, 0, 0, 1, 0)))
            run = runner.Run(load_robot("ups3_s", QUICK), Store(tmp_path / str(k)), command=str(k))
            run.until("report")
        made.append(run.entries)
    for stage, entry in made[0].items():
        other = made[1][stage].manifest
        assert (entry.manifest["key"], entry.manifest["files"]) == (other["key"], other["files"])
        assert entry.manifest["provenance"]["command"] == "0"
        assert entry.manifest["provenance"]["made"].startswith("2000")
        assert other["provenance"]["made"].startswith("2001")
