"""What kincal recognises in a table before anybody calibrates with it."""

from __future__ import annotations

from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kincal.pipeline.interface.robots import RobotLike, Settings, overrides_of, robot_of
from kincal.urdf.description import Measure, parse_override, validate
from kincal.urdf.errors import InputError

if TYPE_CHECKING:
    from kincal.identification.column_report import TableReport


def recognise(file: str | PathLike[str], robot: RobotLike | None = None, settings: Settings = ()) -> TableReport:
    """Say how a table is written, and what each column is taken for, as `kincal columns` prints it.

    Parameters
    ----------
    file
        A measurement table, or an export of motion capture.
    robot
        Whose table it is: its joints and its `[measure]` are used.
    settings
        As of `load`; without a robot, those of `measure` alone.

    Returns
    -------
    TableReport
        `facts` on the file, `columns` with their ranges, and the `column_map` that reads them.

    Raises
    ------
    InputError
        The file can't be read, or a setting is not allowed.

    Examples
    --------
    >>> import kincal
    >>> from kincal.pipeline.interface.columns import recognise
    >>> recognise("no_such_table.csv")
    Traceback (most recent call last):
    kincal.urdf.errors.InputError: no_such_table.csv: can't be read: No such file or directory
    """
    from kincal.identification.column_report import table_report

    if robot is None:
        return table_report(Path(file), _measure(settings), ())
    description = robot_of(robot, settings).description
    return table_report(Path(file), description.measure, description.actuated)


def map_as_toml(report: TableReport) -> str:
    """The column map of a report as `[measure.columns]`; comments name what is missing and what is not used."""
    import tomlkit

    document = tomlkit.document()
    columns = tomlkit.table()
    for name, column in report.column_map.items():
        if column.unit == "1":
            columns[name] = column.source
            continue
        entry = tomlkit.inline_table()
        entry["from"], entry["unit"] = column.source, column.unit
        columns[name] = entry
    for joint in report.missing:
        columns.add(tomlkit.comment(f'{joint} = "": no column of the table has this name'))
    mapped = {column.source for column in report.column_map.values()}
    for column in report.columns:
        if column.name not in mapped and not report.is_export:
            columns.add(tomlkit.comment(f"not used: {column.name.encode('unicode_escape').decode()}"))
    measure = tomlkit.table(is_super_table=True)
    measure["columns"] = columns
    document["measure"] = measure
    return tomlkit.dumps(document)


def write_map(report: TableReport, output: str | PathLike[str], force: bool = False) -> Path:
    """Write the column map to a file. Raises InputError, also where the file exists without `force`."""
    from kincal.pipeline.store.files import refusing, replace_file

    file = Path(output)
    if file.exists() and not force:
        raise InputError(f"--output {file}: exists already; give another name, or --force")
    with refusing(f"--output {file}"):
        replace_file(file, map_as_toml(report).encode())
    return file


def _measure(settings: Settings) -> Measure:
    content: dict[str, Any] = {"table": "-"}
    for text in overrides_of(settings):
        setting = parse_override(text)
        if len(setting.keys) != 2 or setting.keys[0] != "measure":
            raise InputError(f"{setting.said}: without a robot, allowed are settings of measure, such as measure.body")
        content[setting.keys[1]] = setting.value
    return validate(Measure, content, "--set")
