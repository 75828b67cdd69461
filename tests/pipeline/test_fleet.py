"""Several robots at once: fleet files, the fleet's table, and which unit is out of family."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from kincal.identification.family import FALSE_ALARM, memberships
from kincal.pipeline.methods.predictors import METHODS
from kincal.pipeline.run.runner import Run
from kincal.urdf.errors import InputError
from kincal.urdf.fleet import load, references

# The file


def fleet_file(folder: Path, text: str) -> Path:
    file = folder / "fleet.toml"
    file.write_text(text)
    return file


def test_a_short_form(tmp_path):
    file = fleet_file(tmp_path, 'design = "ups3_s"\nunits = 12\n')
    assert [r.rpartition(":")[2] for r in references(file)] == [f"unit_{k:02d}" for k in range(12)]
    robot = load(f"{file}:unit_07")
    assert (robot.description.name, robot.description.measure.seed, robot.description.seed) == ("unit_07", 7, 0)


def test_what_a_unit_sets_goes_over_the_fleet_and_the_design(tmp_path, robot_folder, monkeypatch):
    (tmp_path / "a.csv").touch()
    file = fleet_file(
        tmp_path,
        """
        design = "robot"
        [set]
        "plan.poses" = 12
        pretrain = { iterations = 15, continued = 3 }
        measure.seed = 8
        [[unit]]
        name = "virtual"
        seed = 3 # over the fleet's
        [[unit]]
        name = "measured"
        set = { plan.poses = 13, "measure.table" = "a.csv" }
        """,
    )
    virtual, measured = (load(f"{file}:{name}") for name in ("virtual", "measured"))
    assert virtual.file == measured.file == robot_folder / "robot.toml"
    assert (virtual.description.plan.poses, measured.description.plan.poses) == (12, 13)
    assert virtual.description.pretrain.iterations == 15
    assert virtual.description.pretrain.hidden == 16  # robot.toml's other keys stay
    assert virtual.description.measure.seed == 3
    assert measured.description.measure.table == tmp_path / "a.csv"
    assert measured.description.measure.seed == 8
    assert (virtual.description.measure.virtual, measured.description.measure.virtual) == (True, False)
    assert load(f"{file}:measured", ["plan.poses=14"]).description.plan.poses == 14
    ids = {Run(robot, None).robot_id for robot in (virtual, measured, load(str(robot_folder)))}
    assert len(ids) == 3
    monkeypatch.chdir(tmp_path)
    assert Run(load("fleet.toml:virtual"), None).robot_id in ids


UNIT = '\n[[unit]]\nname = "a"\n'


@pytest.mark.parametrize(
    "text, said",
    [
        ("units = 3", "design: required"),
        ('desing = "ups3_s"\nunits = 3', "desing: unknown key; did you mean 'design'?"),
        ('design = "ups3_s"', "give units = N"),
        (f'design = "ups3_s"\nunits = 3{UNIT}', "give units = N"),
        ('design = "ups3_s"\nunits = 0', "units: found 0"),
        ('design = "ups3_s"\nunits = 100000', "units: found 100000"),
        (f'design = "ups3_s"{UNIT}{UNIT}', "'a' appears twice"),
        (f'design = "ups3_s"{UNIT}sead = 3', "unit.0.sead: unknown key; did you mean 'seed'?"),
        (f'design = "ups3_s"{UNIT}seed = -3', "unit.0.seed: found -3"),
        ('design = "ups3_s"\n[[unit]]\nname = "../a"', "unit.0.name: found '../a'"),
        (f'design = "ups3"{UNIT}', "design: robot 'ups3': neither a file nor a shipped robot"),
        (f'design = "ups3_s"{UNIT}set = {{ "plan.pozes" = 3 }}', "unit a: set: plan.pozes: unknown key; did you mean"),
        (f'design = "ups3_s"{UNIT}set = {{ plan = 3 }}', "unit a: set: plan: found 3"),
        (f'design = "ups3_s"{UNIT}set = {{ name = "b" }}', "unit a: set: name: "),
        (f'design = "ups3_s"{UNIT}[set]\nplan.poses = "x"', "fleet.toml: set: plan.poses: found 'x'"),
        (f'design = "ups3_s"{UNIT}[set]\n{".".join(500 * "a")} = 1', "a key of more than 100 parts"),
        ('design = "ups3_s"\nunits =', "not valid TOML"),
    ],
)
def test_what_a_fleet_file_refuses(tmp_path, text, said):
    file = fleet_file(tmp_path, text)
    with pytest.raises(InputError, match=f"^{file}: ") as refused:
        load(f"{file}:a")
    assert said in str(refused.value)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "arguments, said",
    [
        ((), "name one or more, or --all"),
        (("--from", "fleet.toml"), "goes with --all"),
        (("ups3_s", "--all"), "allowed is either"),
        (("ups3_s", "rps3", "ups3_s"), "'ups3_s' appears twice"),
        (("--all", "--from", "."), "neither a fleet file nor a folder"),
        (("ups3_s", "rps"), "did you mean 'rps3'?"),
        (("{a=" * 300 + ":b",), "neither a file nor a shipped robot"),
        (("fleet.toml:b",), "fleet.toml: no unit 'b'; allowed: a"),
        (("--all", "--from", "a" * 5000), "File name too long"),
        (("--all", "--from", "fleet.toml", "--store", "a" * 5000), "File name too long"),
        (("fleet.toml",), "a fleet, not a robot: --all --from fleet.toml"),
        (("--all", "--from", "fleet.toml", "--until", "mesure"), "'mesure' does not exist"),
        (("--all", "--from", "fleet.toml", "--force-from", "plan"), "--force-from: allowed with one robot"),
        (("--all", "--from", "fleet.toml", "--set", "plan.poses=x"), "--set plan.poses=x: plan.poses: found 'x'"),
    ],
)
def test_what_the_command_refuses(cli, tmp_path, arguments, said):
    fleet_file(tmp_path, f'design = "ups3_s"{UNIT}')
    answer = cli("run", *arguments)
    assert answer.status == 2
    assert said in answer.err
    assert answer.err.count("\n") == 1, answer.err
    assert not (tmp_path / ".kincal" / "artifacts").exists()


def test_a_folder_of_robots(cli, tmp_path, robot_folder):
    (robot_folder.parent / "fleet").mkdir()
    robot_folder.rename(tmp_path / "fleet" / "one")
    answer = cli("run", "--all", "--from", "fleet", "--until", "model")
    assert answer.status == 0, answer.err
    assert answer.out.splitlines()[1].split() == ["ups3_s", "ran"]
    assert cli("status", "fleet/one").out.splitlines()[1].split() == ["model", "fresh"]


def test_a_robot_of_a_folder_that_can_not_be_read_is_a_row(cli, tmp_path, robot_folder):
    (tmp_path / "fleet" / "two").mkdir(parents=True)
    robot_folder.rename(tmp_path / "fleet" / "one")
    (tmp_path / "fleet" / "two" / "robot.toml").symlink_to("robot.toml")  # for root, too
    answer = cli("run", "--all", "--from", "fleet", "--until", "model")
    assert (answer.status, len(answer.out.splitlines())) == (1, 3)
    assert "1 of 2 robots failed" in answer.err


# Which unit is out of family


def identified(n: int, seed: int, wild: float = 1.0, shift: float = 0.0) -> list[SimpleNamespace]:
    """Units of a design with 30 parameters, of which 40 readings see 12 well; the first one's errors times `wild`.

    Estimates and covariances are those of a linear Gaussian problem, from the textbook's formula.
    """
    random = np.random.default_rng(seed)
    tolerance = random.uniform(1e-4, 1e-3, 30)
    rows = random.normal(size=(40, 12)) @ random.normal(size=(12, 30)) / tolerance
    covariance = np.linalg.inv(rows.T @ rows + np.diag(tolerance**-2))
    names = tuple(f"p{k}" for k in range(30))
    units = []
    for k in range(n):
        true = tolerance * (shift + (wild if k == 0 else 1.0) * random.normal(size=30))
        change = covariance @ rows.T @ (rows @ true + random.normal(size=40))
        units.append(SimpleNamespace(names=names, tolerance=tolerance, change=change, covariance=covariance))
    return units


@pytest.mark.parametrize("n, shift", [(5, 0.0), (24, 0.0), (24, 3.0)])
def test_a_fleet_of_equals_names_nobody(n, shift):
    """In 1 % of such fleets one may be named, by chance; what all share is no deviation."""
    fleets = 60
    named = sum(any(m.out_of_family for m in memberships(identified(n, seed, shift=shift))) for seed in range(fleets))
    assert named <= 3  # more in one of 300 such tests, were it 1 %
    assert FALSE_ALARM == 0.01


@pytest.mark.parametrize("n", [5, 24])
def test_a_unit_with_errors_of_five_tolerances_is_named_alone(n):
    for seed in range(10):
        found = memberships(identified(n, seed, wild=5.0))
        assert [m.out_of_family for m in found] == [True] + [False] * (n - 1)


def test_one_wrong_parameter_is_named():
    units = identified(24, 0)
    units[3].change = units[3].change.copy()
    clean = memberships(units)[3]
    seen = np.argmax(1 - np.diagonal(units[3].covariance) / units[3].tolerance ** 2)
    units[3].change[seen] += 8 * units[3].tolerance[seen]
    found = memberships(units)[3]
    assert (clean.out_of_family, found.out_of_family) == (False, True)
    assert found.parameter == f"p{seen}"
    assert found.deviation > 5


def test_spread_is_one_where_errors_are_as_tolerated():
    assert np.mean([m.spread**2 for m in memberships(identified(200, 1))]) == pytest.approx(1, abs=0.06)


def test_few_units_are_no_family():
    assert {m.out_of_family for m in memberships(identified(4, 0, wild=9.0))} == {None}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("copies, judged", [(3, True), (4, False), (6, False)])
def test_copies_of_one_unit_are_no_family(copies, judged):
    """Where most are the same, nothing tells how far apart sisters are."""
    units = identified(6, 0)
    found = memberships([units[0]] * copies + units[copies:])
    assert {m.out_of_family is not None for m in found} == {judged}
    assert {m.distance is not None for m in found} == {judged}


# From end to end


@pytest.fixture
def fleet(cli, store, tmp_path) -> Path:
    """Four virtual units, one that was measured with errors of five tolerances, one whose table is not there."""
    wild = [f"tolerance.{key}={value}" for key, value in (("position_mm", 1.5), ("rotation_deg", 0.15))]
    wild += ["tolerance.actuator_zero_mm=1.5", "tolerance.actuator_gain=5e-3", "measure.seed=9", "plan.poses=12"]
    settings = [part for setting in wild for part in ("--set", setting)]
    assert cli("run", "ups3_s", "--until", "measure", *settings, "--store", tmp_path / "wild").status == 0
    (table,) = (tmp_path / "wild").glob("artifacts/measure/*/table0.parquet")
    pd.read_parquet(table).to_csv(tmp_path / "wild.csv", index=False)
    return fleet_file(
        tmp_path,
        'design = "ups3_s"\n[set]\nplan.poses = 12\n'
        + "".join(f'[[unit]]\nname = "unit_{k}"\nseed = {k}\n' for k in range(4))
        + '[[unit]]\nname = "wild"\nset = { measure.table = "wild.csv" }\n'
        + '[[unit]]\nname = "lost"\nset = { measure.table = "lost.csv" }\n',
    )


def test_a_fleet(cli, fleet, store, tmp_path):
    ran = cli("run", "--all", "--from", "fleet.toml", "--until", "evaluate", "--output", "out", "--store", store)
    assert ran.status == 1
    assert "kincal: 1 of 6 robots failed, the first (lost): " in ran.err
    lines = {line.split()[0]: line for line in ran.out.splitlines()}
    assert "OUT OF FAMILY" in lines["wild"]
    assert ran.out.count("OUT OF FAMILY") == 1
    assert "lost.csv" in lines["lost"]

    table = pd.read_parquet(tmp_path / "out" / "fleet.parquet")
    assert len(table) == 5 * len(METHODS) + 1
    units = table.drop_duplicates("robot").set_index("robot")
    assert list(units.index[units["out_of_family"].fillna(False)]) == ["wild"]
    assert units["error"].notna().tolist() == [False] * 5 + [True]
    made = {stage.name: len(list(stage.iterdir())) for stage in (store / "artifacts").iterdir()}
    # what the units of a design share is made once, by the finished run already, whose robot the first unit is
    assert {made[stage] for stage in ("model", "plan", "siblings")} == {1}
    assert made["pretrain"] == 2  # for virtual units, and for measured ones, which have more splits
    assert made["transfer"] == 5

    # other commands take units as robots
    unit = json.loads(cli("compare", "fleet.toml:unit_3", "--json", "--store", store).out)
    assert unit["robot"] == "unit_3"
    unit_1 = json.loads(cli("compare", "fleet.toml:unit_1", "--json", "--store", store).out)
    methods = table[table["robot"] == "unit_3"].set_index("method")
    assert [methods["mean_deg"][m["name"]] for m in unit["methods"]] == [m["mean_deg"] for m in unit["methods"]]
    assert {row["state"] for row in json.loads(cli("status", "fleet.toml:unit_3", "--json", "--store", store).out)} == {
        "fresh",
        "missing",  # the report
    }

    # again, on two workers: all is cached, and the same
    compared = cli("compare", "--all", "--from", "fleet.toml", "--on", "2", "--json", "--store", store)
    assert compared.status == 1
    assert compared.err.count("cached") >= 5
    document = json.loads(compared.out)
    assert (document["robots"], document["failed"], document["out_of_family"]) == (6, 1, ["wild"])
    assert Path(document["table"]).read_bytes() == (tmp_path / "out" / "fleet.parquet").read_bytes()

    several = cli("compare", "fleet.toml:unit_0", "fleet.toml:unit_1", "--json", "--store", store)
    assert [c["robot"] for c in json.loads(several.out)] == ["unit_0", "unit_1"]

    # each result says what it was made of, the same wherever it is told
    told, (reference,) = document["provenance"], {r for r in document["provenance"] if r.endswith(":unit_1")}
    assert told[reference]["inputs"] == json.loads(several.out)[1]["provenance"]["inputs"]
    assert told[reference] | {"command": None} == unit_1["provenance"] | {"command": None}
    assert table.attrs["provenance"][reference]["inputs"] == told[reference]["inputs"]
    assert len(told) == 5  # not the one that failed
    measured = cli("run", "--all", "--from", "fleet.toml", "--until", "measure", "--json", "--store", store)
    rows = json.loads(measured.out)["rows"]
    assert [row["state"] for row in rows] == ["cached"] * 5 + [None]
    assert "lost.csv" in rows[-1]["error"]


def test_bad_input_alone(cli, tmp_path):
    fleet_file(tmp_path, f'design = "ups3_s"\n[set]\nmeasure.table = "lost.csv"{UNIT}[[unit]]\nname = "b"\n')
    answer = cli("run", "--all", "--from", "fleet.toml", "--until", "measure")
    assert answer.status == 2
    assert "kincal: 2 of 2 robots failed, the first (a): " in answer.err
    assert "lost.csv" in answer.err
