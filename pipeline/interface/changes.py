"""What changed between two campaigns of one robot."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd

    from kincal.identification.changes import Changes
    from kincal.pipeline.interface.fit import Fit
    from kincal.pipeline.report.tables import Table


@dataclass(frozen=True, repr=False)
class CampaignChanges:
    """From a first to a second campaign of one robot, as `Calibration.changes_since` returns it.

    Attributes
    ----------
    before, after
        The names of the two robots.
    changes
        The full result, with its arrays.

    Examples
    --------
    >>> import kincal
    >>> kincal.CampaignChanges.__name__
    'CampaignChanges'
    """

    before: str
    after: str
    changes: Changes

    @property
    def changed(self) -> bool:
        """Whether the robot changed: less than one robot in 10,000 shows as much by chance."""
        from kincal.pipeline.report.changes import CHANCE

        return self.changes.p_value < CHANCE

    @cached_property
    def table(self) -> pd.DataFrame:
        """One row a parameter: its change if it alone changed, one sigma of that, and the change in sigmas."""
        import pandas as pd

        found = self.changes
        columns = {"unit": found.units, "change": found.change, "std": found.std, "sigmas": found.sigmas}
        return pd.DataFrame(columns, index=pd.Index(found.names, name="name"))

    @property
    def lines(self) -> list[str]:
        """For people, a sentence each."""
        from kincal.pipeline.report.changes import change_lines

        return change_lines(self.changes, self.before, self.after)

    def shown(self) -> Table:
        """The parameters that explain most, each as if it alone had changed."""
        from kincal.pipeline.report.changes import change_table

        return change_table(self.changes)

    def to_dict(self) -> dict[str, Any]:
        """A document for JSON, in SI units and radians."""
        found = self.changes
        values = zip(found.names, found.units, found.change.tolist(), found.std.tolist(), strict=True)
        rows = [
            {"name": name, "unit": unit, "change": change}
            | {"std": std if std < float("inf") else None, "sigmas": change / std}
            for name, unit, change, std in values
        ]
        return {
            "before": self.before,
            "after": self.after,
            "changed": self.changed,
            "chi_square": self.changes.chi_square,
            "degrees_of_freedom": self.changes.freedom,
            "p_value": self.changes.p_value,
            "likely": [self.changes.names[k] for k in self.changes.likely],
            "parameters": rows,
        }

    def __repr__(self) -> str:
        return f"CampaignChanges({self.before!r}, {self.after!r}, changed={self.changed})"


def changes_between(before: Fit, after: Fit) -> CampaignChanges | None:
    """Of two fits; None where they are of different designs."""
    from kincal.identification.changes import changes, same_drawing

    one, other = before.identification, after.identification
    if not same_drawing(one, other):
        return None
    names = before.robot.description.name, after.robot.description.name
    if names[0] == names[1]:
        names = before.robot.reference, after.robot.reference
    return CampaignChanges(*names, changes(one, other))
