"""`kincal cache gc`, `accept` and `verify`; and a run that loses what it has found."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from kincal.pipeline.run.acceptance import accept
from kincal.pipeline.run.executor import Place, executor
from kincal.pipeline.run.fan_out import Job, run_all, run_of
from kincal.pipeline.run.fingerprint import Code
from kincal.pipeline.store.garbage import free, garbage
from kincal.pipeline.store.manifest import Damaged
from kincal.pipeline.store.store import Store
from kincal.urdf.description import load_robot
from kincal.urdf.errors import InputError

POSES = ("--set", "plan.poses=12")


def artifacts(store: Path) -> set[str]:
    return {str(f.relative_to(store)) for f in (store / "artifacts").glob("*/*")}


def freed(store: Path, **options) -> set[tuple[str, str]]:
    """(kind, path) of what gc frees."""
    kept = Store(store)
    return {(one.kind, str(one.path.relative_to(store))) for one in free(kept, garbage(kept, **options).found)}


# gc


def test_gc_keeps_what_a_robot_used_last_and_frees_the_rest(cli, start, store, still_served):
    used = artifacts(store)
    start(store, "plan.poses=13")[0].until("plan")
    start(store, "plan.poses=12")[0].until("report")
    (other,) = artifacts(store) - used
    bytes_of = sum(f.stat().st_size for f in (store / other).iterdir())
    dry = json.loads(cli("cache", "gc", "--store", store, "--dry-run", "--json").out)
    assert artifacts(store) == used | {other}
    said = json.loads(cli("cache", "gc", "--store", store, "--json").out)
    assert {**said, "dry_run": True} == dry
    assert said["freed"]["artifact"] == {"count": 1, "bytes": bytes_of}
    assert artifacts(store) == used
    assert not list((store / "locks").iterdir())
    still_served(store)
    assert cli("cache", "gc", "--store", store).out == "freed 0 (nothing), 0 bytes\n"
    rows = {stage: why for stage, _, why in start(store, "plan.poses=13")[0].status()}
    assert rows["plan"] == "setting plan.poses 12 -> 13; an earlier result of these was freed by `kincal cache gc`"


def test_gc_frees_what_was_damaged_unless_it_is_asked_not_to(start, store):
    (file,) = (store / "artifacts").glob("evaluate/*/value.json")
    file.write_bytes(b"{")
    start(store, "plan.poses=12")[0].until("evaluate")
    assert not {kind for kind, _ in freed(store, keep_damaged=True)} & {"damaged", "artifact"}
    assert len(list((store / "damaged").iterdir())) == 1
    assert {kind for kind, _ in freed(store)} == {"damaged"}


@pytest.mark.parametrize("content", [b"", b"[]", b'{"key": "00"}', b'{"references": [], "made": "/", "seal": "0"}'])
def test_gc_frees_nothing_that_a_damaged_note_may_have_named(start, store, content):
    """Of its stage; of any, where it was no stage's."""
    start(store, "plan.poses=13")[0].until("measure")
    before = artifacts(store)
    (note,) = (store / "robots").glob("*/plan.json")
    sound = note.read_bytes()
    note.write_bytes(content)
    freed(store)
    assert {a for a in before if "/plan/" in a} <= artifacts(store)
    note.write_bytes(sound)
    (note.parent / "sweep-0123456789.json").write_bytes(content)
    before = artifacts(store)
    freed(store)
    assert artifacts(store) == before


def test_gc_leaves_living_writers_alone(store):
    """Leftovers of one that was killed are freed; a folder in which a process writes is not."""
    script = (
        "import sys, time; from pathlib import Path; from kincal.pipeline.store.store import Store\n"
        "with Store(Path(sys.argv[1]))._aside() as folder:\n"
        "    (folder / 'half').write_bytes(b'x')\n    print(folder, flush=True)\n    time.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", script, store], stdout=subprocess.PIPE, text=True) as writer:
        folder = Path(writer.stdout.readline().strip())
        assert not {kind for kind, _ in freed(store)} & {"leftover"}
        writer.kill()
    assert freed(store) == {("leftover", str(folder.relative_to(store)))}


