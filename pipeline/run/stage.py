"""Stages as data: what a stage function needs and makes, read from its signature."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from functools import lru_cache
from importlib import metadata
from typing import Any

from kincal.pipeline.results import Bundle
from kincal.pipeline.stages.registry import STAGES
from kincal.urdf.errors import UnknownNameError


@dataclass(frozen=True)
class Stage:
    """A stage function with what its signature says: inputs are other stages' results, the rest are settings."""

    name: str
    function: Callable[..., Any]
    inputs: Mapping[str, str]  # {parameter, or field of a bundle: stage}
    settings: tuple[str, ...]
    libraries: tuple[str, ...]
    bundles: Mapping[str, type[Bundle]]  # {parameter: inputs and settings that come together}

    @property
    def result(self) -> type:
        return self.function.__globals__[self.function.__annotations__["return"]]

    def call(self, values: Mapping[str, Any]) -> Any:
        """The result; values: of all inputs and settings, by name."""
        given: dict[str, Any] = {}
        for name in inspect.signature(self.function).parameters:
            bundle = self.bundles.get(name)
            if bundle is None:
                given[name] = values[name]
            else:
                given[name] = bundle(**{field: values[field] for field in _kinds_of(bundle)})
        return self.function(**given)


def stage_of(function: Callable[..., Any], libraries: tuple[str, ...]) -> Stage:
    """A function of the stages' results, of settings, and of bundles of both."""
    producer = {f.__annotations__["return"]: f.__name__ for f in STAGES}  # in running order
    kinds: dict[str, str] = {}
    bundles: dict[str, type[Bundle]] = {}
    for name, parameter in inspect.signature(function).parameters.items():
        bundle = function.__globals__.get(parameter.annotation)
        if isinstance(bundle, type) and issubclass(bundle, Bundle):
            bundles[name] = bundle
            kinds |= _kinds_of(bundle)
        else:
            kinds[name] = parameter.annotation
    names = {kind: name for name, kind in kinds.items()}
    inputs = {names[kind]: stage for kind, stage in producer.items() if kind in names}
    settings = tuple(name for name in kinds if name not in inputs)
    return Stage(function.__name__, function, inputs, settings, libraries, bundles)


def _kinds_of(bundle: type[Bundle]) -> dict[str, str]:
    """{field: its annotation}"""
    return {field.name: str(field.type) for field in fields(bundle)}


@lru_cache(maxsize=1)
def all_stages() -> dict[str, Stage]:
    return {function.__name__: stage_of(function, libraries) for function, libraries in STAGES.items()}


@lru_cache
def version(library: str) -> str:
    """Of an installed library. Its metadata are long: parsing them all takes longer than the rest of a cached run."""
    text = metadata.distribution(library).read_text("METADATA") or ""
    line_of_version = next((line for line in text.splitlines() if line.startswith("Version:")), None)
    return line_of_version.partition(":")[2].strip() if line_of_version else metadata.version(library)


def needed(until: str) -> list[Stage]:
    """The stages that `until` rests on, itself included, in running order."""
    known = all_stages()
    if until not in known:
        raise UnknownNameError(f"stage {until!r} does not exist; allowed: {', '.join(known)}", until, known)
    wanted = {until}
    for name in reversed(list(known)):
        if name in wanted:
            wanted |= set(known[name].inputs.values())
    return [stage for name, stage in known.items() if name in wanted]
