"""The JSON Schema of robot.toml: editors check and complete a file that begins with a `#:schema` line."""

from __future__ import annotations

from typing import Any

from kincal.urdf.column_templates import TEMPLATES
from kincal.urdf.description import RobotDescription

ID = "kincal-robot-1"
FILE = "robot.schema.json"  # that the `#:schema` line of `kincal init` names


def robot_schema() -> dict[str, Any]:
    """A JSON Schema (draft 2020-12). Checks across fields, such as names of joints, are left to kincal itself."""
    schema = RobotDescription.model_json_schema(by_alias=True)
    measure = schema["$defs"]["Measure"]["properties"]
    columns = measure["columns"]
    of_table = columns["additionalProperties"]
    columns["additionalProperties"] = {"anyOf": [{"type": "string"}, of_table]}  # the short form: a name alone
    measure["columns"] = {"anyOf": [{"enum": list(TEMPLATES)}, columns]}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": ID,
        "title": "robot.toml of kincal",
        **{key: value for key, value in schema.items() if key != "title"},
    }
