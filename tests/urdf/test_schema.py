"""The JSON Schema of robot.toml against every robot.toml there is, and against mistakes, by another validator."""

import tomllib

import pytest
from jsonschema import Draft202012Validator

from kincal.urdf.column_templates import TEMPLATES
from kincal.urdf.description import ROBOTS, Measure
from kincal.urdf.schema import robot_schema
from tests.conftest import DATA

FILES = [*sorted(ROBOTS.glob("*/robot.toml")), *sorted(DATA.glob("*/robot.toml"))]


@pytest.fixture(scope="module")
def validator() -> Draft202012Validator:
    Draft202012Validator.check_schema(robot_schema())
    return Draft202012Validator(robot_schema())


@pytest.mark.parametrize("file", FILES, ids=lambda f: f.parent.name)
def test_every_robot_is_valid(validator, file):
    assert [e.message for e in validator.iter_errors(tomllib.loads(file.read_text()))] == []


@pytest.mark.parametrize(
    "path, value",
    [
        (("plan", "poses"), 0),
        (("plan", "poses"), "many"),
        (("plan", "layout"), "spiral"),
        (("tolerance", "position_mm"), -1.0),
        (("tolerances",), {}),
        (("measure", "source"), "guess"),
        (("limits", "mean_mm"), 0.0),
        (("loop",), [{"name": "a", "kind": "welded", "frames": ["a", "b"]}]),
        (("measure", "columns"), {"x": {"from": "meas_x", "unit": "furlong"}}),
        (("measure", "columns"), "sextant"),
        (("measure", "euler"), "ZZX"),
        (("measure", "skip"), ["three"]),
    ],
)
def test_mistakes_are_not(validator, path, value):
    content = tomllib.loads((ROBOTS / "ups3_s" / "robot.toml").read_text())
    table = content
    for key in path[:-1]:
        table = table.setdefault(key, {})
    table[path[-1]] = value
    assert list(validator.iter_errors(content))


def test_the_short_form_of_a_column_is_valid(validator):
    content = tomllib.loads((ROBOTS / "ups3_s" / "robot.toml").read_text())
    content["measure"]["columns"] = {"roll": "Roll", "pitch": {"from": "Pitch", "unit": "deg"}}
    assert not list(validator.iter_errors(content))


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_template_is_valid_and_is_a_column_map(validator, name):
    content = tomllib.loads((ROBOTS / "ups3_s" / "robot.toml").read_text())
    content["measure"] = {"table": "t.csv", "columns": name, "skip": [3], "euler": "zyx"}
    assert not list(validator.iter_errors(content))
    assert set(Measure.model_validate(content["measure"]).columns) <= {*"xyz", "qx", "qy", "qz", "qw"}
