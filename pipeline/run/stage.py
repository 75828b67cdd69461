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
from kincal.version import __version__


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
    def place(self) -> tuple[str, str]:
        """The function's module and name."""
        return self.function.__module__, self.function.__name__

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


def stage_of(name: str, function: Callable[..., Any], libraries: tuple[str, ...]) -> Stage:
    """A function of the stages' results, of settings, and of bundles of both."""
    producer = {f.__annotations__["return"]: stage for stage, (f, _) in STAGES.items()}  # in running order
    kinds: dict[str, str] = {}
    bundles: dict[str, type[Bundle]] = {}
    for argument, parameter in inspect.signature(function).parameters.items():
        bundle = function.__globals__.get(parameter.annotation)
        if isinstance(bundle, type) and issubclass(bundle, Bundle):
            bundles[argument] = bundle
            kinds |= _kinds_of(bundle)
        else:
            kinds[argument] = parameter.annotation
    arguments = {kind: argument for argument, kind in kinds.items()}
    inputs = {arguments[kind]: stage for kind, stage in producer.items() if kind in arguments}
    settings = tuple(argument for argument in kinds if argument not in inputs)
    return Stage(name, function, inputs, settings, libraries, bundles)


def _kinds_of(bundle: type[Bundle]) -> dict[str, str]:
    """{field: its annotation}"""
    return {field.name: str(field.type) for field in fields(bundle)}


@lru_cache(maxsize=1)
def all_stages() -> dict[str, Stage]:
    return {name: stage_of(name, *of_stage) for name, of_stage in STAGES.items()}


@lru_cache
def version(library: str) -> str:
    """Of an installed library. Its metadata are long: parsing them all takes longer than the rest of a cached run."""
    if library == "kincal":  # a checkout is newer than what was installed of it
        return __version__
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