def test_gc_keeps_robots_whose_file_has_gone_until_it_is_told(cli, start, store, robot_folder):
    run, _ = start(store, "plan.poses=13", robot=robot_folder)
    run.until("measure")
    theirs, folder = artifacts(store), store / "robots" / run.robot_id
    shutil.rmtree(robot_folder)
    answer = cli("cache", "gc", "--store", store)
    assert answer.status == 0
    assert f"{robot_folder / 'robot.toml'} is not there any more; kept" in answer.err
    assert artifacts(store) == theirs
    assert cli("cache", "gc", "--store", store, "--gone").status == 0
    assert not folder.exists()
    assert len(theirs - artifacts(store)) == 2  # plan and measure; the model is that of the other robot, too


def test_gc_keeps_what_a_sweep_used_while_its_table_is_there(cli, finished, store, tmp_path):
    swept = ("sweep", "ups3_s", "--over", "evaluate.fresh_poses=500,501", "--output", "out", "--store", store)
    before, settings = artifacts(store), [part for s in finished.settings for part in ("--set", s)]
    assert cli(*swept, *settings).status == 0
    made = artifacts(store) - before
    assert {Path(m).parent.name for m in made} == {"compensate", "evaluate"}
    freed(store)
    assert artifacts(store) == before | made
    (tmp_path / "out").rename(tmp_path / "away")
    (tmp_path / "out").symlink_to("out")  # who may not look does not know
    freed(store)
    assert artifacts(store) == before | made
    (tmp_path / "out").unlink()
    (tmp_path / "away").rename(tmp_path / "out")
    (tmp_path / "out" / "sweep.parquet").unlink()
    freed(store)
    assert artifacts(store) == before


def test_gc_frees_nothing_where_notes_can_not_be_read(cli, store):
    before = artifacts(store)
    (store / "robots").rename(store / "elsewhere")
    (store / "robots").symlink_to("robots")  # for root, too, a folder that can't be listed
    answer = cli("cache", "gc", "--store", store)
    assert (answer.status, answer.err.count("\n")) == (2, 1)
    assert f"{store / 'robots'}: " in answer.err
    assert artifacts(store) == before


def test_gc_leaves_what_is_not_of_kincal(cli, tmp_path):
    files = [tmp_path / "yard" / name for name in ("artifacts/a/b/c.csv", "tmp/a/b", "locks/keys.txt", "damaged/a/b")]
    for file in files:
        file.parent.mkdir(parents=True)
        file.touch()
    assert cli("cache", "gc", "--store", tmp_path / "yard").out == "freed 0 (nothing), 0 bytes\n"
    assert all(file.exists() for file in files)


def test_gc_keeps_what_jobs_have_made_of_an_unfinished_sweep(store):
    job = Job("ups3_s", ("plan.poses=14", 'measure.channels=["orientation"]'), store, "measure")
    before = artifacts(store)
    with executor(Place(1), store) as workers:
        run_all([job], [load_robot(job.robot, job.overrides).description], workers)
    made = artifacts(store) - before
    assert len(made) == 2
    freed(store)
    assert artifacts(store) == before | made
    run = run_of(job)
    run.until("measure")
    used = {(stage, entry.manifest["key"]) for stage, entry in run.entries.items()}
    (store / "table").touch()
    run.store.finish(run.robot_id, "sweep", store / "table", used, "")
    assert not (store / "robots" / run.robot_id / "unfinished").exists()
    freed(store)
    assert artifacts(store) == before | made


