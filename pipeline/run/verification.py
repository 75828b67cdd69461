"""Whether what a robot's results rest on is still what was stored, and whether the comparison follows from it."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, get_type_hints

from pydantic import TypeAdapter

from kincal.pipeline.run.provenance import published
from kincal.pipeline.run.runner import Run
from kincal.pipeline.run.stage import all_stages
from kincal.pipeline.store.codec import encode
from kincal.pipeline.store.digests import digest
from kincal.pipeline.store.manifest import Damaged, Entry, read_json
from kincal.pipeline.store.ownership import PROMISE
from kincal.pipeline.store.store import Store
from kincal.urdf.errors import InputError

CLOSE = 1e-9  # relative: the same numbers but for the order of sums


@dataclass(frozen=True)
class Checked:
    """A stage's artifact; `problems`: what is wrong with it."""

    stage: str
    entry: Entry | None
    problems: tuple[str, ...]


@dataclass(frozen=True)
class Derived:
    """The comparison, made once more of the stored inputs, beside the stored one."""

    same_bytes: bool
    largest: float  # difference of a number, relative; infinite where something else than numbers differs
    where: str
    code_changed: bool  # since it was stored

    @property
    def agrees(self) -> bool:
        return self.largest <= CLOSE


@dataclass(frozen=True)
class Verified:
    """All that was looked at."""

    robot: str
    stages: tuple[Checked, ...]
    studies: Mapping[str, int] = field(default_factory=dict)  # {note: artifacts that it names}
    derived: Derived | None = None  # None: there is no comparison, or its inputs are damaged
    others: tuple[str, ...] = ()  # problems beside those of the stages
    promise: str = PROMISE  # what a seal is worth

    @property
    def problems(self) -> list[str]:
        problems = [f"{c.stage}: {problem}" for c in self.stages for problem in c.problems]
        if self.derived is not None and not self.derived.agrees:
            by = f"by {self.derived.largest:.3g} of its size"
            problems.append(f"comparison: what follows from the stored inputs differs in {self.derived.where} {by}")
        return [*problems, *self.others]

    def json(self) -> dict[str, Any]:
        """The document of `verify --json`."""
        derived = self.derived
        return {
            "robot": self.robot,
            "stages": [_stage_json(checked) for checked in self.stages],
            "studies": dict(self.studies),
            "comparison": derived
            and {
                "same_bytes": derived.same_bytes,
                "largest_relative_difference": derived.largest if derived.largest < float("inf") else None,
                "where": derived.where,
                "code_changed": derived.code_changed,
            },
            "problems": self.problems,
        }


def _stage_json(checked: Checked) -> dict[str, Any]:
    manifest = checked.entry.manifest if checked.entry else {}
    document = {"stage": checked.stage, "key": manifest.get("key"), "digest": checked.entry and checked.entry.digest}
    provenance = {
        name: manifest.get("provenance", {}).get(name) for name in ("made", "command", "versions", "accepted")
    }
    return document | provenance | {"problems": list(checked.problems)}


def verify(session: Run) -> Verified:
    """Check what the robot used last, changing nothing. Raises InputError where it never ran."""
    store, robot = session.store, session.robot_id
    stages: dict[str, Checked] = {}
    for stage in all_stages():
        last = store.last(robot, stage)
        if last is not None:
            stages[stage] = _checked(store, stage, last, stages)
    if not stages:
        raise InputError(f"{session.robot.description.name}: nothing to verify in {store.root}: it never ran")
    studies, others = _studies(store, robot)
    sound = {name: c.entry for name, c in stages.items() if c.entry and not c.problems}
    needed = {"evaluate", *all_stages()["evaluate"].inputs.values()}
    derived = _derived(session, sound) if needed <= set(sound) else None
    page = store.root / "robots" / robot / "report.html"
    if page.is_file() and set(all_stages()) <= set(sound):
        report = store.load(sound["report"], all_stages()["report"].result)
        if page.read_bytes() != published(report.html, sound):
            others.append(f"{page}: is not the report that was stored; kincal run writes it again")
    return Verified(session.robot.description.name, tuple(stages.values()), studies, derived, tuple(others))


