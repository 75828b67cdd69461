"""Artifact formats and the store behind the stages: sealed folders, renamed into place, checked when they are read.

Values are dataclasses. Tables in them go to Parquet, arrays to safetensors, long texts to files of their own and all
else to one JSON document. Nothing is ever pickled.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import json
import math
import os
import shutil
import uuid
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from cattrs import Converter
from pydantic import BaseModel

from pipeline.results import Frame, Text
from pipeline.writing import replace_file, write_flushed
from urdf.errors import InputError


class Damaged(Exception):
    """A stored artifact is not what its manifest says."""

    def __init__(self, message: str, folder: Path) -> None:
        super().__init__(message)
        self.folder = folder


@dataclass(frozen=True)
class Entry:
    """A stored artifact: where it is, and its manifest."""

    folder: Path
    manifest: Mapping[str, Any]

    @property
    def digest(self) -> str:
        """Of the content alone: the same bytes from another stage run have the same digest."""
        return digest({name: f["sha256"] for name, f in self.manifest["files"].items()})


def canonical(value: Any) -> str:
    return json.dumps(value, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


def digest(value: Any) -> str:
    """SHA-256 of bytes, or of a value's canonical JSON."""
    return hashlib.sha256(value if isinstance(value, bytes) else canonical(value).encode()).hexdigest()


@dataclass
class _Codec:
    """One value's way to files and back: a converter whose hooks fill, or read, the files beside value.json."""

    arrays: dict[str, Any] = field(default_factory=dict)
    files: dict[str, bytes] = field(default_factory=dict)

    def converter(self) -> Converter:
        converter = Converter(forbid_extra_keys=True)
        converter.register_unstructure_hook_func(_is(BaseModel), lambda v: v.model_dump(mode="json", by_alias=True))
        converter.register_structure_hook_func(_is(BaseModel), lambda v, kind: kind.model_validate(v))
        converter.register_unstructure_hook_func(_is(Text), self._text_out)
        converter.register_structure_hook_func(_is(Text), lambda v, kind: kind(self._file(v).decode()))
        converter.register_unstructure_hook(float, _float_out)
        converter.register_structure_hook(float, lambda v, _: float(v))
        converter.register_unstructure_hook(np.ndarray, self._array_out)
        converter.register_structure_hook(np.ndarray, lambda v, _: self.arrays[v])
        converter.register_unstructure_hook(Frame, self._table_out)
        converter.register_structure_hook(Frame, self._table_in)
        return converter

    def _array_out(self, array: Any) -> str:
        name = f"array{len(self.arrays)}"
        self.arrays[name] = array
        return name

    def _text_out(self, text: Any) -> str:
        return self._keep(text.file, str(text).encode())

    def _table_out(self, table: Any) -> str:
        buffer = io.BytesIO()
        table.to_parquet(buffer, index=False)
        return self._keep(f"table{len(self.files)}.parquet", buffer.getvalue())

    def _table_in(self, name: str, _: type) -> Any:
        import pandas as pd

        return pd.read_parquet(io.BytesIO(self._file(name)))

    def _keep(self, name: str, content: bytes) -> str:
        self.files[name] = content
        return name

    def _file(self, name: str) -> bytes:
        return self.files[name]


def _is(base: type):
    return lambda kind: isinstance(kind, type) and issubclass(kind, base)


def _float_out(value: float) -> float | str:
    return value if math.isfinite(value) else repr(value)


def encode(value: Any) -> dict[str, bytes]:
    """A value as files."""
    codec = _Codec()
    tree = codec.converter().unstructure(value)
    files = dict(codec.files)
    if codec.arrays:
        from safetensors.numpy import save

        files["arrays.safetensors"] = save({k: np.ascontiguousarray(v) for k, v in codec.arrays.items()})
    files["value.json"] = (json.dumps(tree, indent=1, allow_nan=False) + "\n").encode()
    return files


def decode(files: Mapping[str, bytes], kind: type) -> Any:
    """The value of `kind` that `encode` turned into these files."""
    codec = _Codec(files=dict(files))
    if "arrays.safetensors" in files:
        from safetensors.numpy import load

        codec.arrays = load(files["arrays.safetensors"])
    return codec.converter().structure(json.loads(files["value.json"]), kind)


