"""The store: what goes in comes out, damage is noticed, and no accident leaves a wrong result."""

import ast
import dataclasses
import json
import re
import resource
import shutil
import signal
import string
import subprocess
import sys
import typing
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from kincal.pipeline import results
from kincal.pipeline.results import Html, Report
from kincal.pipeline.run.stage import all_stages
from kincal.pipeline.store.codec import decode, encode
from kincal.pipeline.store.manifest import Damaged
from kincal.pipeline.store.store import Store
from kincal.urdf.description import Mechanism, VirtualErrors, Workspace
from tests.sources import sources

# There and back

FLOATS = st.floats(allow_nan=True, allow_infinity=True)
TEXTS = st.text(max_size=30).filter(lambda text: text.isprintable() or "\n" in text)
ARRAYS = arrays.arrays(
    st.sampled_from([np.float64, np.int64, np.bool_]),
    arrays.array_shapes(min_dims=1, max_dims=3, min_side=0, max_side=4),
)
TABLES = st.integers(0, 5).flatmap(
    lambda n: st.fixed_dictionaries(
        {"pose": st.just(np.arange(n)), "x": arrays.arrays(np.float64, n), "y": arrays.arrays(np.float64, n)}
    ).map(pd.DataFrame)
)
NAMES = st.text(string.ascii_letters, min_size=1, max_size=9)
MECHANISMS = st.builds(
    lambda names, base: Mechanism(
        base_frame=base,
        tool_frame="tool",
        actuated=tuple(names),
        workspace=Workspace(rotation_deg={"x": (-1.5, 2.0)}, home_mm=(0.1, 0.2, 0.3)),
    ),
    st.lists(NAMES, min_size=1, max_size=3, unique=True),
    NAMES,
)
LEAVES = {
    bool: st.booleans(),
    int: st.integers(-(2**53), 2**53),
    float: FLOATS,
    str: TEXTS,
    np.ndarray: ARRAYS,
    results.Frame: TABLES,
    Mechanism: MECHANISMS,
    VirtualErrors: st.builds(VirtualErrors, elastic=st.booleans(), payload_kg=st.floats(0, 1e3)),
    type(None): st.none(),
}


def values(kind) -> st.SearchStrategy:
    """Any value of a result type, from its annotations."""
    if kind in LEAVES:
        return LEAVES[kind]
    if typing.get_origin(kind) is tuple:
        first, *rest = typing.get_args(kind)
        if rest == [Ellipsis]:
            return st.lists(values(first), max_size=2).map(tuple)
        return st.tuples(*(values(k) for k in (first, *rest)))
    if typing.get_origin(kind) is dict:
        return st.dictionaries(NAMES, values(typing.get_args(kind)[1]), max_size=3)
    if typing.get_args(kind):  # a union
        return st.one_of(*(values(k) for k in typing.get_args(kind)))
    if dataclasses.is_dataclass(kind):
        hints = typing.get_type_hints(kind, vars(results) | vars(sys.modules[kind.__module__]))
        return st.builds(kind, **{f.name: values(hints[f.name]) for f in dataclasses.fields(kind)})
    return TEXTS.map(kind)  # a Text


def same(a, b) -> bool:
    """Equal in type, shape and every bit; NaN equals NaN."""
    if type(a) is not type(b):
        return False
    if dataclasses.is_dataclass(a):
        return all(same(getattr(a, f.name), getattr(b, f.name)) for f in dataclasses.fields(a))
    if isinstance(a, np.ndarray):
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=a.dtype.kind == "f")
    if isinstance(a, pd.DataFrame):
        return a.equals(b) and list(a.dtypes) == list(b.dtypes)
    if isinstance(a, tuple):
        return len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, dict):
        return list(a) == list(b) and all(same(a[k], b[k]) for k in a)
    return a == b or (isinstance(a, float) and np.isnan(a) and np.isnan(b))


@pytest.mark.parametrize("stage", all_stages())
@settings(max_examples=8, deadline=None, suppress_health_check=list(HealthCheck), derandomize=True, database=None)
@given(data=st.data())
def test_every_result_comes_back_as_it_was(stage, data):
    kind = all_stages()[stage].result
    value = data.draw(values(kind))
    files = encode(value)
    assert same(decode(files, kind), value)
    assert encode(value) == files  # the same bytes again
    assert encode(decode(files, kind)) == files


