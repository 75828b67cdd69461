"""Stages as data: what a stage function needs and makes, read from its signature."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import metadata
from typing import Any

from kincal.pipeline.stages.registry import STAGES
from kincal.urdf.errors import InputError


@dataclass(frozen=True)
class Stage:
    """A stage function with what its signature says: inputs are other stages' results, the rest are settings."""

    name: str
    function: Callable[..., Any]
    inputs: Mapping[str, str]  # {parameter: stage}
    settings: tuple[str, ...]
    libraries: tuple[str, ...]

    @property
    def result(self) -> type:
        return self.function.__globals__[self.function.__annotations__["return"]]


def stage_of(function: Callable[..., Any], libraries: tuple[str, ...]) -> Stage:
    """A function of the stages' results and of settings."""
    producer = {f.__annotations__["return"]: f.__name__ for f in STAGES}
    kinds = {name: p.annotation for name, p in inspect.signature(function).parameters.items()}
    inputs = {name: producer[kind] for name, kind in kinds.items() if kind in producer}
    settings = tuple(name for name in kinds if name not in inputs)
    return Stage(function.__name__, function, inputs, settings, libraries)


@lru_cache(maxsize=1)
def all_stages() -> dict[str, Stage]:
    return {function.__name__: stage_of(function, libraries) for function, libraries in STAGES.items()}


@lru_cache
def version(library: str) -> str:
    """Of an installed library. Its metadata are long: parsing them all takes longer than the rest of a cached run."""
    text = metadata.distribution(library).read_text("METADATA") or ""
    found = next((line for line in text.splitlines() if line.startswith("Version:")), None)
    return found.partition(":")[2].strip() if found else metadata.version(library)


def needed(until: str) -> list[Stage]:
    """The stages that `until` rests on, itself included, in running order."""
    known = all_stages()
    if until not in known:
        raise InputError(f"stage {until!r} does not exist; allowed: {', '.join(known)}")
    wanted = {until}
    for name in reversed(list(known)):
        if name in wanted:
            wanted |= set(known[name].inputs.values())
    return [stage for name, stage in known.items() if name in wanted]
