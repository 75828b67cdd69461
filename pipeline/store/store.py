"""The store behind the stages: sealed folders, renamed into place, checked when they are read."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import shutil
import uuid
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from kincal.pipeline.store.codec import decode, encode
from kincal.pipeline.store.digests import digest
from kincal.pipeline.store.files import replace_file, write_flushed
from kincal.pipeline.store.manifest import Damaged, Entry, entry_of, file_content, memo_of, read_json, sealed_manifest
from kincal.urdf.errors import InputError

UNFINISHED = "unfinished"  # of robots/ROBOT: a file a thing that the jobs of a study have made
FREED = "freed.json"  # what the last `gc` freed
TABLES = "tables"  # measurements that came as values


class Store:
    """A folder of artifacts (`artifacts/stage/key`) and of what each robot used last (`robots/robot/stage.json`)."""

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()

    def find(self, stage: str, key: str) -> Entry | None:
        """The artifact of a key; None where there is none. Raises Damaged where its manifest is broken."""
        folder = self._folder(stage, key)
        text = file_content(folder / "manifest.json")
        entry = entry_of(folder, text)
        if entry is not None and entry.manifest.get("key") == key:
            return entry
        if folder.exists():
            raise Damaged(f"{folder / 'manifest.json'}: not what was stored", folder, text)
        return None

    def load(self, entry: Entry, kind: type) -> Any:
        """The value, its digests checked. Raises Damaged."""
        files = self.files(entry)
        try:
            return decode(files, kind)
        except MemoryError:  # the artifact is as it was
            raise
        except Exception as error:  # whole, but written by another version of the formats
            problem = f"not readable as {kind.__name__} ({type(error).__name__})"
            raise Damaged(f"{entry.folder}: {problem}", entry.folder, entry.text) from None

    def files(self, entry: Entry) -> dict[str, bytes]:
        """An artifact's payload, its digests checked. Raises Damaged."""
        files = {}
        for name, sealed in entry.manifest["files"].items():
            try:
                files[name] = (entry.folder / name).read_bytes()
            except OSError as error:
                raise Damaged(f"{entry.folder / name}: {error.strerror}", entry.folder, entry.text) from None
            if len(files[name]) != sealed["bytes"] or digest(files[name]) != sealed["sha256"]:
                problem = f"{entry.folder / name}: its content is not what was stored"
                raise Damaged(problem, entry.folder, entry.text)
        return files

    def save(self, stage: str, key: str, value: Any, manifest: Mapping[str, Any], replace: bool = False) -> Entry:
        """A value under its key. Raises InputError where the disk refuses.

        replace: an artifact of that key that is there already gives way once the new one is whole.
        """
        return self.put(stage, key, encode(value), manifest, replace)

    def put(
        self, stage: str, key: str, files: Mapping[str, bytes], manifest: Mapping[str, Any], replace: bool = False
    ) -> Entry:
        """`save` of a value that is encoded already: written aside, flushed, sealed, and renamed into place."""
        sealed = dict(manifest) | {
            "stage": stage,
            "key": key,
            "files": {name: {"bytes": len(c), "sha256": digest(c)} for name, c in sorted(files.items())},
        }
        text = json.dumps(sealed | {"seal": digest(sealed)}, indent=1, sort_keys=True).encode()
        folder = self._folder(stage, key)
        with self.writing(), self._aside() as aside:
            temporary = aside / folder.name
            temporary.mkdir()
            for name, content in files.items():
                write_flushed(temporary / name, content)
            write_flushed(temporary / "manifest.json", text)
            _sync(temporary)
            folder.parent.mkdir(parents=True, exist_ok=True)
            if replace:
                with contextlib.suppress(FileNotFoundError):
                    folder.rename(aside / "old")
            try:
                first = _in_place(temporary, folder, key)
            except OSError:
                if (aside / "old").exists():
                    (aside / "old").rename(folder)
                raise
            if first is not None:
                return first
            _sync(folder.parent)
        return Entry(folder, sealed, text)

    def set_aside(self, damage: Damaged) -> None:
        """Move a damaged artifact out of the way, for a look; not what another run has put in its place meanwhile."""
        folder = damage.folder
        aside = self.root / "damaged" / f"{folder.parent.name}-{folder.name[:12]}-{uuid.uuid4().hex[:8]}"
        if file_content(folder / "manifest.json") == damage.text:
            with self.writing(), contextlib.suppress(FileNotFoundError):  # freed, or set aside by another run
                aside.parent.mkdir(parents=True, exist_ok=True)
                folder.rename(aside)

    def discard(self, path: Path) -> bool:
        """Remove something at once, as others see it; whether it was there. Raises OSError."""
        with self._aside() as aside:
            try:
                path.rename(aside / path.name)
            except FileNotFoundError:
                return False
        return True

    def last(self, robot: str, stage: str) -> Mapping[str, Any] | None:
        """The manifest that a robot's stage used last; None where it never ran, empty where that is lost."""
        file = self.root / "robots" / robot / f"{stage}.json"
        reference = read_json(file)
        key = reference.get("key") if isinstance(reference, dict) else None
        if not isinstance(key, str):
            return {} if file.exists() else None
        return sealed_manifest(file_content(self._folder(stage, key) / "manifest.json")) or {}

    def remember(self, robot: str, stage: str, key: str) -> None:
        """Note down what a robot's stage used last: `gc` keeps it."""
        self.publish(robot, f"{stage}.json", json.dumps({"key": key}).encode())

    def publish(self, robot: str, name: str, content: bytes) -> Path:
        """A copy for people, or a note of what was used, under a name that does not change."""
        file = self.root / "robots" / robot / name
        self.note(file, content)
        return file

    def describe(self, robot: str, file: Path) -> None:
        """Note down which robot.toml a robot's folder is of."""
        self.publish(robot, "robot.json", json.dumps({"file": str(file)}).encode())

    def begin(self, robot: str, stage: str, key: str) -> None:
        """Note down what a job of a study makes: `gc` keeps it until the study is done, and `finish` says what of."""
        with self.writing():
            folder = self.root / "robots" / robot / UNFINISHED
            folder.mkdir(parents=True, exist_ok=True)
            (folder / f"{stage}-{key[:40]}").touch()

    def finish(self, robot: str, study: str, made: Path, used: Collection[tuple[str, str]], command: str) -> None:
        """Note down the artifacts (stage, key) of a study, for as long as the file that was made of them is there."""
        note = {"made": str(made.absolute()), "command": command, "references": sorted(used)}
        name = f"{study}-{digest(str(made.absolute()).encode())[:10]}.json"
        self.publish(robot, name, json.dumps(note | {"seal": digest(note)}, indent=1).encode())
        folder = self.root / "robots" / robot
        with contextlib.suppress(OSError):
            if (folder / name).exists():  # else the store takes no notes: those of the jobs stay
                for stage, key in used:
                    (folder / UNFINISHED / f"{stage}-{key[:40]}").unlink(missing_ok=True)
                (folder / UNFINISHED).rmdir()

    def add_table(self, content: bytes) -> tuple[Path, int]:
        """Keep a Parquet table that came as a value; its name is its content's. Raises InputError.

        Also an open descriptor: `gc` leaves the file alone until it is closed.
        """
        file = self.root / TABLES / f"dataframe-{digest(content)[:16]}.parquet"
        with self.writing():
            while True:
                if file_content(file) != content:
                    with self._aside() as aside:
                        file.parent.mkdir(parents=True, exist_ok=True)
                        replace_file(file, content, aside)
                with contextlib.suppress(FileNotFoundError):  # freed between these lines
                    return file, hold_file(file)

    def freed(self, stage: str, key: str) -> bool:
        """Whether the last `gc` freed the artifact of this key."""
        names = read_json(self.root / FREED)
        return isinstance(names, list) and f"{stage}/{key[:40]}" in names

    def read_memo(self) -> dict[str, Any]:
        """What was found out about source files, by their digests; empty where that file is damaged."""
        return dict(memo_of(file_content(self.root / "code.json")))

    def write_memo(self, memo: Mapping[str, Any]) -> None:
        """Keep what was found out, where it is new."""
        if not set(memo) <= set(self.read_memo()):
            self.note(self.root / "code.json", json.dumps({"memo": memo, "seal": digest(memo)}).encode())

    def note(self, file: Path, content: bytes) -> None:
        """Write what saves work or eases a look; a store that takes no more is no reason to withhold a result."""
        if file_content(file) != content:
            with contextlib.suppress(OSError), self._aside() as aside:
                file.parent.mkdir(parents=True, exist_ok=True)
                replace_file(file, content, aside)

    @contextmanager
    def lock(self, stage: str, key: str) -> Iterator[None]:
        """Saves work where two runs want the same artifact; correctness does not depend on it."""
        from filelock import FileLock

        folder = self.root / "locks"
        with self.writing():
            folder.mkdir(parents=True, exist_ok=True)
            lock = FileLock(folder / f"{stage}-{key[:32]}.lock")
            lock.acquire()
        try:
            yield
        finally:
            lock.release()

    @contextmanager
    def _aside(self) -> Iterator[Path]:
        """A folder of its own in tmp/ to write in. While this process lives it is locked: no leftover for `gc`."""
        while True:
            folder = self.root / "tmp" / uuid.uuid4().hex
            folder.mkdir(parents=True)
            try:
                locked = lock_folder(folder)
            except FileNotFoundError:  # freed between these lines
                continue
            break
        try:
            yield folder
        finally:
            shutil.rmtree(folder, ignore_errors=True)
            os.close(locked)

    @contextmanager
    def writing(self) -> Iterator[None]:
        """An OSError becomes the InputError that the store can't be written."""
        try:
            yield
        except OSError as error:
            raise InputError(
                f"store {self.root}: can't be written: {error.strerror or error}; earlier results are untouched "
                "(--store names another folder)"
            ) from None

    def _folder(self, stage: str, key: str) -> Path:
        return self.root / "artifacts" / stage / key[:40]


