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

_SHOWN = 12  # parameters, for people


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
        return self.changes.p_value < 1e-4

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
        from kincal.pipeline.report.numbers import significant

        found, names = self.changes, [self.changes.names[k] for k in self.changes.likely]
        size = f"chi-square {significant(found.chi_square)} over {found.freedom} degrees of freedom"
        if not self.changed:
            return [f"From {self.before} to {self.after}: no significant change ({size}, p = {found.p_value:.2g})."]
        lines = [f"From {self.before} to {self.after}: the robot changed ({size}, p = {found.p_value:.2g})."]
        if names:
            alike = "one of these alone, which the measurements cannot tell apart" if len(names) > 1 else "alone"
            lines.append(f"Best explained by a change of {', '.join(names)} ({alike}).")
        else:
            lines.append("No change of a single parameter explains it.")
        return lines

    def shown(self) -> Table:
        """The parameters that explain most, each as if it alone had changed."""
        import numpy as np

        from kincal.identification.identification import HUMAN
        from kincal.pipeline.report.numbers import fixed
        from kincal.pipeline.report.parameters import decimals
        from kincal.pipeline.report.tables import Table

        found, rows = self.changes, []
        for k in np.argsort(-np.abs(found.sigmas), kind="stable")[:_SHOWN]:
            if abs(found.sigmas[k]) < found.limit:
                break
            unit, factor = HUMAN[found.units[k]]
            digits = decimals(found.std[k] * factor)
            cells = (fixed(found.change[k] * factor, digits), fixed(found.std[k] * factor, digits))
            rows.append((found.names[k], unit, *cells, fixed(found.sigmas[k], 1)))
        return Table(("parameter, if it alone changed", "unit", "change", "sigma", "in sigmas"), tuple(rows))

    def to_dict(self) -> dict[str, Any]:
        """A document for JSON, in SI units and radians."""
        import numpy as np

        table = self.table.replace([np.inf, -np.inf], np.nan).reset_index()
        rows = [{k: None if v != v else v for k, v in row.items()} for row in table.to_dict(orient="records")]
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
