"""`kincal status`: which stages are fresh, which are stale, and what made them so."""

import json

import pytest

from kincal.pipeline.run.changes import explain
from kincal.pipeline.run.stage import all_stages, needed
from kincal.urdf.errors import InputError


def rows(run) -> dict[str, tuple[str, str]]:
    return {stage: (state, why) for stage, state, why in run.status()}


def test_missing_before_the_first_run(start, tmp_path, stage_names):
    found = rows(start(tmp_path / "store")[0])
    assert tuple(found) == stage_names
    assert {state for state, _ in found.values()} == {"missing"}
    assert found["model"] == ("missing", "never ran for this robot")


def test_fresh_after_a_run(start, finished, store):
    assert set(rows(start(store, *finished.settings)[0]).values()) == {("fresh", "")}


def test_half_a_run(start, tmp_path):
    run, _ = start(tmp_path / "store", "plan.poses=12")
    run.until("plan")
    states = {stage: state for stage, (state, _) in rows(start(tmp_path / "store", "plan.poses=12")[0]).items()}
    assert (states["model"], states["plan"], states["measure"]) == ("fresh", "fresh", "missing")


@pytest.mark.parametrize(
    "setting, why",
    [
        ("plan.poses=13", "setting plan.poses 12 -> 13"),
        ("sensor.orientation_deg=0.001", "setting sensor.orientation_deg 0.0006 -> 0.001"),
        ("measure.errors.elastic=false", "setting measure.errors.elastic True -> False"),
        ("split.test=0.25", "setting split.test 0.2 -> 0.25"),
        ("evaluate.fresh_poses=600", "setting evaluate.fresh_poses 500 -> 600"),
        ("workspace.max_condition=99", "setting mechanism.workspace.max_condition 100.0 -> 99.0"),
    ],
)
def test_a_setting_is_named(start, store, setting, why):
    """By the stages that it belongs to; what rests on them is stale, all else is fresh."""
    found = rows(start(store, "plan.poses=12", setting)[0])
    table = why.split()[1].partition(".")[0]
    own = {name for name, stage in all_stages().items() if table in stage.settings}
    assert found[next(name for name in found if name in own)] == ("stale", why)
    for name, (state, _) in found.items():
        assert state == ("stale" if own & {stage.name for stage in needed(name)} else "fresh"), name


def test_a_changed_file_is_named(start, store, robot_folder):
    run, _ = start(store, "plan.poses=12", robot=robot_folder)
    run.until("report")
    urdf = robot_folder / "robot.urdf"
    urdf.write_text(urdf.read_text() + "<!-- moved -->\n")
    assert rows(start(store, "plan.poses=12", robot=robot_folder)[0])["model"] == ("stale", "file urdf changed")


def test_a_changed_table_is_named(start, store, finished, tmp_path):
    table = tmp_path / "table.csv"
    finished.table.to_csv(table, index=False)
    settings = ("plan.poses=12", "measure.source=files", f"measure.table={table}")
    start(store, *settings)[0].until("measure")
    assert rows(start(store, *settings)[0])["measure"] == ("fresh", "")
    finished.table.head(11).to_csv(table, index=False)
    assert rows(start(store, *settings)[0])["measure"] == ("stale", "file measure.table changed")


def test_a_table_that_changes_while_it_is_read_is_refused(start, store, finished, tmp_path):
    """Its key would be that of the file as it was."""
    table = tmp_path / "table.csv"
    finished.table.to_csv(table, index=False)
    before = set((store / "artifacts" / "measure").iterdir())
    run, _ = start(store, "plan.poses=12", "measure.source=files", f"measure.table={table}")

    def replace(event):
        if (event.stage, event.state) == ("measure", "running"):
            finished.table.head(11).to_csv(table, index=False)

    run.observe = replace
    with pytest.raises(InputError, match=r"measure: file measure\.table changed while it ran; nothing was stored"):
        run.until("measure")
    assert set((store / "artifacts" / "measure").iterdir()) == before
    (measured,) = run.until("measure")  # the file as it is now
    assert len(measured.table) == 11


def test_changed_code_is_named(kincal, start, store, tmp_path, copy_project):
    """With the project's packages copied, and a helper three imports away changed."""
    root = copy_project(tmp_path / "project")
    robot = root / "kincal" / "urdf" / "robots" / "ups3_s"
    start(store, "plan.poses=12", robot=robot)[0].until("report")
    file = root / "kincal" / "urdf" / "rigid_motion.py"
    file.write_text(file.read_text() + "\n_CHANGED = 1\n")
    answer = kincal("status", robot, "--set", "plan.poses=12", "--store", store, "--json", root=root)
    assert answer.status == 0, answer.err
    assert json.loads(answer.out)[0] == {
        "stage": "model",
        "state": "stale",
        "why": "code kincal.urdf.rigid_motion changed",
    }


