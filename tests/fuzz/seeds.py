"""Valid files, small ones, to be spoiled: {name: content}."""

from __future__ import annotations

import io
import tempfile
from datetime import UTC, datetime
from functools import lru_cache, reduce
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from kincal.urdf.description import ROBOTS
from tests.identification.exports import motive, qualisys

Files = dict[str, bytes]
DATA = Path(__file__).parents[1] / "data"
LEGS = ("leg1_slide", "leg2_slide", "leg3_slide")


def robot(folder: Path) -> Files:
    return {f.name: f.read_bytes() for f in sorted(folder.iterdir()) if f.suffix in (".toml", ".urdf", ".xml")}


def robots() -> list[Files]:
    return [robot(ROBOTS / name) for name in ("ups3_s", "ups2_u", "jugglebot", "ur10")]


def drawings() -> list[Files]:
    return [robot(ROBOTS / name) for name in ("ups3_s", "ups2_u", "rps3")] + [robot(DATA / "two_rings")]


def mjcf_drawings() -> list[Files]:
    return [robot(DATA / name) for name in ("ups3_mjcf", "ups3_frame_mjcf")]


def csv(frame: pd.DataFrame) -> bytes:
    return frame.to_csv(index=False).encode()


def parquet(frame: pd.DataFrame) -> bytes:
    sink = io.BytesIO()
    frame.to_parquet(sink, index=False)
    return sink.getvalue()


def measured(n: int = 12) -> pd.DataFrame:
    random = np.random.default_rng(1)
    q = np.column_stack([0.05 * random.normal(size=(n, 3)), np.ones(n)])
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    legs = dict(zip(LEGS, random.uniform(0.42, 0.52, (3, n)), strict=True))
    orientation = dict(zip(("qx", "qy", "qz", "qw"), q.T, strict=True))
    return pd.DataFrame({"pose": np.arange(n), **legs, **orientation, "orientation_std": 1e-5})


def exports() -> list[Files]:
    """Frames of motion capture beside joint values that name their frames, windows of them, or none."""
    table = measured()
    n = len(table)
    frames = table[["qx", "qy", "qz", "qw"]].assign(frame=np.arange(n) + 1.0, t=np.arange(n) / 100, x=0.1, y=0.2, z=0.3)
    joints = table[["pose", *LEGS]]
    windows = joints.assign(t_from=np.arange(n) / 100 - 0.001, t_to=np.arange(n) / 100 + 0.011)
    texts = (
        motive({"platform": frames}),
        motive({"platform": frames}, "Millimeters", "ZYX"),
        qualisys({"platform": frames}),
    )
    return [
        {"take.csv": text.encode(), "joints.csv": csv(rows)}
        for text in texts
        for rows in (joints, joints.assign(frame=np.arange(n) + 1), windows)
    ]


def stream(n: int = 400, poses: int | None = None) -> pd.DataFrame:
    random = np.random.default_rng(2)
    t, pose = np.arange(n) / 50, np.arange(n) * (poses or 0) // n
    at = pose if poses else t
    found = pd.DataFrame({"t": t, "roll": 0.1 * np.sin(at), "pitch": 0.05 * np.cos(at), "yaw": 0.01 * at})
    found[["roll", "pitch", "yaw"]] += 2e-4 * random.normal(size=(n, 3))
    if poses:
        found.insert(1, "pose", pose)
    return found


def merged() -> pd.DataFrame:
    """Topics on one axis of time: attitude, heading and a temperature in rows of their own."""
    whole = stream().drop(columns="yaw")
    heading = pd.DataFrame({"t": whole["t"] + 0.004, "yaw": stream()["yaw"]})
    return pd.concat([whole, heading, pd.DataFrame({"t": whole["t"] + 0.009, "temperature": 21.0})]).sort_values("t")


def dated() -> list[pd.DataFrame]:
    """Streams with time as others write it: the day first, the time of day, two columns, nanoseconds since 1970."""
    moments = pd.Series(pd.to_datetime(1.7e9 + stream()["t"], unit="s"))
    day, clock = moments.dt.strftime("%d.%m.%Y"), moments.dt.strftime("%H:%M:%S.%f")
    times = ({"t": day + " " + clock}, {"t": clock}, {"date": day, "time": clock}, {"t": moments.astype("int64")})
    return [stream().drop(columns="t").assign(**time) for time in times]


