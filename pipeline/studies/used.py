"""What a study of many jobs has used, noted down in the store so that it is kept, and told in what it made."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from kincal.pipeline.run.fan_out import Failure, Outcome, Task
from kincal.pipeline.run.provenance import versions
from kincal.pipeline.run.runner import Run
from kincal.pipeline.run.stage import all_stages
from kincal.pipeline.store.digests import digest


@dataclass
class Used:
    """To be called as `run_all` observes: hears which artifacts the jobs go through, and tells `observe`."""

    observe: Callable[[Task, Outcome | Failure | None], None]
    digests: dict[tuple[str, str], str] = field(default_factory=dict)  # {(stage, key): of its content}

    def __call__(self, task: Task, outcome: Outcome | Failure | None) -> None:
        if isinstance(outcome, Outcome):
            self.digests |= {(p.stage, p.key): p.digest for p in outcome.passed}
        self.observe(task, outcome)

    def finish(self, session: Run, study: str, made: Path, more: Iterable[tuple[str, str]] = ()) -> None:
        """Note down what `made` was made of: `gc` keeps that while `made` is there."""
        used = {*self.digests, *more}
        session.store.describe(session.robot_id, session.robot.stands_in)
        session.store.finish(session.robot_id, study, made, used, session.command)

    def provenance(self) -> dict[str, Any]:
        """Of the study's files: the same jobs give the same bytes, whatever the command was. Seeds stand in rows.

        inputs: the content digest of what a stage made, or the digest of the list of these, where the jobs differ.
        """
        known, stages = all_stages(), {stage for stage, _ in self.digests}
        inputs = {s: sorted({d for (stage, _), d in self.digests.items() if stage == s}) for s in sorted(stages)}
        return {
            "versions": versions(libraries=[name for s in stages if s in known for name in known[s].libraries]),
            "inputs": {
                stage: digests[0] if len(digests) == 1 else digest(digests) for stage, digests in inputs.items()
            },
        }