def test_what_people_see_may_change_without_another_identification(kincal, tmp_path, copy_project, finished):
    """A page's template, a command and the interface are edited: nothing but the report runs again."""
    root = copy_project(tmp_path / "project")
    robot = root / "kincal" / "urdf" / "robots" / "ups3_s"
    flags = [part for text in finished.settings for part in ("--set", text)]
    assert kincal("run", robot, *flags, root=root).status == 0
    package = root / "kincal" / "pipeline"
    for file, text in (
        (package / "report" / "templates" / "page.html", "<!-- another line -->"),
        (package / "commands" / "calibration.py", "\n_CHANGED = 1\n"),
        (package / "interface" / "calibration.py", "\n_CHANGED = 1\n"),
        (root / "kincal" / "__init__.pyi", "\nfrom .version import __version__\n"),
    ):
        file.write_text(file.read_text() + text)
    rows = json.loads(kincal("status", robot, *flags, "--json", root=root).out)
    assert {row["stage"]: row["state"] for row in rows if row["state"] != "fresh"} == {"report": "stale"}
    again = kincal("run", robot, *flags, root=root)
    assert again.status == 0, again.err
    assert [line.split()[1] for line in again.err.splitlines() if " ran " in line] == ["report"]


def test_status_changes_nothing(start, store):
    before = {f: f.stat().st_mtime_ns for f in store.rglob("*")}
    rows(start(store, "plan.poses=13")[0])
    assert {f: f.stat().st_mtime_ns for f in store.rglob("*")} == before


@pytest.mark.parametrize("damage", [b"", b"{}", None])
def test_status_of_a_damaged_store(start, store, damage):
    """Says that the artifact is gone or damaged, and leaves it where it is for the next run to set aside."""
    (file,) = (store / "artifacts").glob("evaluate/*/manifest.json")
    if damage is None:
        file.unlink()
    else:
        file.write_bytes(damage)
    found = rows(start(store, "plan.poses=12")[0])
    assert found["identify"][0] == "fresh"
    assert found["evaluate"][0] in ("stale", "missing")
    assert "damaged" in found["evaluate"][1]
    assert file.parent.exists()


# The reason, from two manifests' parts

PARTS = {
    "settings": {"plan": {"poses": 150, "layout": None}, "seed": 0},
    "files": {"urdf": "aa"},
    "inputs": {"model": "bb"},
    "code": {"kincal.pipeline.stages.registry:plan": "cc", "kincal.urdf.kinematics": "dd"},
    "libraries": {"numpy": "2.4", "scipy": "1.17"},
}


@pytest.mark.parametrize(
    "group, old, why",
    [
        ("settings", {"plan": {"poses": 100, "layout": None}, "seed": 0}, "setting plan.poses 100 -> 150"),
        (
            "settings",
            {"plan": {"poses": 100, "layout": None}, "seed": 1},
            "setting plan.poses 100 -> 150 and 1 more",
        ),
        ("files", {"urdf": "ab"}, "file urdf changed"),
        ("files", {}, "file urdf changed"),
        ("inputs", {"model": "bc"}, "input model changed"),
        (
            "code",
            {"kincal.pipeline.stages.registry:plan": "cc", "kincal.urdf.kinematics": "de"},
            "code kincal.urdf.kinematics changed",
        ),
        ("libraries", {"numpy": "2.3", "scipy": "1.17"}, "library numpy 2.3 -> 2.4"),
    ],
)
def test_explain(group, old, why):
    assert explain({"parts": PARTS | {group: old}}, PARTS) == why


LEGS = [{"name": f"leg{k}", "kind": "point", "frames": [f"leg{k}_tip", f"platform_joint{k}"]} for k in range(1, 7)]
CUT = {**LEGS[1], "frames": ["leg2_rod", "platform_joint2"]}


@pytest.mark.parametrize(
    "old, new, said",
    [
        (LEGS, [LEGS[0], CUT, *LEGS[2:]], "changed (loop 'leg2')"),
        (LEGS[:2], LEGS[:4], "changed (loop 'leg3', 'leg4')"),
        (LEGS[:2], [], "changed (loop 'leg1', 'leg2')"),
        (LEGS[:2], LEGS[1::-1], "changed (loop order)"),
        ([0, 1], [0, 2], "[0, 1] -> [0, 2]"),
        (["leg1_slide"] * 6, ["leg1_slid"] * 6, "changed"),
    ],
)
def test_explain_a_list(old, new, said):
    """Which tables of it, by their names; and nothing longer than a line."""
    before, now = ({"settings": {"mechanism": {"loop": value}}} for value in (old, new))
    assert explain({"parts": before}, PARTS | now) == f"setting mechanism.loop {said}"


def test_explain_the_first_run_and_a_lost_artifact():
    assert explain(None, PARTS) == "never ran for this robot"
    assert explain({"parts": PARTS}, PARTS) == "its artifact is gone or damaged"