def _in_place(temporary: Path, folder: Path, key: str) -> Entry | None:
    """Rename a finished artifact into place; or, where another run was first, what that has stored.

    That counts: its bytes are the same, but for the order of sums. Raises OSError where neither is possible.
    """
    while True:
        try:
            temporary.rename(folder)
        except OSError as error:
            first = entry_of(folder, file_content(folder / "manifest.json"))
            if first is not None and first.manifest.get("key") == key:
                return first
            if error.errno not in (errno.ENOTEMPTY, errno.EEXIST) or folder.exists():
                raise
            continue  # freed, or set aside, in between
        return None


def hold_file(file: Path) -> int:
    """An open descriptor that shares the file's lock with others who hold it. Raises FileNotFoundError."""
    descriptor = os.open(file, os.O_RDONLY)
    with contextlib.suppress(OSError):  # a file system without locks
        fcntl.flock(descriptor, fcntl.LOCK_SH)
    try:
        if not os.path.samestat(os.fstat(descriptor), file.stat()):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(file))
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def lock_folder(folder: Path, wait: bool = True) -> int:
    """An open descriptor that holds the folder's lock. Raises FileNotFoundError; without waiting, any OSError.

    A process that ends, however, gives it back. Where a file system has no locks a writer goes on without one.
    """
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        if not os.path.samestat(os.fstat(descriptor), folder.stat()):
            raise FileNotFoundError(errno.ENOENT, os.strerror(errno.ENOENT), str(folder))
    except OSError as error:
        if wait and not isinstance(error, FileNotFoundError):
            return descriptor
        os.close(descriptor)
        raise
    return descriptor


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
