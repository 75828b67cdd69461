"""A finished store that `benchmarks.damage` damages, and what a run makes of it afterwards."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.small import QUICK
from kincal.pipeline.run.fingerprint import Code
from kincal.pipeline.run.runner import Run
from kincal.pipeline.run.stage import Stage, all_stages
from kincal.pipeline.store import store as artifacts
from kincal.pipeline.store.codec import encode
from kincal.pipeline.store.digests import digest
from kincal.pipeline.store.manifest import Entry
from kincal.pipeline.store.store import Store
from kincal.urdf.description import load_robot

Digests = dict[str, str]  # {stage: of its result's content}


@dataclass(frozen=True)
class Found:
    """Of one case."""

    wrong: bool = False
    lost: bool = False
    said: str = ""


@dataclass(frozen=True)
class Known(Stage):
    """A stage that answers with what it is known to make."""

    kind: type

    @property
    def result(self) -> type:
        return self.kind

    def call(self, values: Mapping[str, Any]) -> Any:
        return self.function(**values)


@dataclass(frozen=True)
class Clean:
    """A finished store without damage, and what its stages made."""

    store: Path
    digests: Digests
    values: dict[str, Any]

    @contextmanager
    def known(self) -> Iterator[None]:
        """Within: no stage computes, and files whose digests were checked are not parsed again."""
        table, usual = all_stages(), dict(all_stages())
        files = {id(value): encode(value) for value in self.values.values()}
        values = {content(parts): self.values[name] for name, parts in zip(self.values, files.values(), strict=True)}
        coded = artifacts.encode, artifacts.decode
        artifacts.encode = lambda value: files.get(id(value)) or coded[0](value)
        artifacts.decode = lambda parts, kind: values.get(content(parts)) or coded[1](parts, kind)
        for name, stage in usual.items():

            def answer(_value: Any = self.values[name], **_: Any) -> Any:
                return _value

            answer.__module__, answer.__name__ = stage.place
            fields = {f.name: getattr(stage, f.name) for f in dataclasses.fields(stage)}
            table[name] = Known(**(fields | {"function": answer}), kind=stage.result)
        try:
            yield
        finally:
            table.update(usual)
            artifacts.encode, artifacts.decode = coded

    def after(self, store: Path, may_run: set[str] | None = None, code: Code | None = None, **options: Any) -> Found:
        """What a run of all stages on that store makes of it. may_run: the stages that may; default: any."""
        try:
            found, ran = finish(store, code=code, **options)
        except Exception as error:  # whatever it is, it is a case that did not heal
            return Found(lost=True, said=f"{type(error).__name__}: {error}")
        wrong = [name for name in self.digests if found[name] != self.digests[name]]
        page = self.values["report"].html.encode()
        if any(file.read_bytes() != page for file in (store / "robots").glob("*/report.html")):
            wrong.append("report.html")
        idle = ran - may_run if may_run is not None else set()
        return Found(bool(wrong), bool(idle), f"wrong {wrong}, made again {sorted(idle)}")


def finish(
    store: Path, settings: tuple[str, ...] = QUICK, code: Code | None = None, force_from: str | None = None
) -> tuple[Digests, set[str]]:
    """Run all stages: {stage: digest of the value that was handed out}, and the stages that ran."""
    events: list[Any] = []
    run = Run(load_robot("ups3_s", settings), Store(store), force_from, events.append, _code=code or Code(memo=_memo()))
    values = run.until(*all_stages())
    run.store.publish(run.robot_id, "report.html", values[-1].html.encode())
    handed = {name: content(artifacts.encode(value)) for name, value in zip(all_stages(), values, strict=True)}
    return handed, {event.stage for event in events if event.state == "ran"}


def content(files: Mapping[str, bytes]) -> str:
    return digest({name: digest(part) for name, part in sorted(files.items())})


_MEMO: dict[str, Any] = {}


def _memo() -> dict[str, Any]:
    return _MEMO


def clean(folder: Path) -> Clean:
    finish(folder)
    _MEMO.update(Store(folder).read_memo())
    run = Run(load_robot("ups3_s", QUICK), Store(folder), _code=Code(memo=_memo()))
    values = dict(zip(all_stages(), run.until(*all_stages()), strict=True))
    return Clean(folder, {name: content(encode(value)) for name, value in values.items()}, values)


def whole(store: Path) -> set[str]:
    """The stages whose artifacts there are sealed, and their payload what was sealed."""
    found = set()
    for manifest in (store / "artifacts").glob("*/*/manifest.json"):
        entry = entry_of(manifest)
        if entry is not None:
            found.add(entry.folder.parent.name)
    return found


def entry_of(manifest: Path) -> Entry | None:
    import json

    from kincal.pipeline.store.manifest import Damaged

    try:
        key = json.loads(manifest.read_bytes())["key"]
        store = Store(manifest.parents[3])
        entry = store.find(manifest.parent.parent.name, key)
        if entry is not None:
            store.files(entry)
        return entry
    except (Damaged, ValueError, KeyError, OSError):
        return None
