"""The stages without a store: nothing is read from a cache and nothing is written."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from kincal.pipeline.run.memory import within_memory
from kincal.pipeline.run.runner import Event
from kincal.pipeline.run.stage import all_stages
from kincal.pipeline.run.threads import fixed_threads
from kincal.urdf.description import RobotDescription
from kincal.urdf.errors import CalibrationError


class InMemory:
    """The results of a robot's stages, each made when it is first asked for.

    given: {stage: its result}, of those that are known already.
    """

    def __init__(
        self,
        description: RobotDescription,
        given: Mapping[str, Any] | None = None,
        observe: Callable[[Event], None] = lambda event: None,
    ) -> None:
        self._description, self._observe = description, observe
        self._results = dict(given or {})

    def result(self, stage: str) -> Any:
        """Raises InputError and CalibrationError as the stages do."""
        if stage not in self._results:
            self._results[stage] = self._made(stage)
        return self._results[stage]

    def _made(self, name: str) -> Any:
        stage = all_stages()[name]
        inputs = {parameter: self.result(source) for parameter, source in stage.inputs.items()}
        settings = {setting: getattr(self._description, setting) for setting in stage.settings}
        self._observe(Event(name, "running"))
        try:
            with within_memory(name), fixed_threads(stage.libraries):
                value = stage.call(inputs | settings)
        except FloatingPointError as error:
            raise CalibrationError(f"{name}: {error}") from None
        for note in getattr(value, "warnings", ()):
            self._observe(Event(name, "noted", note))
        self._observe(Event(name, "ran"))
        return value
