"""Pass or fail: the recommended method's errors at held-out poses against the limits of robot.toml."""

from __future__ import annotations

from dataclasses import dataclass

from kincal.pipeline.report.numbers import significant
from kincal.pipeline.results import Comparison, MethodScore
from kincal.urdf.description import Limits
from kincal.urdf.errors import InputError


@dataclass(frozen=True)
class Check:
    """One limit."""

    name: str  # mean_mm, max_mm, mean_deg or max_deg
    error: float
    limit: float

    @property
    def passed(self) -> bool:
        """Whether the error is within the limit."""
        return self.error <= self.limit

    def __str__(self) -> str:
        index, _, unit = self.name.partition("_")
        word = "within" if self.passed else "above"
        return f"{index} {significant(self.error)} {unit} is {word} the limit of {self.limit:g} {unit}"


@dataclass(frozen=True)
class Verdict:
    """Whether a calibration meets its limits."""

    method: str
    poses: str  # how many were scored, and which
    checks: tuple[Check, ...]
    virtual: bool  # simulated, not measured

    @property
    def passed(self) -> bool:
        """Whether every error is within its limit."""
        return all(check.passed for check in self.checks)

    @property
    def line(self) -> str:
        """One sentence for people; failed checks first."""
        checks = sorted(self.checks, key=lambda c: c.passed)
        word = f"{'PASS' if self.passed else 'FAIL'}{' (virtual robot)' * self.virtual}"
        return f"{word}: {self.method}, {self.poses}: {'; '.join(map(str, checks))}"


def verdict(limits: Limits, compared: Comparison, method: str) -> Verdict | None:
    """Of the recommended method; None where no limit is given. Raises InputError for a limit of no measured channel.

    Errors are those of held-out poses as measured, or of the poses that `evaluate` was given.
    """
    if not limits.given:
        return None
    scores, poses = compared.held_out, f"{compared.n_held_out} held-out poses as measured"
    if not scores:
        which = "poses in cross-validation" if compared.scored_on == "held_out" else f"poses of {compared.scored_on}"
        scores, poses = compared.methods, f"{compared.n_scored} {which}"
    score = next(s for s in scores if s.name == method)
    checks = tuple(_check(name, limit, score, compared) for name, limit in limits.given.items())
    return Verdict(method, poses, checks, compared.source == "virtual")


def _check(name: str, limit: float, score: MethodScore, compared: Comparison) -> Check:
    error = getattr(score, name)
    if error is None:
        measured = ", ".join(compared.channels)
        raise InputError(
            f"{compared.robot}: limits.{name} cannot be checked: {measured} were measured. "
            f"Delete limits.{name}, or measure {'positions' if name.endswith('mm') else 'orientations'}"
        )
    return Check(name, float(error), limit)
