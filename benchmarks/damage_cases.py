"""The accidents of `benchmarks.damage`: generators of (case, what came of it)."""

from __future__ import annotations

import builtins
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from itertools import count
from pathlib import Path
from typing import Any

from benchmarks.damage_store import Clean, Found, finish, whole
from benchmarks.small import QUICK
from kincal.pipeline.run.fingerprint import PACKAGES, ROOT, Code
from kincal.pipeline.store.garbage import free, garbage
from kincal.pipeline.store.store import Store
from kincal.urdf.errors import InputError

Cases = Iterator[tuple[str, Found]]


def _files(store: Path) -> list[Path]:
    return sorted(f for f in (store / "artifacts").rglob("*") if f.is_file())


Damage = Callable[[Path, bytes], Iterator[str]]


def _damaged(clean: Clean, folder: Path, damage: Damage, real: bool = False) -> Cases:
    """Each file of each artifact in turn, as often as `damage` damages it. real: the stages compute."""
    store = Path(shutil.copytree(clean.store, folder / "store"))
    for file in _files(store):
        stage, sound = file.parent.parent.name, file.read_bytes()
        for what in damage(file, sound):
            with nullcontext() if real else clean.known():
                found = clean.after(store, {stage})
            yield f"{stage}/{file.name} {what}", found
            shutil.rmtree(store)
            shutil.copytree(clean.store, store)