def test_what_is_freed_between_finding_and_reading_is_made_again(finished, start, store):
    """As by a `gc` of another process, at each stage in turn."""
    for stage in ("model", "measure", "evaluate"):
        run, events = start(store, *finished.settings)
        load = run.store.load

        def losing(entry, kind, load=load, stage=stage, lost=[]):  # noqa: B006
            if entry.folder.parent.name == stage and not lost:
                lost.append(shutil.rmtree(entry.folder))
            return load(entry, kind)

        run.store.load = losing
        assert run.until(stage, "evaluate")[1] == finished.comparison
        assert [(e.stage, e.state) for e in events if e.state in ("ran", "damaged")] == [(stage, "ran")]
    assert not (store / "damaged").exists()


def test_what_another_run_has_made_again_is_not_set_aside(finished, start, store):
    """Two runs find the same damage; the second comes late, and leaves the new artifact where it is."""
    (file,) = (store / "artifacts").glob("evaluate/*/value.json")
    file.write_bytes(b"{")
    late, _ = start(store, *finished.settings)
    late.until("plan")
    found = late.store.find("evaluate", json.loads(file.with_name("manifest.json").read_text())["key"])
    with pytest.raises(Damaged) as damage:
        late.store.files(found)
    start(store, *finished.settings)[0].until("evaluate")
    late.store.set_aside(damage.value)
    assert len(list((store / "damaged").iterdir())) == 1
    assert file.exists()


# accept


@pytest.fixture
def refactored(copy_project, tmp_path) -> Path:
    """A copy of the project in which a helper was split in two."""
    root = copy_project(tmp_path / "project")
    file = root / "kincal" / "urdf" / "rigid_motion.py"
    file.write_text(file.read_text() + "\n\ndef _refactored():\n    return 1\n")
    return root


@pytest.fixture
def session(start, store, refactored):
    """session(*overrides): the finished run's robot, by the refactored code."""

    def session(*overrides: str):
        run, events = start(store, "plan.poses=12", *overrides)
        run._code, run.command = Code(refactored, memo=run.store.read_memo()), "kincal cache accept"
        return run, events

    return session


def test_accept_after_a_refactoring(finished, start, session, store):
    before, _ = start(store, *finished.settings)
    before.until("report")
    accepted = accept(session()[0])
    assert {a.stage for a in accepted} >= {"model", "identify", "evaluate"}
    assert all("kincal.urdf.rigid_motion" in a.changed and a.digest == before.entries[a.stage].digest for a in accepted)
    run, events = session()
    assert run.until("evaluate", "report")[0] == finished.comparison
    assert {e.state for e in events} == {"cached"}
    assert all(run.entries[a.stage].manifest["key"] == a.key for a in accepted)
    (said,) = run.entries["model"].manifest["provenance"]["accepted"]
    assert said["changed"] == ["kincal.urdf.rigid_motion"]
    assert said["from_key"] == before.entries["model"].manifest["key"]
    assert {"at", "from_code", "command"} <= set(said)


def test_accept_of_one_stage(session):
    assert [a.stage for a in accept(session()[0], ["model"])] == ["model"]
    with pytest.raises(InputError, match="evaluate: nothing to accept: measure is not up to date"):
        accept(session()[0], ["evaluate"])


def test_accept_takes_code_alone(session, store, robot_folder, start, monkeypatch):
    """No setting, no library, nothing damaged; and nothing is changed where it refuses."""
    before = artifacts(store)
    with pytest.raises(InputError, match=r"^plan: can't be accepted: setting plan.poses 12 -> 13; allowed is"):
        accept(session("plan.poses=13")[0])
    with monkeypatch.context() as patched:
        patched.setattr("kincal.pipeline.run.runner.version", lambda library: "99.1")
        with pytest.raises(InputError, match=r"^model: can't be accepted: library .* -> 99.1"):
            accept(session()[0])
    (file,) = (store / "artifacts").glob("evaluate/*/value.json")
    file.write_bytes(b"{")
    with pytest.raises(InputError, match=r"^evaluate: can't be accepted: .*value.json"):
        accept(session()[0])
    assert artifacts(store) == before


