"""Column maps by instrument or program, for `[measure] columns = "NAME"`. A new one is an entry in TEMPLATES.

Each has keys of [measure]: the columns with their units and, where it takes one, the notation of orientations.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from kincal.urdf.errors import quoted


def _named(position: str, quaternion: str, unit: str = "1") -> dict[str, Any]:
    """Names with {} in place of the axis."""
    columns = {axis: {"from": position.format(axis), "unit": unit} for axis in "xyz"}
    return {"columns": columns | {f"q{axis}": {"from": quaternion.format(axis)} for axis in "xyzw"}}


TEMPLATES: Mapping[str, Mapping[str, Any]] = {
    "motive": {"columns": {}},  # an export is read as it is
    "qualisys": {"columns": {}},
    "ndi": {  # Polaris and Aurora, as NDI's programs save them
        "columns": {axis: {"from": f"T{axis}", "unit": "mm"} for axis in "xyz"}
        | {"qx": {"from": "Qx"}, "qy": {"from": "Qy"}, "qz": {"from": "Qz"}, "qw": {"from": "Q0"}}
    },
    "ros": _named("field.pose.position.{}", "field.pose.orientation.{}"),  # PoseStamped, by `rostopic echo -p`
    "tum": _named("t{}", "q{}"),  # trajectories: timestamp tx ty tz qx qy qz qw
}


def expanded(measure: Mapping[str, Any]) -> dict[str, Any]:
    """[measure] with the map of a template in place of its name. Raises ValueError for a name that is none."""
    name = measure.get("columns")
    if not isinstance(name, str):
        return dict(measure)
    if name not in TEMPLATES:
        raise ValueError(f"columns = {quoted(name)}: no such template; allowed are {', '.join(TEMPLATES)}, or a table")
    return {**TEMPLATES[name], **{key: value for key, value in measure.items() if key != "columns"}}
