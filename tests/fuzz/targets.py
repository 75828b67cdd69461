"""What is fuzzed: one entry a file format, with valid files, how to spoil them, and who reads them.

A new format is one more entry in `TARGETS`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
import pandas as pd

from tests.fuzz import mutations, seeds, structure
from tests.fuzz.mutations import BYTES, TEXTUAL, Mutation
from tests.fuzz.seeds import LEGS, Files

STRUCTURAL: Mapping[str, Mutation] = {
    ".toml": structure.toml,
    ".json": structure.json_,
    ".urdf": structure.xml,
    ".xml": structure.xml,
    ".csv": structure.table,
    ".parquet": structure.parquet,
    ".nmea": structure.nmea,
    ".db3": structure.sqlite,
}
_BINARY = (".parquet", ".bag", ".mcap", ".db3", ".mat", ".safetensors")


@dataclass(frozen=True)
class Target:
    """read(folder): reads what stands in the folder; says no by an InputError or a CalibrationError."""

    name: str
    files: Callable[[], Sequence[Files]]  # valid ones
    read: Callable[[Path], Any]
    spoiled: tuple[str, ...] = ()  # the ends of the names of files that are spoiled; default: all
    seconds: float = 5.0  # of computing, that a case may take
    share: float = 1.0  # of the cases, against other targets
    named: tuple[str, ...] = ()  # one of them stands in every refusal; default: the files' names

    def case(self, number: int) -> Files:
        """The files of a case: always the same."""
        random = Random(f"{self.name} {number}")
        files = dict(random.choice(_once(self.files)))
        if number == 0:
            return files  # as they are: must be accepted
        chosen = [n for n in files if n.endswith(self.spoiled)] if self.spoiled else list(files)
        name = random.choice(chosen)
        files[name] = spoil(name, files[name], random)
        return files

    def words(self) -> tuple[str, ...]:
        return self.named or tuple({name for files in _once(self.files) for name in files})


@lru_cache
def _once(files: Callable[[], Sequence[Files]]) -> Sequence[Files]:
    return files()


def spoil(name: str, content: bytes, random: Random) -> bytes:
    suffix = Path(name).suffix
    if suffix in STRUCTURAL and random.random() < 0.5:
        try:
            return STRUCTURAL[suffix](content, random)
        except Exception:  # a change that this format can't even write
            pass
    return mutations.several(BYTES if suffix in _BINARY else TEXTUAL, content, random)


# Readers


@lru_cache
def _ups3_s() -> tuple[Any, Any]:
    from kincal.urdf.actuators import Actuators
    from kincal.urdf.closed_chain import load_chain
    from kincal.urdf.description import load_robot

    description = load_robot("ups3_s").description
    chain = load_chain(description.mechanism, description.urdf.read_text(), description.urdf)
    return chain, Actuators.nominal(chain, {})


def _described(folder: Path) -> Any:
    from kincal.urdf.description import load_robot

    return load_robot(str(folder / "robot.toml")).description


def _drawn(folder: Path) -> None:
    """The drawing and the chain, without closing its loops."""
    from kincal.urdf.closed_chain import load_chain
    from kincal.urdf.input_files import read_text

    described = _described(folder)
    load_chain(described.mechanism, read_text(described.urdf), described.urdf)


def _modelled(folder: Path) -> None:
    from kincal.pipeline.stages import drawing

    described = _described(folder)
    drawing.model_stage(described.mechanism, described.urdf)


def _proposed(folder: Path) -> None:
    from kincal.urdf.proposal import propose
    from kincal.urdf.proposed_toml import robot_toml

    drawing = next(f for f in folder.iterdir() if f.suffix in (".urdf", ".xml"))
    robot_toml(propose(drawing), drawing, folder / "robot.toml")


def _override(folder: Path) -> None:
    from kincal.urdf.description import load_robot

    load_robot("ups3_s", [(folder / "text").read_bytes().decode(errors="surrogateescape")])


def _over(folder: Path) -> None:
    from kincal.pipeline.studies.grid import combinations, parse_over
    from kincal.urdf.description import load_robot
    from kincal.urdf.errors import InputError

    over = parse_over((folder / "text").read_bytes().decode(errors="surrogateescape"))
    combinations([over])
    for text in over.overrides()[:3]:
        try:
            load_robot("ups3_s", [text])
        except InputError as error:
            raise InputError(str(error).replace("--set", "--over")) from None


OVERRIDES = (
    *("plan.poses=12", "seed=3", 'identify.estimator="ridge"', "measure.stream={rate_hz=50.0}", "sensor.tilt_deg=1"),
    *('measure.channels=["tilt"]', "workspace.rotation_deg={x=[-1,1],y=[-2,2],z=[-1.5,3]}", "measure.table=t.csv"),
    *('measure.columns={x={from="a", unit="mm"}}', "actuator.leg1_slide.gain=2", "identify.shrinkage=0.5", "name=a"),
)  # fmt: skip
OVERS = (
    *("plan.poses=12,14,...,30", "seed=1,2,3", 'identify.estimator="ridge","map"', "identify.shrinkage=0.1,0.2,...,1"),
    *('measure.channels=["tilt"],["orientation"]', "sensor.tilt_deg=1e-3,1e-2", "measure.stream={seconds=5.0},{}"),
)  # fmt: skip


def _texts(texts: Sequence[str]) -> list[Files]:
    return [{"text": text.encode()} for text in texts]


def _measured(folder: Path, measured: bool, joints: Sequence[str]) -> None:
    """As `measure`, `evaluate`, `predict` (joint values alone) and `compensate` (poses alone) read a table."""
    from kincal.identification.joint_limits import check_readings
    from kincal.identification.measurement_table import read_table
    from kincal.identification.measurements import to_measurements
    from kincal.urdf.description import Measure, Sensor, Tolerance

    (file,) = folder.iterdir()
    chain, actuators = _ups3_s()
    table = read_table(file, joints, Measure(table=file), measured=measured)
    if joints:
        check_readings(table, chain, actuators, Tolerance(), file)
    if measured:
        to_measurements(table, joints, Sensor()).as_poses()


def _exported(folder: Path) -> None:
    """An export of motion capture with joint values in a table of their own."""
    from kincal.identification.measurement_table import noted_table
    from kincal.urdf.description import Measure

    noted_table(folder / "take.csv", LEGS, Measure(table=folder / "take.csv", joints=folder / "joints.csv"))


def _columns(folder: Path) -> None:
    from kincal.urdf.description import read_columns

    read_columns(folder / "columns.toml")


def _logged(folder: Path) -> None:
    """A stream alone, whatever its format; then as a motion that is played again."""
    from kincal.identification.streams.reading import read_log
    from kincal.pipeline.sea.replay import replayed
    from kincal.urdf.description import Log, Measure

    bag = len(list(folder.iterdir())) > 1
    file = folder if bag else next(folder.iterdir())
    samples, _ = read_log(file, Measure(streams=file, table="-", log=Log(format="bag") if bag else Log()))
    t, roll, pitch = (samples[name].to_numpy(float) for name in ("t", "roll", "pitch"))
    replayed(t, roll, pitch, np.zeros(len(t)), None, 50.0, str(file))


def _posed(folder: Path) -> None:
    """A stream that says which pose a sample is of, and the filter over it."""
    from kincal.identification.inclinometer import filter_stream
    from kincal.identification.streams.reading import read_stream
    from kincal.urdf.description import Filter, Measure, Sensor

    (file,) = folder.iterdir()
    samples, _ = read_stream(file, Measure(streams=file, table="-"))
    filter_stream(samples, np.unique(samples["pose"]), Sensor(), Filter(), f"stream ({file.name})")


def _campaign(folder: Path) -> None:
    from kincal.identification.streams.static_poses import static_poses
    from kincal.urdf.description import Measure

    commands = next(f for f in folder.iterdir() if f.stem == "commands")
    static_poses(Measure(streams=next(f for f in folder.iterdir() if f.stem == "log"), commands=commands), LEGS)


def _rao(folder: Path) -> None:
    from kincal.pipeline.sea.rao_files import read_rao

    (file,) = folder.iterdir()
    read_rao(file, 0.0)


@lru_cache
def _values() -> dict[str, Any]:
    """{stage: a small result of its kind}."""
    from kincal.learning.network import Network
    from kincal.pipeline.learned import Pretrained
    from kincal.pipeline.results import Fit, Html, Measured, PosePlan, Report, Truth
    from kincal.urdf.description import VirtualErrors

    weights = Network((3, 2, 2, 4), np.linspace(0, 1, 26), np.zeros(3), np.ones(3), np.ones(4))
    truth = Truth(np.arange(3.0), np.zeros(3), np.ones(3), VirtualErrors())
    return {
        "plan": PosePlan(seeds.measured()),
        "measure": Measured("virtual", seeds.measured(), seeds.stream(50, 5), truth),
        "pretrain": Pretrained(weights, (weights,), np.zeros((2, 2))),
        "transfer": Fit(np.arange(3), np.zeros(3), np.arange(3.0)),
        "report": Report(Html("<html></html>")),
    }


def _artifacts(resealed: bool) -> list[Files]:
    import tempfile

    from kincal.pipeline.store.store import Store

    found = []
    for stage, value in _values().items():
        with tempfile.TemporaryDirectory() as root:
            folder = Store(Path(root)).save(stage, 64 * "a", value, {"parts": {"stage": stage}}).folder
            files = {f.name: f.read_bytes() for f in sorted(folder.iterdir())}
        found.append({f"{stage}/{name}": content for name, content in files.items()})
    return found


def _stored(folder: Path, resealed: bool) -> None:
    """An artifact from the store: what was stored, or damage; resealed: whatever its manifest can say of itself."""
    import json

    from kincal.pipeline.run.changes import explain
    from kincal.pipeline.store.codec import encode
    from kincal.pipeline.store.digests import digest
    from kincal.pipeline.store.manifest import Damaged
    from kincal.pipeline.store.store import Store

    stage = next(folder.iterdir()).name
    value, store, key = _values()[stage], Store(folder.parent / "cwd" / "store"), 64 * "a"
    place = store.root / "artifacts" / stage / key[:40]
    place.mkdir(parents=True)
    contents = {f.name: f.read_bytes() for f in (folder / stage).iterdir()}
    if resealed:
        try:
            manifest = json.loads(contents["manifest.json"])
            manifest.pop("seal", None)
            for name in manifest["files"]:
                if name in contents:
                    manifest["files"][name] = {"bytes": len(contents[name]), "sha256": digest(contents[name])}
            contents["manifest.json"] = json.dumps(manifest | {"seal": digest(manifest)}).encode()
        except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
            pass
    for name, content in contents.items():
        (place / name).write_bytes(content)
    (store.root / "robots" / "r").mkdir(parents=True)
    (store.root / "robots" / "r" / f"{stage}.json").write_bytes(contents["manifest.json"])
    (store.root / "code.json").write_bytes(contents["manifest.json"])
    try:
        store.read_memo()
        explain(store.last("r", stage), {k: {} for k in ("settings", "files", "inputs", "code", "libraries")})
        entry = store.find(stage, key)
        if entry is not None:
            found = store.load(entry, type(value))
            assert resealed or encode(found) == encode(value), "another value was served"
    except Damaged as damage:
        from kincal.urdf.errors import InputError

        raise InputError(str(damage)) from None  # what the runner heals
    finally:
        import shutil

        shutil.rmtree(store.root)


_STREAMS: dict[str, Callable[[], list[Files]]] = {
    "csv": lambda: [{"log.csv": seeds.csv(seeds.stream())}],
    "csv, topics and dates": lambda: [{"log.csv": seeds.csv(s)} for s in (seeds.merged(), *seeds.dated())],
    "parquet": lambda: [{"log.parquet": seeds.parquet(s)} for s in (seeds.stream(), seeds.merged())],
    "nmea": seeds.nmea_logs,
    "ROS 1 bag": lambda: [files for kind, files in seeds.bags().items() if "ros1" in kind],
    "ROS 2 sqlite3": lambda: [seeds.bags()["sqlite3"]],
    "ROS 2 mcap": lambda: [seeds.bags()[kind] for kind in ("mcap", "mcap zstd")],
    "ROS 2 without metadata": seeds.bags_without_metadata,
}


def _campaign_files() -> list[Files]:
    log, commands = seeds.campaign()
    both = seeds.csv(pd.concat([log, commands]).sort_values("t"))
    return [
        {"log.csv": both, "commands.csv": both},
        {"log.csv": seeds.csv(log), "commands.csv": seeds.csv(commands)},
        {"log.parquet": seeds.parquet(log), "commands.parquet": seeds.parquet(commands)},
    ]


def _tables(*columns: str) -> list[Files]:
    table = seeds.measured()
    table = table[[c for c in table if not columns or c in columns]]
    return [{"table.csv": seeds.csv(table)}, {"table.parquet": seeds.parquet(table)}]


def _raos() -> list[Files]:
    return [{"rao.csv": seeds.csv(seeds.rao())}, {"rao.parquet": seeds.parquet(seeds.rao())}]


def _all_drawings() -> list[Files]:
    return seeds.drawings() + seeds.mjcf_drawings()


# What can't be put together is said of the table of robot.toml: `kincal run` names the robot before.
_MECHANISM = ("/case/", "loop", "workspace", "mobility", "home", "actuated", "base_frame", "tool_frame")
_COLUMNS = b'x = { from = "position_x", unit = "mm" }\nleg1_slide = "leg_length_1"\npose = "number"\n'

TARGETS: tuple[Target, ...] = (
    Target("robot.toml", seeds.robots, _described, (".toml",), share=2.0, named=("robot.toml",)),
    Target("--set", partial(_texts, OVERRIDES), _override, named=("--set",)),
    Target("--over", partial(_texts, OVERS), _over, named=("--over",)),
    Target("URDF", seeds.drawings, _drawn, (".urdf",), share=2.0),
    Target("MJCF", seeds.mjcf_drawings, _drawn, (".xml",), share=2.0),
    Target("model: TOML, URDF, MJCF", _all_drawings, _modelled, seconds=30.0, share=0.3, named=_MECHANISM),
    Target("init: URDF, MJCF", _all_drawings, _proposed, (".urdf", ".xml"), 30.0, 0.1),
    Target("measurement table", _tables, partial(_measured, measured=True, joints=LEGS), share=2.0),
    Target("joints of predict", partial(_tables, "pose", *LEGS), partial(_measured, measured=False, joints=LEGS)),
    Target(
        "poses of compensate",
        partial(_tables, "pose", "qx", "qy", "qz", "qw"),
        partial(_measured, measured=True, joints=()),
    ),
    Target("Motive and Qualisys exports", seeds.exports, _exported),
    Target("column map", lambda: [{"columns.toml": _COLUMNS}], _columns, share=0.5),
    *(Target(f"stream: {name}", files, _logged, named=("/case",)) for name, files in _STREAMS.items()),
    Target("stream with poses: csv", lambda: [{"log.csv": seeds.csv(seeds.stream(400, 8))}], _posed),
    Target("stream with poses: parquet", lambda: [{"log.parquet": seeds.parquet(seeds.stream(400, 8))}], _posed),
    Target("log and commands", _campaign_files, _campaign),
    Target("RAO: csv, parquet", _raos, _rao),
    Target("RAO: MATLAB", lambda: [{"rao.mat": seeds.mss()}], _rao, share=0.5),
    Target("artifact", partial(_artifacts, False), partial(_stored, resealed=False), named=("store",)),
    Target("artifact, sealed again", partial(_artifacts, True), partial(_stored, resealed=True), named=("store",)),
)  # fmt: skip