def test_accept_from_the_command_line(cli, kincal, refactored, store):
    assert cli("cache", "accept", "ups3_s", "--stage", "evaluatee", "--store", store).status == 2
    robot = refactored / "kincal" / "urdf" / "robots" / "ups3_s"
    answer = kincal("cache", "accept", robot, *POSES, "--store", store, "--json", root=refactored)
    assert (answer.status, answer.out) == (0, "[]\n")  # of another folder: it never ran


def test_accept_where_nothing_has_changed(cli, store):
    answer = cli("cache", "accept", "ups3_s", *POSES, "--store", store)
    assert (answer.status, answer.out) == (0, "nothing to accept: no stage's code has changed\n")


# verify


def verified(cli, store: Path) -> tuple[int, dict]:
    answer = cli("cache", "verify", "ups3_s", *POSES, "--store", store, "--json")
    return answer.status, json.loads(answer.out)


def test_verify_a_sound_store(cli, store, stage_names):
    assert cli("run", "ups3_s", *POSES, "--store", store).status == 0  # publishes the report
    status, found = verified(cli, store)
    assert (status, found["problems"]) == (0, [])
    assert [s["stage"] for s in found["stages"]] == list(stage_names)
    assert found["comparison"]["same_bytes"] is True
    (page,) = (store / "robots").glob("*/report.html")
    page.write_text(page.read_text().replace("hybrid", "hybrids", 1))
    assert verified(cli, store)[0] == 1


def test_verify_names_what_is_damaged_and_changes_nothing(cli, store):
    (file,) = (store / "artifacts").glob("identify/*/arrays.safetensors")
    content = bytearray(file.read_bytes())
    content[-9] ^= 1
    file.write_bytes(content)
    status, found = verified(cli, store)
    assert status == 1
    assert [s["stage"] for s in found["stages"] if s["problems"]] == ["identify"]
    assert found["comparison"] is None
    assert file.read_bytes() == content


def test_verify_makes_the_comparison_once_more(cli, start, store):
    """A forged one: another number, with digests and seal to match."""
    run, _ = start(store, "plan.poses=12")
    run.until("evaluate")
    old = run.entries["evaluate"]
    files = {"value.json": (old.folder / "value.json").read_bytes()}
    compared = json.loads(files["value.json"])
    compared["methods"][1]["mean_deg"] *= 1.25
    forged = (json.dumps(compared, indent=1) + "\n").encode()
    run.store.put("evaluate", old.manifest["key"], {"value.json": forged}, old.manifest, replace=True)
    status, found = verified(cli, store)
    assert status == 1
    assert found["comparison"]["where"] == "methods[1].mean_deg"
    assert found["comparison"]["largest_relative_difference"] == pytest.approx(0.2)


def test_verify_a_chain_that_does_not_fit(cli, start, store):
    start(store, "plan.poses=13")[0].until("plan")
    status, found = verified(cli, store)
    assert status == 1
    assert found["problems"][0] == "measure: rests on another plan than the robot used last"


def test_verify_before_the_first_run(cli, tmp_path):
    answer = cli("cache", "verify", "ups3_s", "--store", tmp_path / "none")
    assert answer.status == 2
    assert "it never ran" in answer.err


# Provenance


def test_documents_name_what_they_were_made_of(cli, start, store):
    run, _ = start(store, "plan.poses=12")
    run.until("report")
    digests = {stage: entry.digest for stage, entry in run.entries.items()}
    for command in ("run", "compare", "inspect"):
        answer = cli(command, "ups3_s", *POSES, "--store", store, "--json")
        said = json.loads(answer.out)["provenance"]
        assert said["inputs"].items() <= digests.items()
        assert "identify" in said["inputs"]
        assert said["seed"] == 0
        assert {"kincal", "python", "numpy"} <= set(said["versions"])
        assert set(said["files"]) == {"urdf"}
        assert said["command"].startswith("kincal")
    (page,) = (store / "robots").glob("*/report.html")
    assert digests["evaluate"] in page.read_text()
