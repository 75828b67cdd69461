"""The store of cached results: what may go, what stays valid, and whether it is what was stored."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kincal.pipeline.interface.progress import StageObserver
from kincal.pipeline.interface.robots import RobotLike
from kincal.pipeline.interface.sessions import COMMAND, opened
from kincal.urdf.errors import InputError

if TYPE_CHECKING:
    from kincal.pipeline.run.acceptance import Accepted
    from kincal.pipeline.run.verification import Verified
    from kincal.pipeline.store.garbage import Removable


@dataclass(frozen=True)
class Collected:
    """What `collect` freed, or would free."""

    dry_run: bool
    root: Path
    freed: tuple[Removable, ...]
    remarks: tuple[str, ...]  # what was kept, and why

    @property
    def counts(self) -> dict[str, int]:
        """Count what was freed: {kind: how many}."""
        return dict(sorted(Counter(one.kind for one in self.freed).items()))

    @property
    def bytes(self) -> int:
        """In all."""
        return sum(one.bytes for one in self.freed)

    def to_dict(self) -> dict[str, Any]:
        """The document of `kincal cache gc --json`."""
        kinds = {
            kind: {"count": n, "bytes": sum(one.bytes for one in self.freed if one.kind == kind)}
            for kind, n in self.counts.items()
        }
        paths = sorted(str(one.path.relative_to(self.root)) for one in self.freed)
        return {"dry_run": self.dry_run, "freed": kinds, "paths": paths, "kept": list(self.remarks)}


def collect(
    store: str | PathLike[str],
    *,
    dry_run: bool = False,
    unfinished: bool = False,
    gone: bool = False,
    keep_damaged: bool = False,
) -> Collected:
    """Free what no robot refers to. Raises InputError where there is no such store, or it can't be written.

    unfinished: also what sweeps made that did not come to their end. gone: also robots whose robot.toml is gone.
    """
    from kincal.pipeline.store.garbage import free, garbage, unreferenced
    from kincal.pipeline.store.ownership import warn_of_others
    from kincal.pipeline.store.store import Store

    if not Path(store).is_dir():
        raise InputError(f"--store {store}: no such folder")
    kept = Store(Path(store))
    warn_of_others(kept.root)
    unused = garbage(kept, unfinished=unfinished, gone=gone, keep_damaged=keep_damaged)
    freed = unused.found if dry_run else free(kept, unused.found)
    remarks = tuple(unreferenced(unused.roots, gone=gone, unfinished=unfinished))
    return Collected(dry_run, kept.root, tuple(freed), remarks)


def accept(
    robot: RobotLike, store: str | PathLike[str], stages: Collection[str] = (), command: str = COMMAND
) -> list[Accepted]:
    """Mark cached results as valid for the current code; stages: of these alone. Raises InputError."""
    from kincal.pipeline.run.acceptance import accept as accepted

    return accepted(opened(robot, store, command=command), stages)


def verify(
    robot: RobotLike,
    store: str | PathLike[str],
    command: str = COMMAND,
    progress: StageObserver = False,
) -> Verified:
    """Check what a robot's results rest on: seals, digests, the chain, and the comparison made once more."""
    from kincal.pipeline.run.verification import verify as verified

    return verified(opened(robot, store, progress, command))