def _checked(store: Store, stage: str, last: Mapping[str, Any], before: Mapping[str, Checked]) -> Checked:
    try:
        entry = store.find(stage, last["key"]) if last else None
    except Damaged as damage:
        return Checked(stage, None, (str(damage),))
    if entry is None:
        return Checked(stage, None, ("its artifact is gone, or its manifest damaged",))
    return Checked(stage, entry, tuple(_problems(store, stage, entry, before)))


def _problems(store: Store, stage: str, entry: Entry, before: Mapping[str, Checked]) -> Iterator[str]:
    try:
        store.files(entry)
    except Damaged as damage:
        yield str(damage)
    parts = entry.manifest["parts"]
    if digest(parts) != entry.manifest["key"]:
        yield "its key is not that of what it was made of"
    for source, expected in parts["inputs"].items():
        source_entry = before[source].entry if source in before else None
        if source_entry is not None and source_entry.digest != expected:
            yield f"rests on another {source} than the robot used last"
        elif source_entry is None:
            yield f"{source}, on which it rests, is gone or damaged"


def _studies(store: Store, robot: str) -> tuple[dict[str, int], list[str]]:
    """What sweeps and reproductions of the robot used, and what is wrong with that."""
    studies, problems = {}, []
    for note in sorted((store.root / "robots" / robot).glob("*.json")):
        content = read_json(note)
        if not isinstance(content, dict) or "references" not in content:
            continue
        if content.pop("seal", None) != digest(content):
            problems.append(f"{note}: is not what was noted")
            continue
        studies[note.stem] = len(content["references"])
        for stage, key in content["references"]:
            try:
                entry = store.find(stage, key)
                if entry is None:
                    problems.append(f"{note.stem}: {stage} {key[:12]} is gone")
                else:
                    store.files(entry)
            except Damaged as damage:
                problems.append(f"{note.stem}: {damage}")
    return studies, problems


def _derived(session: Run, entries: Mapping[str, Entry]) -> Derived:
    """Run `evaluate` on what is stored: its inputs, and the settings that its manifest names."""
    stage, stored = all_stages()["evaluate"], entries["evaluate"]
    hints = get_type_hints(stage.function)
    for bundle in stage.bundles.values():
        hints |= get_type_hints(bundle)
    given: dict[str, Any] = {
        name: session.store.load(entries[source], all_stages()[source].result) for name, source in stage.inputs.items()
    }
    for name in stage.settings:
        given[name] = TypeAdapter(hints[name]).validate_json(json.dumps(stored.manifest["parts"]["settings"][name]))
    derived, before = encode(stage.call(given)), session.store.files(stored)
    code = session.code.fingerprint(*stage.place)
    changed = code != stored.manifest["parts"]["code"]
    if derived == before:
        return Derived(True, 0.0, "", changed)
    differences = _differences(json.loads(before["value.json"]), json.loads(derived["value.json"]), "")
    largest, where = max(differences, default=(0.0, ""))
    return Derived(False, largest, where, changed)


def _differences(old: Any, new: Any, where: str) -> Iterator[tuple[float, str]]:
    """(relative difference, where) of two plain values, leaf by leaf."""
    if isinstance(old, dict) and isinstance(new, dict) and list(old) == list(new):
        for name in old:
            yield from _differences(old[name], new[name], f"{where}.{name}" if where else name)
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for k, pair in enumerate(zip(old, new, strict=True)):
            yield from _differences(*pair, f"{where}[{k}]")
    elif isinstance(old, float) and isinstance(new, float):
        yield abs(new - old) / max(abs(old), abs(new), 1e-300), where
    elif old != new:
        yield float("inf"), where
