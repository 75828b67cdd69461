"""After a refactoring that changes no result: what is stored is taken for what the new code would make."""

from __future__ import annotations

import time
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from kincal.pipeline.run.changes import change
from kincal.pipeline.run.runner import Run
from kincal.pipeline.run.stage import Stage, all_stages
from kincal.pipeline.store.digests import digest
from kincal.pipeline.store.manifest import Damaged, Entry
from kincal.urdf.description import nearest
from kincal.urdf.errors import InputError


@dataclass(frozen=True)
class Accepted:
    """A stage whose artifact got the key of the new code."""

    stage: str
    changed: tuple[str, ...]  # units of code
    key: str
    digest: str  # of the content: as before, so that nothing below runs


class _Plan(NamedTuple):
    stage: Stage
    old: Entry
    files: Mapping[str, bytes]  # its payload
    parts: Mapping[str, Any]  # of its new key
    changed: tuple[str, ...]


def accept(session: Run, only: Collection[str] = ()) -> list[Accepted]:
    """Take the artifacts of last time for those of the code of now; only: of these stages alone.

    Raises InputError, and changes nothing, where anything but code changed, or an artifact is not what was stored.
    """
    for name in only:
        if name not in all_stages():
            raise InputError(f"--stage {name}: no such stage; {nearest(name, all_stages())}")
    planned = [
        stage_plan for stage in all_stages().values() if (stage_plan := _planned(session, stage, only)) is not None
    ]
    made = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    accepted = []
    for stage, old, files, parts, changed in planned:
        key = digest(parts)
        record = {"at": made, "command": session.command, "from_key": old.manifest["key"], "changed": list(changed)}
        record["from_code"] = digest(old.manifest["parts"]["code"])
        provenance = old.manifest["provenance"] | {
            "accepted": [*old.manifest["provenance"].get("accepted", []), record]
        }
        entry = session.store.put(stage.name, key, files, {"parts": parts, "provenance": provenance})
        session.store.remember(session.robot_id, stage.name, key)
        accepted.append(Accepted(stage.name, changed, key, entry.digest))
    return accepted


def _planned(session: Run, stage: Stage, only: Collection[str]) -> _Plan | None:
    """What is to be accepted of a stage: None where it is up to date, or out of question. Raises InputError."""
    wanted = not only or stage.name in only
    missing = [source for source in stage.inputs.values() if source not in session.entries]
    last = session.store.last(session.robot_id, stage.name)
    if missing or last is None:
        if stage.name in only:
            why = f"{missing[0]} is not up to date: accept it too, or run it" if missing else "it never ran"
            raise InputError(f"{stage.name}: nothing to accept: {why}")
        return None
    parts = session.key_parts(stage)
    try:
        entry = session.store.find(stage.name, digest(parts))
        if entry is not None:
            session.entries[stage.name] = entry
            return None
        if not wanted:
            return None
        old = session.store.find(stage.name, last["key"]) if last else None
    except Damaged as damage:
        raise InputError(f"{stage.name}: can't be accepted: {damage}; run it") from None
    if old is None:
        raise InputError(f"{stage.name}: can't be accepted: its artifact is gone or damaged; run it")
    before, now = old.manifest["parts"], parts["code"]
    other = change(before | {"code": now}, parts)
    if other is not None:
        raise InputError(f"{stage.name}: can't be accepted: {other}; allowed is a change of code alone")
    files = _files(session, stage, old)
    session.entries[stage.name] = old  # its content, and so its digest, is what those below rest on
    units = {**before["code"], **now}
    return _Plan(stage, old, files, parts, tuple(sorted(u for u in units if before["code"].get(u) != now.get(u))))


def _files(session: Run, stage: Stage, old: Entry) -> dict[str, bytes]:
    """The payload; readable as what the stage of now makes. Raises InputError."""
    try:
        session.store.load(old, stage.result)
        return session.store.files(old)
    except Damaged as damage:
        raise InputError(f"{stage.name}: can't be accepted: {damage}; run it") from None
