"""What nobody needs any more in a store: found, and freed, while others may be using it."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path

from kincal.pipeline.store.digests import digest
from kincal.pipeline.store.manifest import read_json
from kincal.pipeline.store.store import FREED, TABLES, UNFINISHED, Store, lock_folder
from kincal.urdf.input_files import is_missing

ROBOT = "robot.json"  # of robots/ID: which robot.toml it is
_KEY, _LOCK = re.compile(r"[0-9a-f]{40}"), re.compile(r".+-[0-9a-f]{32}\.lock")
_TEMPORARY, _DAMAGED = re.compile(r"(seen-)?[0-9a-f]{32}"), re.compile(r".+-[0-9a-f]{12}-[0-9a-f]{8}")
_TABLE = re.compile(r"dataframe-[0-9a-f]{16}\.parquet")


@dataclass(frozen=True)
class Removable:
    """Something in the store that may go."""

    kind: str  # artifact, unfinished, damaged, leftover, lock, robot, table
    path: Path
    bytes: int


@dataclass
class Roots:
    """What the notes of robots refer to, as (stage, the folder's name); and what they don't say."""

    named: set[tuple[str, str]] = field(default_factory=set)
    unfinished: set[tuple[str, str]] = field(default_factory=set)  # by jobs of studies, of which not all are done
    kept: set[str] = field(default_factory=set)  # stages whose artifacts all stay: a note of them can't be believed
    doubtful: list[Path] = field(default_factory=list)  # these notes
    gone: dict[Path, str] = field(default_factory=dict)  # {robots/ID: its robot.toml, which is not there any more}


@dataclass(frozen=True)
class Garbage:
    """What may go, and what the choice rests on."""

    found: tuple[Removable, ...]
    roots: Roots


def garbage(store: Store, *, unfinished: bool = False, gone: bool = False, keep_damaged: bool = False) -> Garbage:
    """All that no note refers to. unfinished: also what jobs made of studies that never came to their end; gone: also
    robots whose robot.toml is not there any more, with all that they alone used.

    Raises OSError where the store can't be looked into: what is not seen may be referred to.
    """
    # Before the notes: what is made and noted down from here on is not among them.
    artifacts = [folder for stage in _listed(store.root / "artifacts") for folder in _listed(stage, _KEY)]
    roots = _roots(store, without_gone=gone)
    named = roots.named | (set() if unfinished else roots.unfinished)
    removable = []
    for folder in artifacts:
        name = (folder.parent.name, folder.name)
        if name not in named and folder.parent.name not in roots.kept:
            removable.append(_removable("artifact", folder))
    if "measure" not in roots.kept:
        removable += [_removable("table", file) for file in _unused_tables(store, named)]
    for robot in _listed(store.root / "robots"):
        if robot in roots.gone and gone:
            removable.append(_removable("robot", robot))
        elif unfinished and (robot / UNFINISHED).is_dir():
            removable.append(_removable("unfinished", robot / UNFINISHED))
    if not keep_damaged:
        removable += [_removable("damaged", folder) for folder in _listed(store.root / "damaged", _DAMAGED)]
    leftovers = _listed(store.root / "tmp", _TEMPORARY)
    removable += [_removable("leftover", folder) for folder in leftovers if _abandoned(folder)]
    removable += [_removable("lock", file) for file in _listed(store.root / "locks", _LOCK)]
    return Garbage(tuple(removable), roots)


def free(store: Store, removable: Collection[Removable]) -> list[Removable]:
    """Free what `garbage` found; what was freed. Raises InputError where the store can't be written."""
    freed = []
    with store.writing():
        for one in removable:
            if one.kind == "lock":
                done = _unlocked(one.path)
            elif one.kind in ("leftover", "table"):
                done = _swept(one.path)
            else:
                done = store.discard(one.path)
            if done:
                freed.append(one)
        artifacts = sorted(f"{one.path.parent.name}/{one.path.name}" for one in freed if one.kind == "artifact")
        if artifacts:
            store.note(store.root / FREED, json.dumps(artifacts).encode())
    return freed


def _unused_tables(store: Store, named: Collection[tuple[str, str]]) -> Iterator[Path]:
    """Tables of measurements that came as values, and that no artifact in use was measured by."""
    used = set()
    for stage, key in named:
        if stage == "measure":
            manifest = read_json(store.root / "artifacts" / stage / key / "manifest.json")
            files = manifest.get("parts", {}).get("files", {}) if isinstance(manifest, dict) else {}
            used.add(str(files.get("measure.table"))[:16])
    for file in _listed(store.root / TABLES, _TABLE):
        if file.stem.rpartition("-")[2] not in used:
            yield file


def _roots(store: Store, without_gone: bool) -> Roots:
    roots = Roots()
    for robot in _listed(store.root / "robots"):
        described = read_json(robot / ROBOT)
        file = described.get("file") if isinstance(described, dict) else None
        if isinstance(file, str) and is_missing(file):
            roots.gone[robot] = file
            if without_gone:
                continue
        for name in _listed(robot / UNFINISHED):
            stage, _, key = name.name.partition("-")
            roots.unfinished.add((stage, key))
        for note in _listed(robot):
            if note.suffix == ".json" and note.name != ROBOT:
                _refer(store, note, roots)
    return roots


def _refer(store: Store, note: Path, roots: Roots) -> None:
    """Add what a note refers to. One that is damaged may have named anything: nothing that it could mean is freed."""
    content = read_json(note)
    if isinstance(content, dict) and "references" in content:
        if content.pop("seal", None) == digest(content):
            if not is_missing(content["made"]):  # else its table was thrown away
                roots.named.update((stage, key[:40]) for stage, key in content["references"])
            return
    elif isinstance(content, dict) and isinstance(content.get("key"), str):
        name = (note.stem, content["key"][:40])
        if (store.root / "artifacts" / note.stem / name[1] / "manifest.json").is_file():
            roots.named.add(name)
            return
    stages = {note.stem} if (store.root / "artifacts" / note.stem).is_dir() else _names(store.root / "artifacts")
    roots.kept |= stages
    roots.doubtful.append(note)


def _names(folder: Path) -> set[str]:
    return {part.name for part in _listed(folder)}


def _removable(kind: str, path: Path) -> Removable:
    return Removable(kind, path, sum(_size(file) for file in (path, *path.rglob("*"))))


def _size(file: Path) -> int:
    with suppress(OSError):  # gone meanwhile
        return 0 if file.is_dir() else file.lstat().st_size
    return 0


def _listed(folder: Path, name: re.Pattern[str] | None = None) -> list[Path]:
    """What is in a folder, if there is one; of these names alone: the rest is not kincal's. Raises OSError."""
    with suppress(FileNotFoundError, NotADirectoryError):
        return sorted(path for path in folder.iterdir() if name is None or name.fullmatch(path.name))
    return []


@contextmanager
def _held(path: Path) -> Iterator[bool]:
    """Whether no living process writes there; within, none can begin to."""
    try:
        locked = lock_folder(path, wait=False)
    except OSError:
        yield False
        return
    try:
        yield True
    finally:
        os.close(locked)


def _abandoned(path: Path) -> bool:
    with _held(path) as ours:
        return ours


def _swept(path: Path) -> bool:
    """Remove what no living process writes in. Held all the while: who has just made it must not begin there."""
    with _held(path) as ours:
        if ours and path.is_dir():
            shutil.rmtree(path)
        elif ours:
            path.unlink(missing_ok=True)
        return ours


def _unlocked(file: Path) -> bool:
    """Remove a lock file that nobody holds."""
    from filelock import FileLock, Timeout

    lock = FileLock(file)
    try:
        with lock.acquire(timeout=0):
            file.unlink(missing_ok=True)
    except Timeout:
        return False
    return True


def unreferenced(roots: Roots, *, gone: bool, unfinished: bool) -> Iterator[str]:
    """What was not freed, and why, a line each."""
    for note in roots.doubtful:
        kept = note.stem if note.stem in roots.kept else "anything"
        yield f"{note}: what it refers to is not there or can't be read; nothing of {kept} is freed"
    for robot, file in roots.gone.items() if not gone else ():
        yield f"{robot.name}: its {file} is not there any more; kept (--gone frees it)"
    only = roots.unfinished - roots.named
    if only and not unfinished:
        yield f"{len(only)} artifacts of unfinished sweeps or reproductions are kept (--unfinished frees them)"
