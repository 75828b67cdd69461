"""The commands of `kincal` about what is stored: freed, taken for the new code's, looked over."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.text import Text

from kincal.pipeline.commands.console import err, out, print_json, show_table
from kincal.pipeline.commands.options import COMMON, Common, Flag, Json, Robot, opened
from kincal.urdf.errors import CalibrationError, InputError


def gc(
    *,
    dry_run: Flag = False,
    unfinished: Flag = False,
    gone: Flag = False,
    keep_damaged: Flag = False,
    store: Path = COMMON.store,
    json: Json = False,
) -> None:
    """Free what no robot refers to: results of earlier settings, leftovers, locks, and what was damaged.

    Parameters
    ----------
    dry_run
        Say what would be freed, and free nothing.
    unfinished
        Also what sweeps and reproductions made that did not come to their end.
    gone
        Also robots whose robot.toml is not there any more, with their reports.
    keep_damaged
        Leave what was set aside because it was damaged.
    store
        The folder of cached artifacts.
    """
    from kincal.pipeline.store.garbage import free, garbage, unreferenced
    from kincal.pipeline.store.store import Store

    if not store.is_dir():
        raise InputError(f"--store {store}: no such folder")
    kept = Store(store)
    found = garbage(kept, unfinished=unfinished, gone=gone, keep_damaged=keep_damaged)
    freed = found.found if dry_run else free(kept, found.found)
    remarks = list(unreferenced(found.roots, gone=gone, unfinished=unfinished))
    counts, sizes = Counter(one.kind for one in freed), Counter()
    for one in freed:
        sizes[one.kind] += one.bytes
    if json:
        kinds = {kind: {"count": counts[kind], "bytes": sizes[kind]} for kind in counts}
        paths = sorted(str(one.path.relative_to(kept.root)) for one in freed)
        print_json({"dry_run": dry_run, "freed": kinds, "paths": paths, "kept": remarks})
        return
    for remark in remarks:
        err.print(Text(f"note: {remark}", style="yellow"), soft_wrap=True)
    if dry_run:
        for one in freed:
            out.print(Text(f"{one.kind:<10} {one.bytes:>10} {one.path.relative_to(kept.root)}"), soft_wrap=True)
    parts = ", ".join(f"{n} {kind}{'s' * (n > 1 and kind != 'damaged')}" for kind, n in sorted(counts.items()))
    said = "would free" if dry_run else "freed"
    out.print(Text(f"{said} {len(freed)} ({parts or 'nothing'}), {sum(sizes.values())} bytes"), soft_wrap=True)


def accept(
    robot: Robot,
    *,
    stage: Annotated[list[str] | None, Parameter(negative=())] = None,
    json: Json = False,
    common: Common = COMMON,
) -> None:
    """After a refactoring that changes no result: take what is stored for what the code of now would make.

    Parameters
    ----------
    stage
        Of this stage alone; may be repeated.
    """
    from kincal.pipeline.run.acceptance import accept as accepted

    found = accepted(opened(robot, common), stage or ())
    if json:
        print_json([{"stage": a.stage, "changed": list(a.changed), "key": a.key, "digest": a.digest} for a in found])
        return
    for a in found:
        out.print(Text(f"{a.stage:<10} accepted: code {', '.join(a.changed)} changed"), soft_wrap=True)
    if not found:
        out.print("nothing to accept: no stage's code has changed")


def verify(robot: Robot, *, json: Json = False, common: Common = COMMON) -> None:
    """Check all that the robot's results rest on: seals, digests, the chain, and the comparison made once more."""
    from kincal.pipeline.report.tables import Table
    from kincal.pipeline.run.verification import verify as verified

    found = verified(opened(robot, common))
    if json:
        print_json(found.json())
    else:
        rows = [
            (c.stage, c.entry.digest[:12] if c.entry else "", "; ".join(c.problems) or "as stored")
            for c in found.stages
        ]
        show_table(Table(("stage", "content", "found"), tuple(rows)), align="left")
        for note, n in found.studies.items():
            out.print(Text(f"{note}: {n} artifacts"))
        if found.derived is None:
            out.print("comparison: not made once more")
        else:
            same = "the same bytes" if found.derived.same_bytes else f"differs by {found.derived.largest:.2g} at most"
            code = ", by code that has changed since" if found.derived.code_changed else ""
            out.print(Text(f"comparison, made once more of the stored inputs{code}: {same}"), soft_wrap=True)
    if found.problems:
        more = f" and {len(found.problems) - 1} more" if len(found.problems) > 1 else ""
        raise CalibrationError(f"{found.robot}: {found.problems[0]}{more}")
