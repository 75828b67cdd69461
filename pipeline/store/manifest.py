"""The manifests of stored artifacts: what they are of, and the seals that show whether they are whole."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Any

from kincal.pipeline.store.digests import digest


class Damaged(Exception):
    """A stored artifact is not what its manifest says. text: of that manifest, as it was read; None: there was none."""

    def __init__(self, message: str, folder: Path, text: bytes | None) -> None:
        super().__init__(message)
        self.folder = folder
        self.text = text


@dataclass(frozen=True)
class Entry:
    """A stored artifact: where it is, and its manifest."""

    folder: Path
    manifest: Mapping[str, Any]
    text: bytes = field(repr=False)  # the manifest as it is stored

    @cached_property
    def digest(self) -> str:
        """Of the content alone: the same bytes from another stage run have the same digest."""
        return digest({name: f["sha256"] for name, f in self.manifest["files"].items()})


@lru_cache(maxsize=1)
def memo_of(text: bytes | None) -> Mapping[str, Any]:
    sealed = _parsed(text)
    return sealed["memo"] if isinstance(sealed, dict) and _fits(sealed.get("seal"), sealed.get("memo")) else {}


@lru_cache(maxsize=256)
def entry_of(folder: Path, text: bytes | None) -> Entry | None:
    """Robots share artifacts: a manifest's seal is checked once for as long as its bytes stay the same."""
    manifest = sealed_manifest(text)
    return None if text is None or manifest is None else Entry(folder, manifest, text)


def sealed_manifest(text: bytes | None) -> dict[str, Any] | None:
    """A manifest, if it is whole."""
    manifest = _parsed(text)
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
            name == Path(name).name and isinstance(sealed, dict) and {"bytes", "sha256"} <= set(sealed)
            for name, sealed in files.items()
        )
    )


def read_json(file: Path) -> Any:
    return _parsed(file_content(file))


def _parsed(text: bytes | None) -> Any:
    try:
        return None if text is None else json.loads(text)
    except (ValueError, RecursionError):
        return None


def file_content(file: Path) -> bytes | None:
    try:
        return file.read_bytes()
    except OSError:
        return None