def flipped(clean: Clean, folder: Path) -> Cases:
    def damage(file: Path, sound: bytes) -> Iterator[str]:
        for at in sorted({k * (len(sound) - 1) // 15 for k in range(16)}):
            content = bytearray(sound)
            content[at] ^= 0x04
            file.write_bytes(content)
            yield f"byte {at}"

    return _damaged(clean, folder, damage)


def cut(clean: Clean, folder: Path) -> Cases:
    def damage(file: Path, sound: bytes) -> Iterator[str]:
        for length in sorted({0, len(sound) // 2, len(sound) - 1}):
            file.write_bytes(sound[:length])
            yield f"cut to {length}"

    return _damaged(clean, folder, damage)


def missing(clean: Clean, folder: Path) -> Cases:
    def damage(file: Path, sound: bytes) -> Iterator[str]:
        file.unlink()
        yield "missing"

    return _damaged(clean, folder, damage, real=True)


def exchanged(clean: Clean, folder: Path) -> Cases:
    """A file of another artifact in its place."""

    def damage(file: Path, sound: bytes) -> Iterator[str]:
        others = [f for f in _files(file.parents[3]) if f.name == file.name and f != file]
        if others:
            file.write_bytes(others[0].read_bytes())
            yield f"that of {others[0].parent.parent.name}"

    return _damaged(clean, folder, damage)


def swapped(clean: Clean, folder: Path) -> Cases:
    """Two whole artifacts, each in the other's place."""
    folders = sorted({f.parent for f in _files(clean.store)})
    for one, other in zip(folders, folders[1:] + folders[:1], strict=True):
        store = Path(shutil.copytree(clean.store, folder / "store"))
        a, b = (store / f.relative_to(clean.store) for f in (one, other))
        a.rename(folder / "aside")
        b.rename(a)
        (folder / "aside").rename(b)
        with clean.known():
            yield f"{one.parent.name} and {other.parent.name}", clean.after(store, {one.parent.name, other.parent.name})
        shutil.rmtree(store)


# Killed

_HOOKED = ("mkdir", "rename", "replace", "unlink", "rmdir", "fsync", "open")


def _die_at(k: int, after: bool) -> None:
    """Hook what changes files: this process kills itself at the k-th such call, before or after it."""
    calls = count(1)

    def hooked(call: Callable[..., Any], counts: Callable[..., bool]) -> Callable[..., Any]:
        def hook(*args: Any, **options: Any) -> Any:
            now = counts(*args, **options) and next(calls) == k
            if now and not after:
                os.kill(os.getpid(), signal.SIGKILL)
            try:
                return call(*args, **options)
            finally:  # a call that fails has been made, too
                if now:
                    os.kill(os.getpid(), signal.SIGKILL)

        return hook

    def creates(file: Any, flags: int, *args: Any, **options: Any) -> bool:
        return bool(flags & os.O_CREAT)

    def writes(file: Any, mode: str = "r", *args: Any, **options: Any) -> bool:
        return not set(mode).isdisjoint("wax+")

    for name in _HOOKED:
        setattr(os, name, hooked(getattr(os, name), creates if name == "open" else lambda *a, **o: True))
    builtins.open = hooked(open, writes)


def _forked(work: Callable[[], Any]) -> int:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of threads; the child has none to wait for
        child = os.fork()
    if child == 0:
        status = 1
        try:
            work()
            status = 0
        except InputError:
            status = 2
        finally:
            os._exit(status)
    return child


def _status(child: int) -> int:
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def killed(after: bool, begun: bool = False, step: int = 1) -> Callable[[Clean, Path], Cases]:
    """At every call that changes files, of a run from an empty store; begun: of one that forces all stages anew.

    step: at each `step`-th call.
    """

    def cases(clean: Clean, folder: Path) -> Cases:
        options = {"force_from": "model"} if begun else {}
        for k in count(step, step):
            store = folder / "store"
            if begun:
                shutil.copytree(clean.store, store)

            def work(k: int = k, store: Path = store) -> None:
                _die_at(k, after)
                finish(store, **options)

            with clean.known():
                status = _status(_forked(work))
                if status == 0:
                    return
                survived = whole(store)
                found = clean.after(store, set(clean.digests) - survived)
            said = found.said if status == -signal.SIGKILL else f"{found.said}; the child ended by {status}"
            free(Store(store), garbage(Store(store)).found)
            left = [*(store / "tmp").iterdir()]
            kept = whole(store) == set(clean.digests)
            yield (
                f"call {k}",
                Found(found.wrong, found.lost or status != -signal.SIGKILL or bool(left) or not kept, said),
            )
            shutil.rmtree(store)

    return cases


# Several at once


def together(n: int, times: int, damaged: bool = False, freeing: bool = False) -> Callable[[Clean, Path], Cases]:
    """n processes on one store; damaged: that has a damaged file in each second artifact; freeing: while gc runs."""

    def cases(clean: Clean, folder: Path) -> Cases:
        for again in range(times):
            store = folder / "store"
            if damaged:
                shutil.copytree(clean.store, store)
                for manifest in sorted((store / "artifacts").glob("*/*/manifest.json"))[again % 2 :: 2]:
                    manifest.with_name("value.json").write_bytes(b"{")

            def work(store: Path = store) -> None:
                found, _ = finish(store)
                if found != clean.digests:
                    os._exit(3)

            def sweep(store: Path = store) -> None:
                while not (folder / "stop").exists():
                    # as if no robot had noted anything down: all may go at any moment
                    kept = Store(store)
                    free(kept, garbage(kept, unfinished=True).found)
                    for entry in sorted((store / "artifacts").glob("*/*")):
                        kept.discard(entry)
                        time.sleep(0.005)

            with clean.known():
                children = [_forked(work) for _ in range(n)]
                sweeper = _forked(sweep) if freeing else 0
                statuses = [_status(child) for child in children]
                if freeing:
                    (folder / "stop").touch()
                    _status(sweeper)
                    (folder / "stop").unlink()
                found = clean.after(store, None if freeing else set())
            wrong, lost = 3 in statuses or found.wrong, any(s not in (0, 3) for s in statuses) or found.lost
            yield f"time {again}", Found(wrong, lost, f"{statuses} {found.said}")
            shutil.rmtree(store)

    return cases


# The disk


def limited(clean: Clean, folder: Path) -> Cases:
    """Files may not grow beyond a limit: as a disk that is full at every file of a run in turn."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    for limit in sorted({max(f.stat().st_size - 1, 0) for f in _files(clean.store)}):
        store = folder / "store"

        def work(limit: int = limit, store: Path = store) -> None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
            finish(store)

        with clean.known():
            status = _status(_forked(work))
            survived = whole(store)
            found = clean.after(store, set(clean.digests) - survived)
        yield f"{limit} bytes", Found(found.wrong, found.lost or status != 2, f"ended by {status}; {found.said}")
        shutil.rmtree(store)


def _mounted(folder: Path, options: str) -> bool:
    folder.mkdir(exist_ok=True)
    done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder], capture_output=True, check=False)
    return done.returncode == 0


def full(clean: Clean, folder: Path) -> Cases:
    """A file system that fills up, at 24 sizes. Nothing is tried where none can be mounted."""
    size = sum(f.stat().st_size for f in _files(clean.store))
    for part in range(1, 25):
        disk = folder / "disk"
        if shutil.which("mount") is None or not _mounted(disk, f"size={part * size // 16}"):
            return
        store = disk / "store"
        try:
            with clean.known():
                status = _status(_forked(lambda store=store: finish(store)))
                survived = whole(store)
                subprocess.run(["mount", "-o", "remount,size=64m", disk], check=True)
                found = clean.after(store, set(clean.digests) - survived)
        finally:
            subprocess.run(["umount", disk], check=True)
        yield f"{part}/16", Found(found.wrong, found.lost or status not in (0, 2), f"ended by {status}; {found.said}")


def read_only(clean: Clean, folder: Path) -> Cases:
    """What is there is served, what is not is refused. Nothing is tried where no file system can be mounted."""
    disk = folder / "disk"
    if shutil.which("mount") is None or not _mounted(disk, "size=64m"):
        return
    try:
        stages = list(clean.digests)
        for k in range(len(stages) + 1):
            store = Path(shutil.copytree(clean.store, disk / str(k)))
            for stage in stages[k:]:
                shutil.rmtree(store / "artifacts" / stage)
        subprocess.run(["mount", "-o", "remount,ro", disk], check=True)
        for k in range(len(stages) + 1):
            with clean.known():
                status = _status(_forked(lambda k=k: finish(disk / str(k))))
            served = whole(disk / str(k)) == set(stages[:k])
            expected = 0 if k == len(stages) else 2
            yield f"{k} stages there", Found(False, status != expected or not served, f"ended by {status}")
    finally:
        subprocess.run(["umount", disk], check=True)


# Clocks


def clocks(clean: Clean, folder: Path) -> Cases:
    """Files from the past and the future; and a clock that jumps at each look."""
    usual = {name: getattr(time, name) for name in ("time", "time_ns", "gmtime", "perf_counter")}
    for year in (1971, 2007, 2055, 2399):
        at = (year - 1970) * 31556952
        store = Path(shutil.copytree(clean.store, folder / "store"))
        for k, file in enumerate(sorted(store.rglob("*"))):
            os.utime(file, (at - 86400 * k,) * 2)
        with clean.known():
            yield f"files of {year}", clean.after(store, set())
        shutil.rmtree(store)
        back = count()
        time.time = lambda at=at, back=back: at - 3600.0 * next(back)
        time.time_ns = lambda: int(1e9 * time.time())
        time.perf_counter = time.time
        time.gmtime = lambda seconds=None: usual["gmtime"](time.time() if seconds is None else seconds)
        try:
            with clean.known():
                found = clean.after(store)
                again = clean.after(store, set())
        finally:
            for name, call in usual.items():
                setattr(time, name, call)
        yield f"clock of {year}", Found(found.wrong or again.wrong, found.lost or again.lost, again.said)
        shutil.rmtree(store)


# Code, settings, notes


def comments(clean: Clean, folder: Path) -> Cases:
    """A comment in each module in turn: nothing runs."""
    store, root = Path(shutil.copytree(clean.store, folder / "store")), folder / "project"
    for package in PACKAGES:
        shutil.copytree(ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__"))
    memo = Store(clean.store).read_memo()
    for file in sorted(root.rglob("*.py")):
        text = file.read_text()
        file.write_text(f"{text}\n# changed\n")
        with clean.known():
            yield str(file.relative_to(root)), clean.after(store, set(), Code(root, memo=dict(memo)))
        file.write_text(text)


_CHANGES = (("kincal/identification/channels/orientation.py", "orientation_error"),)
_DOUBLED = """

_plain_{name} = {name}


def {name}(*args, **options):
    return 2 * _plain_{name}(*args, **options)
"""


def helpers(clean: Clean, folder: Path) -> Cases:
    """A helper changed, calls away from the stages: what a process that runs the new code on the old store says is
    what it says on an empty one, and is not what was stored."""
    for file, name in _CHANGES:
        root = folder / "project"
        for package in PACKAGES:
            shutil.copytree(ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__"))
        with open(root / file, "a") as stream:
            stream.write(_DOUBLED.format(name=name))
        said = []
        for store in (shutil.copytree(clean.store, folder / "old"), folder / "new"):
            sets = [part for setting in QUICK for part in ("--set", setting)]
            command = [sys.executable, "-m", "kincal", "run", str(root / "kincal/urdf/robots/ups3_s"), *sets]
            environment = os.environ | {"PYTHONPATH": str(root), "PYTHONDONTWRITEBYTECODE": "1"}
            subprocess.run([*command, "--store", store], env=environment, cwd=folder, capture_output=True, check=False)
            manifests = (folder / store).glob("artifacts/evaluate/*/value.json")
            said.append({m.read_bytes() for m in manifests})
        before = {m.read_bytes() for m in clean.store.glob("artifacts/evaluate/*/value.json")}
        fresh = said[0] - before
        same = len(fresh) == 1 and fresh == said[1] - before
        yield file, Found(not same, False, f"{len(fresh)} new comparisons, {len(said[1] - before)} from an empty store")
        for name in ("project", "old", "new"):
            shutil.rmtree(folder / name, ignore_errors=True)


def settings(clean: Clean, folder: Path) -> Cases:
    """Settings spelled out as they are by default, or that give the same bytes: nothing below runs."""
    same = {
        'plan.layout="grid"': {"plan"},
        "seed=0": set(),
        "split.test=0.2": set(),
        "measure.errors.elastic=true": set(),
        "evaluate.fresh_poses=500": set(),
        "workspace.max_condition=100.0": set(),
    }
    for setting, runs in same.items():
        store = Path(shutil.copytree(clean.store, folder / "store"))
        yield setting, clean.after(store, runs, settings=(*QUICK, setting))
        shutil.rmtree(store)


def notes(clean: Clean, folder: Path) -> Cases:
    """Everything beside the artifacts gone or spoiled: nothing runs."""
    for name in ("robots", "code.json", "locks", "tmp"):
        for what in ("gone", "spoiled"):
            store = Path(shutil.copytree(clean.store, folder / "store"))
            place = store / name
            files = [place] if place.is_file() else [f for f in place.rglob("*") if f.is_file()]
            for file in files:
                file.unlink() if what == "gone" else file.write_bytes(b"\xff{")
            if what == "gone" and place.is_dir():
                shutil.rmtree(place)
            with clean.known():
                yield f"{name} {what}", clean.after(store, set())
            shutil.rmtree(store)


def forced(clean: Clean, folder: Path) -> Cases:
    """--force-from each stage: that one and all after it run, for real, and make the same."""
    stages = list(clean.digests)
    store = Path(shutil.copytree(clean.store, folder / "store"))
    for k, stage in enumerate(stages):
        yield stage, clean.after(store, set(stages[k:]), force_from=stage)


KINDS: dict[str, Callable[[Clean, Path], Cases]] = {
    "a byte flipped, at 16 places of every file": flipped,
    "every file emptied, cut in half, cut by a byte": cut,
    "every file missing; the stage computes": missing,
    "every file another artifact's": exchanged,
    "whole artifacts in each other's place": swapped,
    "kill -9 before each call that writes": killed(after=False),
    "kill -9 after each call that writes": killed(after=True),
    "kill -9 before each 3rd call, all stages forced": killed(after=False, begun=True, step=3),
    "kill -9 after each 3rd call, all stages forced": killed(after=True, begun=True, step=3),
    "2 processes on one empty store": together(2, 20),
    "8 processes on one empty store": together(8, 10),
    "8 processes on a damaged store": together(8, 20, damaged=True),
    "4 processes while everything is being freed": together(4, 10, freeing=True),
    "a read-only store": read_only,
    "files that may not grow": limited,
    "a disk that is full": full,
    "clocks that step, files of other times": clocks,
    "a comment, in every module": comments,
    "a helper changed, calls away": helpers,
    "settings that change nothing": settings,
    "notes, memo, locks gone or spoiled": notes,
    "--force-from each stage": forced,
}