def test_texts_are_files_that_people_can_open():
    files = encode(Report(Html("<p>done</p>")))
    assert files["report.html"] == b"<p>done</p>"
    assert decode(files, Report) == Report(Html("<p>done</p>"))


def test_bytes_do_not_depend_on_the_process(tmp_path, kincal, monkeypatch):
    """The same input gives the same bytes, whatever the order of sets is; kincal fixes the number of threads."""
    for seed in ("1", "2"):
        monkeypatch.setenv("PYTHONHASHSEED", seed)
        assert kincal("inspect", "ups3_s", "--set", "plan.poses=12", "--store", seed).status == 0
    manifests = sorted((tmp_path / "1" / "artifacts").rglob("manifest.json"))
    assert "identify" in {manifest.parent.parent.name for manifest in manifests}
    for manifest in manifests:
        other = tmp_path / "2" / manifest.relative_to(tmp_path / "1")
        assert json.loads(other.read_text())["files"] == json.loads(manifest.read_text())["files"]


# Damage


def payload(store: Path) -> list[str]:
    """Every file of the stages' artifacts, as stage/name."""
    return sorted(f"{f.parent.parent.name}/{f.name}" for f in (store / "artifacts").rglob("*") if f.is_file())


def flip(file: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 0x04
    file.write_bytes(content)


def truncate(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


SOME = ("plan", "measure", "evaluate")
SLOW = ("pretrain", "transfer")  # one file of each will do


@pytest.mark.parametrize("damage, stages", [(flip, None), (truncate, SOME), (Path.unlink, SOME)])
def test_damage_to_any_file_is_noticed_and_repaired(finished, start, tmp_path, stage_names, damage, stages):
    """A byte flipped in every file of every stage; and files cut off, or gone, in some."""
    silent = []
    for name in payload(finished.store):
        stage, file_name = name.split("/")
        if (stages and stage not in stages) or (stage in SLOW and file_name != "value.json"):
            continue
        store = Path(shutil.copytree(finished.store, tmp_path / name.replace("/", "-")))
        (file,) = (store / "artifacts").glob(f"{name.split('/')[0]}/*/{name.split('/')[1]}")
        damage(file)
        run, events = start(store, *finished.settings)
        found = dict(zip(stage_names, run.until(*stage_names), strict=True))
        assert found["evaluate"] == finished.comparison, name
        assert [e.stage for e in events if e.state == "ran"] == [name.split("/")[0]], name
        assert len(list((store / "damaged").iterdir())) == 1, name
        assert payload(store) == payload(finished.store), name
        if [e.stage for e in events if e.state == "damaged"] != [name.split("/")[0]]:
            silent.append(name)
    assert not silent, f"set aside without a warning: {silent}"


def test_the_command_warns_in_one_line(cli, store, finished):
    (file,) = (store / "artifacts").glob("evaluate/*/value.json")
    flip(file)
    answer = cli("compare", "ups3_s", "--set", "plan.poses=12", "--store", store, "--json")
    assert answer.status == 0
    assert len([line for line in answer.err.splitlines() if "warning" in line and "value.json" in line]) == 1
    assert json.loads(answer.out)["methods"][1]["mean_deg"] == finished.comparison.methods[1].mean_deg


def test_damage_is_noticed_where_it_is_read(finished, start, store):
    """A damaged plan does no harm while all below it is cached; the next stage that reads it makes it again."""
    (file,) = (store / "artifacts").glob("plan/*/table0.parquet")
    flip(file)
    run, events = start(store, *finished.settings, "sensor.orientation_deg=0.001")
    run.until("measure")
    assert [(e.stage, e.state) for e in events if e.state in ("damaged", "ran")] == [
        ("plan", "damaged"),
        ("plan", "ran"),
        ("measure", "ran"),
    ]


@pytest.mark.parametrize("content", [b"", b"{", b"null", b'{"key": 3}', b'{"key": "../../.."}', b"\xff" * 9])
def test_a_damaged_reference_does_no_harm(store, still_served, content):
    for file in (store / "robots").rglob("*.json"):
        file.write_bytes(content)
    still_served(store)


@pytest.mark.parametrize("content", [b"", b"{}", b"[]", b'{"memo": {"a": 1}, "seal": "b"}', b"\xff" * 9])
def test_a_damaged_memo_does_no_harm(store, still_served, content):
    (store / "code.json").write_bytes(content)
    still_served(store)


def test_a_manifest_that_lies_is_not_believed(finished, start, store):
    """A number changed in the payload, and its digest in the manifest: the seal tells."""
    (file,) = (store / "artifacts").glob("evaluate/*/manifest.json")
    manifest = json.loads(file.read_text())
    manifest["files"]["value.json"]["sha256"] = 64 * "0"
    file.write_text(json.dumps(manifest))
    run, events = start(store, *finished.settings)
    assert run.until("evaluate")[0] == finished.comparison
    assert "evaluate" in [e.stage for e in events if e.state == "ran"]


def test_an_artifact_of_another_key_is_not_taken(finished, start, store):
    """A whole artifact, moved to another key's place."""
    other, _ = start(store, "plan.poses=13")
    other.until("plan")
    first, second = (store / "artifacts" / "plan").iterdir()
    first.rename(store / "kept")
    second.rename(first)
    (store / "kept").rename(second)
    run, events = start(store, *finished.settings)
    assert len(run.until("plan")[0].table) == 12
    assert [e.stage for e in events if e.state == "ran"] == ["plan"]


# What runs again


def test_a_finished_run_is_cached(store, still_served):
    before = {f: f.stat().st_mtime_ns for f in store.rglob("*")}
    still_served(store)
    assert {f: f.stat().st_mtime_ns for f in store.rglob("*")} == before


def test_early_cut_off(finished, start, store):
    """The same poses from a setting that was the default anyway: plan runs, its bytes are the same, nothing below."""
    run, events = start(store, *finished.settings, 'plan.layout="grid"')
    assert run.until("evaluate")[0] == finished.comparison
    assert [e.stage for e in events if e.state == "ran"] == ["plan"]


def test_a_setting_of_one_stage_reruns_that_one_and_what_it_changes(finished, start, store):
    run, events = start(store, *finished.settings, "evaluate.fresh_poses=501")
    run.until("report")
    ran = {e.stage for e in events if e.state == "ran"}
    assert ran >= {"evaluate", "report"}
    assert not ran & {"model", "plan", "measure", "identify"}
    assert next(e.why for e in events if e.state == "ran") == "setting evaluate.fresh_poses 500 -> 501"


def test_force_from_runs_that_stage_and_all_after_it(finished, start, store, stage_names):
    run, events = start(store, *finished.settings, force_from="identify")
    assert run.until("evaluate", "report")[0] == finished.comparison
    assert tuple(e.stage for e in events if e.state == "ran") == stage_names[stage_names.index("identify") :]
    assert payload(store) == payload(finished.store)


def test_where_files_lie_does_not_matter(finished, start, store, robot_folder):
    run, events = start(store, *finished.settings, robot=robot_folder)
    assert run.until("evaluate")[0] == finished.comparison
    assert {e.state for e in events} == {"cached"}


def test_robots_of_one_name_do_not_mix(finished, start, store, robot_folder):
    """The same name in another folder, with another seed: each keeps its own results and its own reasons."""
    file = robot_folder / "robot.toml"
    file.write_text(file.read_text().replace("seed = 0", "seed = 7"))
    first, _ = start(store, *finished.settings)
    second, _ = start(store, *finished.settings, robot=robot_folder)
    found = {robot: run.until("identify")[0].shipped for robot, run in (("ups3_s", first), (robot_folder, second))}
    assert first.robot_id != second.robot_id
    assert not np.array_equal(found["ups3_s"].change, found[robot_folder].change)
    for robot, expected in found.items():
        run, _ = start(store, *finished.settings, robot=robot)
        assert {stage: state for stage, state, _ in run.status()}["identify"] == "fresh"
        run, events = start(store, *finished.settings, robot=robot)
        np.testing.assert_array_equal(run.until("identify")[0].shipped.change, expected.change)
        assert {e.state for e in events} == {"cached"}


# Accidents


def test_two_runs_at_once(finished, start, tmp_path, environment):
    sets = [part for setting in finished.settings for part in ("--set", setting)]
    command = [sys.executable, "-m", "kincal", "inspect", "ups3_s", *sets, "--json"]
    started = [
        subprocess.Popen(command, cwd=tmp_path, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        for _ in range(2)
    ]
    answers = [process.communicate(timeout=120) for process in started]
    assert [process.returncode for process in started] == [0, 0], answers
    assert answers[0][0] == answers[1][0]
    alone = start(finished.store, *finished.settings)[0].until("identify")[0].shipped
    found = [parameter["change"] for parameter in json.loads(answers[0][0])["parameters"]]
    np.testing.assert_allclose(found, alone.change, rtol=1e-6, atol=1e-10)
    assert set(payload(tmp_path / ".kincal")) <= set(payload(finished.store))
    assert not (tmp_path / ".kincal" / "damaged").exists()


KILLED = """
import os, random, signal, sys, time
from pathlib import Path
import kincal.pipeline.commands.app
import casadi, matplotlib.figure, pinocchio, kincal.pipeline.report.page  # so that children start at once
from kincal.pipeline.store.store import Store
from kincal.pipeline.run.runner import Run
from kincal.urdf.description import load_robot

settings, random = sys.argv[1:], random.Random(0)
survived = 0
for _ in range(15):
    child = os.fork()
    if child == 0:
        Run(load_robot("ups3_s", settings), Store(Path("store"))).until("evaluate", "report")
        os._exit(0)
    time.sleep(random.uniform(0.02, 0.5))
    os.kill(child, signal.SIGKILL)
    survived += os.waitpid(child, 0)[1] == 0
print(survived)
"""


def test_kill_9_leaves_a_usable_store(finished, start, tmp_path, environment):
    done = subprocess.run(
        [sys.executable, "-c", KILLED, *finished.settings],
        cwd=tmp_path,
        env=environment(),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 15  # some were really killed
    run, events = start(tmp_path / "store", *finished.settings)
    assert finished.agrees(run.until("evaluate", "report")[0].methods[1].mean_deg)
    assert "damaged" not in {e.state for e in events}
    assert payload(tmp_path / "store") == payload(finished.store)


def refused(answer, store: Path) -> None:
    lines = [line for line in answer.err.splitlines() if line.startswith("kincal: ")]
    assert answer.status == 2, answer
    assert len(lines) == 1, answer.err
    assert str(store) in lines[0]
    assert "can't be written" in lines[0]
    assert "Traceback" not in answer.err


@pytest.mark.parametrize("what", [".kincal", "artifacts", "tmp", "locks"])
def test_a_file_in_the_place_of_a_folder(cli, tmp_path, what):
    store = tmp_path / ".kincal"
    if what == ".kincal":
        store.write_text("not a folder")
    else:
        store.mkdir()
        (store / what).write_text("not a folder")
    refused(cli("run", "ups3_s", "--until", "model"), store)


@pytest.fixture
def mounted(tmp_path):
    """mounted(options): a small file system of its own; `.remount(options)` changes it."""
    folder = tmp_path / "mounted"
    folder.mkdir()

    def mount(options: str) -> Path:
        done = subprocess.run(["mount", "-t", "tmpfs", "-o", options, "tmpfs", folder], capture_output=True, text=True)
        if done.returncode:
            pytest.skip(f"a file system of a given size can't be mounted here: {done.stderr.strip()}")
        return folder

    if shutil.which("mount") is None:
        pytest.skip("no mount command")
    yield mount
    while subprocess.run(["mountpoint", "-q", folder]).returncode == 0:
        subprocess.run(["umount", folder], check=True)


def test_a_read_only_store(cli, finished, mounted, still_served):
    """What is cached is served; what is not is refused, and does no harm."""
    folder = mounted("size=20m")
    store = Path(shutil.copytree(finished.store, folder / "store"))
    mounted("remount,ro")
    refused(cli("run", "ups3_s", "--set", "plan.poses=13", "--store", store), store)
    still_served(store)
    assert cli("status", "ups3_s", "--set", "plan.poses=12", "--store", store).status == 0
    for command in ("compare", "inspect", "run"):
        assert cli(command, "ups3_s", "--set", "plan.poses=12", "--store", store).status == 0, command


def test_a_full_disk(cli, finished, start, mounted, still_served):
    folder = mounted("size=20m")
    store = Path(shutil.copytree(finished.store, folder / "store"))
    (folder / "ballast").touch()
    subprocess.run(["dd", "if=/dev/zero", f"of={folder / 'ballast'}", "bs=4096"], capture_output=True)
    assert shutil.disk_usage(folder).free == 0
    refused(cli("run", "ups3_s", "--set", "plan.poses=13", "--store", store), store)
    still_served(store)
    assert not list((store / "tmp").iterdir())
    (folder / "ballast").unlink()
    run, _ = start(store, "plan.poses=13")
    assert run.until("evaluate")[0].n_poses == 13


def test_files_that_may_not_grow(kincal, start, tmp_path, finished, still_served):
    """As a full disk, halfway through: a limit of file size that the first stages pass."""
    sizes = {f.parent.parent.name: f.stat().st_size for f in (finished.store / "artifacts").rglob("arrays.safetensors")}
    limit = sizes["identify"] // 2

    def small_files() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    store = tmp_path / "limited"
    answer = kincal("run", "ups3_s", "--set", "plan.poses=12", "--store", store, preexec_fn=small_files)
    refused(answer, store)
    run, events = start(store, *finished.settings)
    assert finished.agrees(run.until("evaluate")[0].methods[1].mean_deg)
    states = {e.stage: e.state for e in events}
    assert [states[s] for s in ("model", "plan", "measure", "identify")] == ["cached", "cached", "cached", "ran"]


# No pickle

# What turns bytes of a file into code that runs. concurrent.futures and Dask pickle what goes between processes of one
# run; nothing of that is a file, and none of it is called by kincal.
CODE = (
    "pickle",
    "cPickle",
    "_pickle",
    "dill",
    "cloudpickle",
    "shelve",
    "marshal",
    "joblib",
    "copyreg",
    "jsonpickle",
    "yaml",
)
CALLS = ("eval", "exec", "compile", "__import__", "read_pickle", "to_pickle", "unsafe_load", "full_load", "runpy")
OF_TORCH, OF_NUMPY = ("load", "save", "compile"), ("load", "save", "fromfile", "savez")


def unpickles(source: str) -> list[str]:
    """What a module imports or calls that loads code from data."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import | ast.ImportFrom):
            modules = [getattr(node, "module", None) or "", *(alias.name for alias in node.names)]
            found += [m for m in modules if set(m.split(".")) & set(CODE)]
            if getattr(node, "module", None) in ("torch", "numpy"):
                found += [a.name for a in node.names if a.name in ("load", "save")]
        elif isinstance(node, ast.Call):
            name, of = ast.unparse(node.func).split(".")[-1], ast.unparse(node.func).split(".")[0]
            plain = name in CALLS and not (name == "compile" and of == "re")
            if plain or (of == "torch" and name in OF_TORCH) or (of in ("np", "numpy") and name in OF_NUMPY):
                found.append(ast.unparse(node.func))
            found += [k.arg for k in node.keywords if k.arg in ("allow_pickle", "weights_only")]
    return found


def test_sources_have_no_pickle():
    """Read as syntax trees: an alias or a line break hides nothing."""
    for file in sources():
        assert unpickles(file.read_text()) == [], file


@pytest.mark.parametrize(
    "source",
    [
        "import pickle as p",
        "from joblib import load",
        "from torch import load",
        "import numpy as np\nnp.load(f,\n  allow_pickle=True)",
        "torch.load(f)",
        "pd.read_pickle(f)",
        "import yaml\nyaml.load(f)",
        "eval(text)",
        "exec(text)",
        "import concurrent, cloudpickle",
        "__import__('pickle')",
    ],
)
def test_a_pickle_would_be_found(source):
    assert unpickles(source)


def test_stores_have_no_pickle(finished):
    """Formats by their own first bytes; and nothing that a pickle could hide behind."""
    for file in finished.store.rglob("*"):
        if file.is_file() and file.suffix not in (".lock",):
            content = file.read_bytes()
            if file.suffix == ".parquet":
                assert content[:4] == content[-4:] == b"PAR1", file
            elif file.suffix == ".safetensors":
                assert content[8:9] == b"{", file
            else:
                assert file.suffix in (".json", ".html", ".urdf", ".txt"), file
                content.decode("utf-8")
            assert not re.match(rb"\x80[\x02-\x05]", content), file


def test_formats_that_do_not_fit_are_damage(finished, tmp_path):
    """Whole bytes that are no value of that type are Damaged, nothing else."""
    store = Store(tmp_path / "store")
    entry = store.save("plan", 64 * "a", results.Fit(np.arange(2), np.zeros(3), np.zeros(3)), {})
    with pytest.raises(Damaged):
        store.load(entry, results.PosePlan)
