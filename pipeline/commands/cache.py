"""`kincal cache`: what is stored may go, stays valid, or is looked over."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

from cyclopts import App, Parameter
from rich.text import Text

from kincal.pipeline.commands.console import out, print_json, show_table
from kincal.pipeline.commands.options import COMMON, Common, Flag, Json, Robot, command_line
from kincal.pipeline.interface.progress import err
from kincal.urdf.errors import CalibrationError, InputError

app = App(name="cache", help="Free, accept or verify cached results.", help_format="plaintext", version_flags=[])


def _moved(name: str) -> Callable[..., None]:
    """A command under its old name: one line that names the new one."""

    def old(*arguments: Annotated[Any, Parameter(allow_leading_hyphen=True)]) -> None:
        raise InputError(f"kincal {name}: write kincal cache {name}")

    old.__doc__ = f"Now: kincal cache {name}."
    return old


moved_gc, moved_accept, moved_verify = map(_moved, ("gc", "accept", "verify"))


@app.command
def gc(
    *,
    dry_run: Flag = False,
    unfinished: Flag = False,
    gone: Flag = False,
    keep_damaged: Flag = False,
    store: Path = COMMON.store,
    json: Json = False,
) -> None:
    """Delete results that no robot uses: earlier settings, leftovers, locks, damaged files.

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
    from kincal.pipeline.interface.cache import collect

    result = collect(store, dry_run=dry_run, unfinished=unfinished, gone=gone, keep_damaged=keep_damaged)
    if json:
        print_json(result.to_dict(), "cache-gc")
        return
    for remark in result.remarks:
        err.print(Text(f"note: {remark}", style="yellow"), soft_wrap=True)
    if dry_run:
        for one in result.freed:
            out.print(Text(f"{one.kind:<10} {one.bytes:>10} {one.path.relative_to(result.root)}"), soft_wrap=True)
    parts = ", ".join(f"{n} {kind}{'s' * (n > 1 and kind != 'damaged')}" for kind, n in result.counts.items())
    verb = "would free" if dry_run else "freed"
    out.print(Text(f"{verb} {len(result.freed)} ({parts or 'nothing'}), {result.bytes} bytes"), soft_wrap=True)


@app.command
def accept(
    robot: Robot,
    *,
    stage: Annotated[list[str] | None, Parameter(negative=())] = None,
    json: Json = False,
    common: Common = COMMON,
) -> None:
    """Mark cached results as valid for the current code, after a change of code that changes no result.

    Parameters
    ----------
    stage
        Of this stage alone; may be repeated.
    """
    from kincal.pipeline.interface.cache import accept as accepted
    from kincal.pipeline.interface.robots import load

    result = accepted(load(robot, common.overrides), common.store, stage or (), command_line())
    if json:
        print_json([{"stage": a.stage, "changed": list(a.changed), "key": a.key, "digest": a.digest} for a in result])
        return
    for a in result:
        out.print(Text(f"{a.stage:<10} accepted: code {', '.join(a.changed)} changed"), soft_wrap=True)
    if not result:
        out.print("nothing to accept: no stage's code has changed")


@app.command
def verify(robot: Robot, *, json: Json = False, common: Common = COMMON) -> None:
    """Check the stored results: seals, digests, the chain of inputs, and the comparison computed again."""
    from kincal.pipeline.interface.cache import verify as verified
    from kincal.pipeline.interface.robots import load
    from kincal.pipeline.report.tables import Table

    result = verified(load(robot, common.overrides), common.store, command_line(), progress=True)
    if json:
        print_json(result.json(), "cache-verify")
    else:
        rows = [
            (c.stage, c.entry.digest[:12] if c.entry else "", "; ".join(c.problems) or "as stored")
            for c in result.stages
        ]
        show_table(Table(("stage", "content", "found"), tuple(rows)), align="left")
        for note, n in result.studies.items():
            out.print(Text(f"{note}: {n} artifacts"))
        if result.derived is None:
            out.print("comparison: not made once more")
        else:
            same = "the same bytes" if result.derived.same_bytes else f"differs by {result.derived.largest:.2g} at most"
            code = ", by code that has changed since" if result.derived.code_changed else ""
            out.print(Text(f"comparison, made once more of the stored inputs{code}: {same}"), soft_wrap=True)
        out.print(Text(result.promise), soft_wrap=True)
    if result.problems:
        more = f" and {len(result.problems) - 1} more" if len(result.problems) > 1 else ""
        raise CalibrationError(f"{result.robot}: {result.problems[0]}{more}")
