"""Tables that users bring: DataFrames, files and arrays."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

from kincal.urdf.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    import pandas as pd

    from kincal.pipeline.results import Comparison
    from kincal.urdf.description import Measure

Data: TypeAlias = "pd.DataFrame | str | PathLike[str]"
Readings: TypeAlias = "pd.DataFrame | np.ndarray | str | PathLike[str]"
FRAME = "the DataFrame"  # how messages name a table that has no file


def raw_table(
    data: Data, measure: Measure, argument: str, joints: Sequence[str] = ()
) -> tuple[pd.DataFrame, Path | str]:
    """A table as it is, and how messages name it. Raises InputError; `argument` names the argument.

    A file is read as `measure` says, or as it is recognised; joints: names that its columns may have.
    """
    import pandas as pd

    from kincal.identification.table_files import check_names, load

    if isinstance(data, str | PathLike):
        return load(Path(data), measure, joints), Path(data)
    if not isinstance(data, pd.DataFrame):  # pyright: ignore[reportUnnecessaryIsInstance]
        kind = type(data).__name__
        raise InputError(
            f"{argument}: found a {kind}; allowed are a DataFrame, or the path of a CSV, Parquet or Excel file"
        )
    names = [str(name) for name in data.columns]
    check_names(FRAME, names)
    return data.set_axis(names, axis="columns"), FRAME


def raw_readings(readings: Readings, joints: Sequence[str], measure: Measure) -> tuple[pd.DataFrame, Path | str]:
    """As `raw_table`; an array (n, n_actuated) has the joints' order. Raises InputError."""
    import numpy as np
    import pandas as pd

    if not isinstance(readings, np.ndarray):
        return raw_table(readings, measure, "readings", joints)
    table = np.atleast_2d(readings)
    if table.ndim != 2 or table.shape[1] != len(joints):
        raise InputError(
            f"readings: found an array of shape {readings.shape}; "
            f"allowed is (n, {len(joints)}), one column a joint: {', '.join(joints)}"
        )
    return pd.DataFrame(table, columns=pd.Index(joints)), "the array"


def score_frame(comparison: Comparison) -> pd.DataFrame:
    """One row a method, its name the index; a number that was not measured is NaN."""
    import pandas as pd

    from kincal.pipeline.studies.rows import METHOD_NUMBERS, method_rows

    rows = method_rows(comparison)
    index = pd.Index([row["method"] for row in rows], name="method")
    columns = {name: [row.get(name) for row in rows] for name in METHOD_NUMBERS}
    return pd.DataFrame(columns, index=index, dtype=float)
