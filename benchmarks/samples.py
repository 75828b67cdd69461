"""The sample files of docs/samples: a measurement table, and one campaign's log as NMEA 0183 and as a ROS 2 bag.

`python -m benchmarks.samples` writes them. All are made of a virtual 3-UPS/S with errors that kincal knows.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from pathlib import Path

import numpy as np
import pandas as pd
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

import kincal

ROBOT, FOLDER = "ups3_s", Path(__file__).parents[1] / "docs" / "samples"
JOINTS = ["leg1_slide", "leg2_slide", "leg3_slide"]
OFFSET_S = 900.0  # of the sensor's clock, ahead of the controller's
TRAVEL_S = 1.5  # between two poses
VECTOR = "geometry_msgs/msg/Vector3Stamped"


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    poses = kincal.measure(kincal.load(ROBOT, {"plan.poses": 40, "measure.channels": ["orientation"]}), seed=11)
    poses.round(9).to_csv(FOLDER / "poses.csv", index=False)
    noiseless = {"plan.poses": 20, "plan.layout": "random", "measure.channels": ["orientation"]}
    table = kincal.measure(kincal.load(ROBOT, noiseless | {"sensor.orientation_deg": 1e-9}), seed=12)
    log, commands = campaign(tilts(table), np.full(len(table), 6.0), rate_hz=10.0, noise_deg=0.01)
    commands.round(6).to_csv(FOLDER / "commands.csv", index=False)
    as_nmea(log, FOLDER)
    as_bag(log, FOLDER)
    for file in sorted(f for f in FOLDER.rglob("*") if f.is_file()):
        print(f"{file.relative_to(FOLDER.parents[1])}: {file.stat().st_size / 1e3:.0f} kB")


def tilts(table: pd.DataFrame) -> pd.DataFrame:
    """The table with roll and pitch [rad] as an inclinometer on the platform shows them."""
    angles = Rotation.from_quat(table[["qx", "qy", "qz", "qw"]]).as_euler("ZYX")
    return table.assign(roll=angles[:, 2], pitch=angles[:, 1])


def campaign(
    table: pd.DataFrame, held_s: np.ndarray, rate_hz: float, noise_deg: float, seed: int = 3
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """The log (t, roll, pitch) of a sensor on the robot as it goes through its poses, and the log of commands."""
    random = np.random.default_rng(seed)
    begins = np.concatenate([[0.0], np.cumsum(held_s + TRAVEL_S)[:-1]])
    t = np.arange(-3.0, begins[-1] + TRAVEL_S + held_s[-1], 1 / rate_hz)
    k = np.maximum(np.searchsorted(begins, t, side="right") - 1, 0)
    way = np.clip((t - begins[k]) / TRAVEL_S, 0, 1)[:, None]
    angles = table[["roll", "pitch"]].to_numpy()
    before = angles[np.maximum(k - 1, 0)]
    read = before + (angles[k] - before) * way**2 * (3 - 2 * way)
    read = read + np.deg2rad(noise_deg) * random.normal(size=read.shape)
    log = pd.DataFrame({"t": t + OFFSET_S, "roll": read[:, 0], "pitch": read[:, 1]})
    return log, pd.DataFrame({"t": begins, **{name: table[name] for name in JOINTS}})


def as_csv(log: pd.DataFrame, folder: Path) -> Path:
    log.to_csv(folder / "log.csv", index=False)
    return folder / "log.csv"


def as_nmea(log: pd.DataFrame, folder: Path) -> Path:
    """PRDID: pitch positive bow up, then roll; two sentences of a hundred are spoiled on the way."""
    lines = []
    for k, (t, roll, pitch) in enumerate(np.column_stack([log["t"], np.rad2deg(log[["roll", "pitch"]])])):
        body = f"PRDID,{-pitch:.5f},{roll:.5f},0.0"
        check = reduce(lambda a, b: a ^ b, body.encode()) ^ (k % 50 == 7)
        lines.append(f"{t:.3f} ${body}*{check:02X}")
    (folder / "log.nmea").write_text("\n".join(lines))
    return folder / "log.nmea"


def as_bag(log: pd.DataFrame, folder: Path) -> Path:
    """A ROS 2 bag of Vector3Stamped messages: x is roll, y is pitch [rad]."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    types = store.types
    with Writer(folder / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection("/tilt", VECTOR, typestore=store)
        for t, roll, pitch in log.to_numpy():
            stamp = types["builtin_interfaces/msg/Time"](sec=int(t), nanosec=round((t % 1) * 1e9))
            header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="")
            message = types[VECTOR](header=header, vector=types["geometry_msgs/msg/Vector3"](x=roll, y=pitch, z=0.0))
            writer.write(connection, round(t * 1e9), bytes(store.serialize_cdr(message, VECTOR)))
    return folder / "bag"


FORMATS: tuple[Callable[[pd.DataFrame, Path], Path], ...] = (as_csv, as_nmea, as_bag)

if __name__ == "__main__":
    main()
