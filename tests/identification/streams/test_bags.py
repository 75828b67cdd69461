"""ROS bags and MCAP by rosbags' own writers, attitudes by scipy."""

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from kincal.identification.streams.reading import read_log
from kincal.urdf.description import Log, Measure
from kincal.urdf.errors import InputError

RANDOM = np.random.default_rng(4)
ANGLES = RANDOM.uniform(-0.5, 0.5, (60, 3))  # roll, pitch, yaw
T = 1.7e9 + 0.02 * np.arange(60)
GRAVITY = 9.81
IMU, VECTOR = "sensor_msgs/msg/Imu", "geometry_msgs/msg/Vector3Stamped"
KINDS = ("ros1", "sqlite3", "mcap")


def header(types, t: float, ros1: bool):
    stamp = types["builtin_interfaces/msg/Time"](sec=int(t), nanosec=round((t % 1) * 1e9))
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id="sensor", **({"seq": 0} if ros1 else {}))


def imu(types, t, angles, ros1, oriented=True):
    vector, rotation = types["geometry_msgs/msg/Vector3"], Rotation.from_euler("ZYX", angles[::-1])
    x, y, z, w = rotation.as_quat() if oriented else (0.0, 0.0, 0.0, 1.0)
    up = rotation.inv().apply([0.0, 0.0, GRAVITY])  # what an accelerometer at rest reads
    unknown = np.zeros(9)
    if not oriented:
        unknown[0] = -1
    return types[IMU](
        header=header(types, t, ros1),
        orientation=types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        orientation_covariance=unknown,
        angular_velocity=vector(x=0.1, y=angles[0], z=angles[1]),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(*up),
        linear_acceleration_covariance=np.zeros(9),
    )


def vector(types, t, angles, ros1):
    return types[VECTOR](header=header(types, t, ros1), vector=types["geometry_msgs/msg/Vector3"](*angles))


def bag(folder, kind, topics):
    """A bag with {topic: (message type, messages)}; messages: a function of the types and whether it is ROS 1."""
    ros1 = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    path = folder / ("log.bag" if ros1 else kind)
    storage = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    with Writer1(path) if ros1 else Writer2(path, version=9, storage_plugin=storage) as writer:
        for topic, (name, make) in topics.items():
            connection = writer.add_connection(topic, name, typestore=store)
            serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
            for t, message in zip(T, make(store.types, ros1), strict=True):
                writer.write(connection, round(t * 1e9), bytes(serialize(message, name)))
    return path


def imus(oriented=True):
    return lambda types, ros1: [imu(types, t, a, ros1, oriented) for t, a in zip(T, ANGLES, strict=True)]


def vectors(scale=1.0):
    return lambda types, ros1: [vector(types, t, scale * a, ros1) for t, a in zip(T, ANGLES, strict=True)]


def logged(file, columns=None, **log):
    return read_log(file, Measure(streams=file, table="joints.csv", columns=columns or {}, log=Log(**log)))


@pytest.mark.parametrize("kind", KINDS)
def test_imu(kind, tmp_path):
    """Attitude against scipy's Euler angles, rates and accelerations as they were written."""
    samples, health = logged(bag(tmp_path, kind, {"/imu": (IMU, imus())}))
    np.testing.assert_allclose(samples["t"], T, atol=1e-6)
    np.testing.assert_allclose(samples[["roll", "pitch", "yaw"]], ANGLES, atol=1e-12)
    np.testing.assert_allclose(samples[["gyro_y", "gyro_z"]], ANGLES[:, :2])
    np.testing.assert_allclose(np.linalg.norm(samples[["acc_x", "acc_y", "acc_z"]], axis=1), GRAVITY)
    assert (health.read, health.samples) == (60, 60)
    assert health.lines() == ("channel 'gyro_x' never changes",)


@pytest.mark.parametrize("kind", KINDS)
def test_imu_without_an_orientation(kind, tmp_path):
    """Tilt from gravity, no yaw."""
    samples, _ = logged(bag(tmp_path, kind, {"/imu": (IMU, imus(oriented=False))}))
    np.testing.assert_allclose(samples[["roll", "pitch"]], ANGLES[:, :2], atol=1e-12)
    assert "yaw" not in samples


@pytest.mark.parametrize("kind", KINDS)
def test_vectors(kind, tmp_path):
    """Radians in x and y; and degrees in others by a column map."""
    path = bag(tmp_path, kind, {"/tilt": (VECTOR, vectors(180 / np.pi))})
    columns = {name: {"from": axis, "unit": "deg"} for name, axis in zip(("roll", "pitch", "yaw"), "xyz", strict=True)}
    samples, _ = logged(path, columns)
    np.testing.assert_allclose(samples[["roll", "pitch", "yaw"]], ANGLES, atol=1e-12)
    plain, _ = logged(path)
    np.testing.assert_allclose(plain[["roll", "pitch"]], np.rad2deg(ANGLES[:, :2]), atol=1e-12)
    assert "yaw" not in plain
    with pytest.raises(InputError, match=r"measure\.columns\.roll: found 'w'; of a Vector3Stamped allowed are x, y, z"):
        logged(path, {"roll": "w"})


def test_a_single_mcap_file(tmp_path):
    path = next(bag(tmp_path, "mcap", {"/imu": (IMU, imus())}).glob("*.mcap"))
    samples, health = logged(path)
    assert (len(samples), health.format) == (60, "bag")


def test_the_topic_is_chosen(tmp_path):
    path = bag(tmp_path, "sqlite3", {"/imu": (IMU, imus()), "/tilt": (VECTOR, vectors())})
    with pytest.raises(InputError, match=r"topics /imu, /tilt all fit; set measure\.log\.topic"):
        logged(path)
    assert "acc_x" not in logged(path, topic="/tilt")[0]
    with pytest.raises(InputError, match=r"topic '/other' is none of sensor_msgs"):
        logged(path, topic="/other")


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_bag_is_read_or_refused(kind, tmp_path):
    """Bytes flipped, ends cut off: samples that add up, or an InputError; nothing else."""
    path = bag(tmp_path, kind, {"/imu": (IMU, imus())})
    file = path if kind == "ros1" else next(f for f in path.iterdir() if f.suffix in (".db3", ".mcap"))
    content, random = file.read_bytes(), np.random.default_rng(1)
    for cut in (len(content), len(content) // 2, 40):
        for _ in range(12):
            damaged = bytearray(content[:cut])
            for k in random.integers(0, len(damaged), 20):
                damaged[k] = random.integers(0, 256)
            file.write_bytes(damaged)
            try:
                samples, health = logged(path)
            except InputError:
                continue
            assert len(samples) <= health.samples <= health.read
