"""Runs the stages of a robot through the cache: what is fresh is not run, and what is not says why."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

from pydantic_core import to_jsonable_python

from kincal.pipeline.results import Report
from kincal.pipeline.run.changes import change, explain, file_digest
from kincal.pipeline.run.fingerprint import Code
from kincal.pipeline.run.memory import within_memory
from kincal.pipeline.run.provenance import published
from kincal.pipeline.run.stage import Stage, all_stages, needed, version
from kincal.pipeline.run.threads import fixed_threads
from kincal.pipeline.store.digests import digest
from kincal.pipeline.store.manifest import Damaged, Entry
from kincal.pipeline.store.store import Store
from kincal.pipeline.watch import watched
from kincal.urdf.description import PATHS, Robot
from kincal.urdf.errors import CalibrationError, InputError

_ATTEMPTS = 4  # to read a result that is damaged as soon as it is written
_PATIENCE = 100  # times that others may free a result before it is read: each `gc` frees it once at most


@dataclass(frozen=True)
class Event:
    """Something to show: a stage begins (`seconds` is None), is done, or was cached."""

    stage: str
    state: str  # running, advanced (`share`), ran, cached, damaged, noted (`why`: a warning about the data)
    why: str = ""
    seconds: float | None = None
    share: float | None = None  # of the stage's work that is done


@dataclass
class Run:
    """One robot's way through the stages."""

    robot: Robot
    store: Store
    force_from: str | None = None
    observe: Callable[[Event], None] = lambda event: None
    command: str = ""
    entries: dict[str, Entry] = field(default_factory=dict)  # {stage: its artifact}, of those that are up to date
    _code: Code | None = None

    @cached_property
    def robot_id(self) -> str:
        """Two robots of one name in different folders don't mix, nor do units of fleet files."""
        return f"{self.robot.description.name}-{digest(str(self.robot.stands_in).encode())[:10]}"

    def until(self, *names: str) -> list[Any]:
        """Bring the stages `names` up to date and return their results, read back from the store."""
        self._bring_all(names)
        self._note()
        return [self._value(all_stages()[name]) for name in names]

    def beyond(self, stage: Stage) -> Any:
        """The result of a stage that is none of the pipeline's own, brought up to date like these."""
        self._bring_all(stage.inputs.values())
        self._bring(stage, forced=False)
        self._note()
        return self._value(stage)

    def _note(self) -> None:
        self.store.write_memo(self.code.used)
        self.store.describe(self.robot_id, self.robot.stands_in)

    def publish(self, report: Report) -> Path:
        """The report where people look for it, with its provenance."""
        return self.store.publish(self.robot_id, report.html.file, published(report.html, self.entries))

    @property
    def code(self) -> Code:
        if self._code is None:
            self._code = Code(memo=self.store.read_memo())
        return self._code

    def _bring_all(self, names: Iterable[str]) -> None:
        forced = False
        wanted = {stage.name for name in names for stage in needed(name)}
        for stage in (s for s in all_stages().values() if s.name in wanted):
            forced = forced or stage.name == self.force_from
            with within_memory(stage.name):
                self._bring(stage, forced)

    def _bring(self, stage: Stage, forced: bool) -> None:
        parts = self.key_parts(stage)
        key = digest(parts)
        entry = None if forced else self._find(stage, key)
        if entry is None:
            why = "--force-from" if forced else explain(self.store.last(self.robot_id, stage.name), parts)
            self._produce(stage, parts, key, why, forced)
        else:
            self.entries[stage.name] = entry
            self.store.remember(self.robot_id, stage.name, key)
            self.observe(Event(stage.name, "cached"))

    def _find(self, stage: Stage, key: str) -> Entry | None:
        """The artifact of a key; a damaged one is set aside."""
        try:
            return self.store.find(stage.name, key)
        except Damaged as damage:
            self._set_aside(stage, damage)
            return None

    def _set_aside(self, stage: Stage, damage: Damaged) -> None:
        self.observe(Event(stage.name, "damaged", str(damage)))
        self.store.set_aside(damage)

    def _produce(self, stage: Stage, parts: Mapping[str, Any], key: str, why: str, forced: bool = False) -> None:
        self.observe(Event(stage.name, "running", why))
        inputs = {name: self._value(all_stages()[source]) for name, source in stage.inputs.items()}
        with self.store.lock(stage.name, key):
            began = time.perf_counter()
            entry = None if forced else self._find(stage, key)  # another run may have made it meanwhile
            if entry is None:
                try:
                    with fixed_threads(stage.libraries), watched(partial(self._advanced, stage.name)):
                        value = stage.call(inputs | {name: self._setting(name) for name in stage.settings})
                except FloatingPointError as error:  # a loss that is not a number, a matrix that can't be factored
                    raise CalibrationError(f"{stage.name}: {error}; nothing was stored") from None
                for note in getattr(value, "warnings", ()):
                    self.observe(Event(stage.name, "noted", note))
                seconds = time.perf_counter() - began
                self._check_unchanged(stage, parts)
                provenance = {
                    "robot": self.robot_id,
                    "command": self.command,
                    "made": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()),
                    "seconds": round(seconds, 3),
                    "versions": {name: version(name) for name in stage.libraries},
                }
                entry = self.store.save(
                    stage.name, key, value, {"parts": parts, "provenance": provenance}, replace=forced
                )
        self.entries[stage.name] = entry
        self.store.remember(self.robot_id, stage.name, key)
        self.observe(Event(stage.name, "ran", why, time.perf_counter() - began))

    def _advanced(self, stage: str, share: float) -> None:
        self.observe(Event(stage, "advanced", share=share))

    def _check_unchanged(self, stage: Stage, parts: Mapping[str, Any]) -> None:
        """What the stage has read is what its key was made of. Raises InputError."""
        edited = self.code.edited(*stage.place)
        changed = f"the source of {edited} changed" if edited else change(parts, self.key_parts(stage))
        if changed is not None:
            raise InputError(f"{stage.name}: {changed} while it ran; nothing was stored: run it again")

    def _value(self, stage: Stage) -> Any:
        """A stage's result from the store; one that is damaged is set aside, and one that is gone is made again."""
        damaged = gone = 0
        while damaged < _ATTEMPTS and gone < _PATIENCE:
            entry = self.entries[stage.name]
            try:
                return self.store.load(entry, stage.result)
            except Damaged as damage:
                if entry.folder.exists():
                    damaged, why = damaged + 1, "was damaged"
                    self._set_aside(stage, damage)
                else:  # freed by `gc` between finding and reading
                    gone, why = gone + 1, "is gone"
            parts = self.key_parts(stage)
            self._produce(stage, parts, digest(parts), f"its artifact {why}")
        raise InputError(f"store {self.store.root}: {stage.name}: what is written there does not stay as it is written")

    def key_parts(self, stage: Stage) -> dict[str, Any]:
        """All that a stage's result depends on; its digest is the key. Where a file lies is no part of it."""
        settings = {name: to_jsonable_python(self._setting(name), by_alias=True) for name in stage.settings}
        files = {}
        for *tables, key in PATHS:
            table = settings.get(tables[0], {}) if tables else settings
            if table.get(key) is not None:
                name = ".".join((*tables, key))
                try:
                    files[name] = file_digest(Path(table[key]))
                except InputError as error:
                    raise InputError(f"{name}: {error}") from None
                table[key] = "(file)"
        return {
            "stage": stage.name,
            "code": self.code.fingerprint(*stage.place),
            "settings": settings,
            "files": files,
            "inputs": {source: self.entries[source].digest for source in stage.inputs.values()},
            "libraries": {name: ".".join(version(name).split(".")[:2]) for name in stage.libraries}
            | {"python": f"{sys.version_info.major}.{sys.version_info.minor}"},
        }

    def _setting(self, name: str) -> Any:
        return getattr(self.robot.description, name)

    def status(self) -> Iterator[tuple[str, str, str]]:
        """(stage, fresh | stale | missing, why) of every stage, from manifests and source alone."""
        for stage in all_stages().values():
            last = self.store.last(self.robot_id, stage.name)
            if any(source not in self.entries for source in stage.inputs.values()):
                stale = next(s for s in stage.inputs.values() if s not in self.entries)
                yield stage.name, "missing" if last is None else "stale", f"{stale} must run first"
                continue
            parts = self.key_parts(stage)
            try:
                entry = self.store.find(stage.name, digest(parts))
            except Damaged:
                yield stage.name, "stale", "its artifact is gone or damaged"
                continue
            if entry is None:
                why = explain(last, parts)
                if self.store.freed(stage.name, digest(parts)):
                    why += "; an earlier result of these was freed by `kincal cache gc`"
                yield stage.name, "missing" if last is None else "stale", why
            else:
                self.entries[stage.name] = entry
                yield stage.name, "fresh", ""