def campaign(targets: int = 9, held: float = 7.0, rate: float = 20.0) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A stream and the command log beside it: moves of 1.5 s between targets."""
    random = np.random.default_rng(3)
    joints = random.uniform(0.42, 0.52, (targets, 3))
    sent = held * np.arange(targets) + random.uniform(0, 1, targets)
    t = np.arange(-2, held * (targets + 1), 1 / rate)
    k = np.maximum(np.searchsorted(sent, t, side="right") - 1, 0)
    way = np.clip((t - sent[k]) / 1.5, 0, 1)[:, None]
    there = joints[np.maximum(k - 1, 0)] * (1 - way) + joints[k] * way
    angles = there @ random.uniform(-2, 2, (3, 2)) + 2e-4 * random.normal(size=(len(t), 2))
    log = pd.DataFrame({"t": t + 50, "roll": angles[:, 0], "pitch": angles[:, 1]})
    return log, pd.DataFrame({"t": sent, **dict(zip(LEGS, joints.T, strict=True))})


def sentence(body: str) -> str:
    return f"${body}*{reduce(lambda a, b: a ^ b, body.encode()):02X}"


def nmea_logs() -> list[Files]:
    random = np.random.default_rng(4)
    angles, logs = 5 * random.normal(size=(200, 2)), {}
    clock = [f"{k // 60:02d}{k % 60:02d}" for k in range(200)]
    logs["stamped"] = [
        datetime.fromtimestamp(1.7e9 + k / 10, UTC).isoformat() + " " + sentence(f"PSXN,23,{r:.3f},{p:.3f},{k},0.1")
        for k, (r, p) in enumerate(angles)
    ]
    logs["pashr"] = [
        sentence(f"PASHR,10{at}.00,{k % 360}.00,T,{r:.2f},{p:.2f},0.10,0.02,0.02,0.03,2,1")
        for k, (at, (r, p)) in enumerate(zip(clock, angles, strict=True))
    ]
    logs["tagged"] = []
    for k, (r, p) in enumerate(angles):
        fields = f"s:mru1,c:{1_700_000_000_000 + 100 * k}"
        block = f"\\{fields}*{reduce(lambda a, b: a ^ b, fields.encode()):02X}\\"
        logs["tagged"].append(block + sentence(f"PRDID,{p:.2f},{r:.2f},{k}.0"))
    logs["spread"] = []
    for k, (r, p) in enumerate(angles):
        if k % 10 == 0:
            logs["spread"].append(sentence(f"GPZDA,10{k // 600:02d}{k // 10 % 60:02d}.00,22,11,2026,00,00"))
        logs["spread"] += [sentence(f"HEHDT,{k}.1,T"), sentence(f"IIXDR,A,{p:.2f},D,PITCH,A,{r:.2f},D,ROLL")]
    return [{"log.nmea": "\r\n".join(lines).encode()} for lines in logs.values()]


def bags_without_metadata() -> list[Files]:
    """Folders of a recorder that was killed: their files alone."""
    return [
        {f"log_{k}{end}": content for k in (0, 1) for name, content in bags()[kind].items() if name.endswith(end)}
        for kind, end in (("mcap zstd", ".mcap"), ("mcap", ".mcap"), ("sqlite3", ".db3"))
    ]


@lru_cache
def bags() -> dict[str, Files]:
    """ROS 1 plain and compressed, ROS 2 with sqlite3 and MCAP, an MCAP alone: Imu and Vector3Stamped."""
    return {kind: _bag(kind) for kind in ("ros1", "ros1 bz2", "ros1 lz4", "sqlite3", "mcap", "mcap zstd")}


def _bag(kind: str) -> Files:
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat as Format2
    from rosbags.rosbag2 import CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    ros1 = kind.startswith("ros1")
    types = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / ("log.bag" if ros1 else "bag")
        if ros1:
            writer: Any = Writer1(path)
            if " " in kind:
                writer.set_compression(Writer1.CompressionFormat[kind.split()[1].upper()])
        else:
            plugin = StoragePlugin.SQLITE3 if kind == "sqlite3" else StoragePlugin.MCAP
            writer = Writer2(path, version=9, storage_plugin=plugin)
            if "zstd" in kind:
                writer.set_compression(CompressionMode.MESSAGE, Format2.ZSTD)
        name = "sensor_msgs/msg/Imu" if kind != "mcap" else "geometry_msgs/msg/Vector3Stamped"
        with writer:
            connection = writer.add_connection("/sensor", name, typestore=types)
            serialize = types.serialize_ros1 if ros1 else types.serialize_cdr
            for k in range(60):
                message = _message(types.types, name, 1.7e9 + 0.02 * k, 0.1 * np.sin(k / 9), ros1)
                writer.write(connection, round((1.7e9 + 0.02 * k) * 1e9), bytes(serialize(message, name)))
        return {"log.bag": path.read_bytes()} if ros1 else {f.name: f.read_bytes() for f in sorted(path.iterdir())}


def _message(types: Any, name: str, t: float, angle: float, ros1: bool) -> Any:
    stamp = types["builtin_interfaces/msg/Time"](sec=int(t), nanosec=round((t % 1) * 1e9))
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="sensor", **({"seq": 0} if ros1 else {}))
    vector = types["geometry_msgs/msg/Vector3"]
    if name.endswith("Vector3Stamped"):
        return types[name](header=header, vector=vector(x=angle, y=-angle, z=0.1))
    return types[name](
        header=header,
        orientation=types["geometry_msgs/msg/Quaternion"](x=np.sin(angle / 2), y=0.0, z=0.0, w=np.cos(angle / 2)),
        orientation_covariance=np.zeros(9),
        angular_velocity=vector(x=0.1, y=angle, z=0.0),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(x=0.0, y=0.1, z=9.81),
        linear_acceleration_covariance=np.zeros(9),
    )


def rao() -> pd.DataFrame:
    rows = [(w, d) for w in (0.3, 0.5, 0.8, 1.2) for d in range(0, 181, 45)]
    found = pd.DataFrame(rows, columns=["frequency", "direction_deg"])
    for mode in ("heave", "roll_deg", "pitch_deg"):
        found[mode] = 0.5 / (1 + found["frequency"])
        found[mode.removesuffix("_deg") + "_phase_deg"] = 10.0 * found["frequency"]
    return found


def mss() -> bytes:
    """A vessel structure of the Marine Systems Simulator, compressed as MATLAB writes it."""
    from scipy.io import savemat

    w, headings = np.array([0.3, 0.6, 0.9]), np.deg2rad(np.arange(0, 360, 30.0))
    values = np.empty(6, dtype=object)
    for k in range(6):
        values[k] = np.full((len(w), len(headings), 2), 0.1 * k)
    rao_of = {"amp": values, "phase": values, "w": w}
    sink = io.BytesIO()
    savemat(sink, {"vessel": {"headings": headings, "velocities": [0.0], "motionRAO": rao_of}}, do_compression=True)
    return sink.getvalue()