class Store:
    """A folder of artifacts (`artifacts/stage/key`) and of what each robot used last (`robots/robot/stage.json`)."""

    def __init__(self, root: Path) -> None:
        self.root = root.absolute()

    def find(self, stage: str, key: str) -> Entry | None:
        """The artifact of a key; None where there is none. Raises Damaged where its manifest is broken."""
        folder = self._folder(stage, key)
        manifest = _sealed(folder)
        if manifest is not None and manifest.get("key") == key:
            return Entry(folder, manifest)
        if folder.exists():
            raise Damaged(f"{folder / 'manifest.json'}: not what was stored", folder)
        return None

    def load(self, entry: Entry, kind: type) -> Any:
        """The value, its digests checked. Raises Damaged."""
        files = {}
        for name, sealed in entry.manifest["files"].items():
            try:
                files[name] = (entry.folder / name).read_bytes()
            except OSError as error:
                raise Damaged(f"{entry.folder / name}: {error.strerror}", entry.folder) from None
            if len(files[name]) != sealed["bytes"] or digest(files[name]) != sealed["sha256"]:
                raise Damaged(f"{entry.folder / name}: its content is not what was stored", entry.folder)
        try:
            return decode(files, kind)
        except Exception as error:  # whole, but written by another version of the formats
            what = f"not readable as {kind.__name__} ({type(error).__name__})"
            raise Damaged(f"{entry.folder}: {what}", entry.folder) from None

    def save(self, stage: str, key: str, value: Any, manifest: Mapping[str, Any], replace: bool = False) -> Entry:
        """Write into a temporary folder, flush, seal, rename into place. Raises InputError where the disk refuses.

        replace: an artifact of that key that is there already gives way once the new one is whole.
        """
        files = encode(value)
        sealed = dict(manifest) | {
            "stage": stage,
            "key": key,
            "files": {name: {"bytes": len(c), "sha256": digest(c)} for name, c in sorted(files.items())},
        }
        folder, temporary = self._folder(stage, key), self.root / "tmp" / uuid.uuid4().hex
        with self._writing(temporary):
            temporary.mkdir(parents=True)
            for name, content in files.items():
                write_flushed(temporary / name, content)
            text = json.dumps(sealed | {"seal": digest(sealed)}, indent=1, sort_keys=True)
            write_flushed(temporary / "manifest.json", text.encode())
            _sync(temporary)
            folder.parent.mkdir(parents=True, exist_ok=True)
            if replace and folder.exists():
                old = temporary.with_suffix(".old")
                folder.rename(old)
                shutil.rmtree(old, ignore_errors=True)
            try:
                temporary.rename(folder)
            except OSError:
                if not (folder / "manifest.json").exists():
                    raise
                shutil.rmtree(temporary)  # another run was first, with the same bytes
            _sync(folder.parent)
        return Entry(folder, sealed)

    def set_aside(self, folder: Path) -> None:
        """Move a damaged artifact out of the way; it is kept for a look."""
        aside = self.root / "damaged" / f"{folder.parent.name}-{folder.name[:12]}-{uuid.uuid4().hex[:8]}"
        with self._writing(aside):
            aside.parent.mkdir(parents=True, exist_ok=True)
            folder.rename(aside)

    def last(self, robot: str, stage: str) -> Mapping[str, Any] | None:
        """The manifest that a robot's stage used last; None where it never ran, empty where that is lost."""
        file = self.root / "robots" / robot / f"{stage}.json"
        reference = _read_json(file)
        key = reference.get("key") if isinstance(reference, dict) else None
        if not isinstance(key, str):
            return {} if file.exists() else None
        return _sealed(self._folder(stage, key)) or {}

    def remember(self, robot: str, stage: str, key: str) -> None:
        self.publish(robot, f"{stage}.json", json.dumps({"key": key}).encode())

    def publish(self, robot: str, name: str, content: bytes) -> Path:
        """A copy for people, or a note of what was used, under a name that does not change."""
        file = self.root / "robots" / robot / name
        self._note(file, content)
        return file

    def read_memo(self) -> dict[str, Any]:
        """What was found out about source files, by their digests; empty where that file is damaged."""
        sealed = _read_json(self.root / "code.json")
        return sealed["memo"] if isinstance(sealed, dict) and _fits(sealed.get("seal"), sealed.get("memo")) else {}

    def write_memo(self, memo: Mapping[str, Any]) -> None:
        """Keep what was found out, where it is new."""
        if not set(memo) <= set(self.read_memo()):
            self._note(self.root / "code.json", json.dumps({"memo": memo, "seal": digest(memo)}).encode())

    def _note(self, file: Path, content: bytes) -> None:
        """Write what saves work or eases a look; a store that takes no more is no reason to withhold a result."""
        if not (file.is_file() and file.read_bytes() == content):
            with contextlib.suppress(OSError):
                aside = self.root / "tmp"
                for folder in (aside, file.parent):
                    folder.mkdir(parents=True, exist_ok=True)
                replace_file(file, content, aside)

    @contextmanager
    def lock(self, stage: str, key: str) -> Iterator[None]:
        """Saves work where two runs want the same artifact; correctness does not depend on it."""
        from filelock import FileLock

        folder = self.root / "locks"
        with self._writing(folder):
            folder.mkdir(parents=True, exist_ok=True)
            lock = FileLock(folder / f"{stage}-{key[:32]}.lock")
            lock.acquire()
        try:
            yield
        finally:
            lock.release()

    @contextmanager
    def _writing(self, what: Path) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            if what.parent.name == "tmp":
                shutil.rmtree(what, ignore_errors=True)
            raise InputError(
                f"store {self.root}: can't be written: {error.strerror or error}; earlier results are untouched "
                "(--store names another folder)"
            ) from None

    def _folder(self, stage: str, key: str) -> Path:
        return self.root / "artifacts" / stage / key[:40]


def _sealed(folder: Path) -> dict[str, Any] | None:
    """A folder's manifest, if it is whole."""
    manifest = _read_json(folder / "manifest.json")
    whole = isinstance(manifest, dict) and _fits(manifest.pop("seal", None), manifest)
    return manifest if whole and _well_formed(manifest) else None


def _fits(seal: Any, content: Any) -> bool:
    try:
        return seal == digest(content)
    except (ValueError, RecursionError):  # a number that is none
        return False


def _well_formed(manifest: Mapping[str, Any]) -> bool:
    """Whether a manifest says what its key was made of, and of files in its own folder what they hold."""
    files = manifest.get("files")
    return (
        isinstance(files, dict)
        and isinstance(manifest.get("parts", {}), dict)
        and all(
            name == Path(name).name and isinstance(said, dict) and {"bytes", "sha256"} <= set(said)
            for name, said in files.items()
        )
    )


def _read_json(file: Path) -> Any:
    try:
        return json.loads(file.read_bytes())
    except (OSError, ValueError, RecursionError):
        return None


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
