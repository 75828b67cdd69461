"""Mistakes in measurement tables are named, robots far from their drawing are refused, good ones are left alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from kincal.identification.diagnosis import moved_far, screened
from kincal.identification.error_model import Parameters
from kincal.identification.estimators import estimate_parameters, register
from kincal.identification.measurements import default_channels, to_measurements, to_table
from kincal.identification.summary import summarise
from kincal.pipeline.virtual.robot import VirtualRobot, draw, measure
from kincal.urdf.description import ROBOTS, VirtualErrors
from kincal.urdf.errors import CalibrationError, InputError
from kincal.urdf.rigid_motion import Motion

SIGMA = {"orientation": 1e-5, "tilt": 2e-5, "yaw": 2e-5, "position": 2e-5}
FAR_W = Motion(Rotation.from_rotvec([2.0, -1.0, 1.5]).as_matrix(), np.array([2.0, -1.0, 0.7]))
FAR_T = Motion(Rotation.from_rotvec([-0.5, 1.0, 2.0]).as_matrix(), np.array([0.1, 0.0, 0.3]))
POSE = ("orientation", "position")
LEVEL = ("tilt", "yaw")

# What a message may name. A test gives all that it must; any other one there fails it.
WORDS = {
    "mm": "millimetres, not metres",
    "too small": "a thousand times too small",
    "w, x, y, z": "qx, qy, qz, qw hold w, x, y, z",
    "w, z, y, x": "qx, qy, qz, qw hold w, z, y, x",
    "inverted": "orientations are inverted",
    "pitch": "pitch has the other sign",
    "roll": "roll has the other sign",
    "yaw": "yaw has the other sign",
    "roll-pitch": "roll and pitch are swapped",
    "tilt in degrees": "tilt is in degrees",
    "yaw in degrees": "yaw is in degrees",
    "contradiction": "contradicts",
    "stuck": "is it stuck",
}
LEGS = tuple(f"leg{i}_slide and leg{j}_slide are swapped" for i, j in ((1, 2), (1, 3), (2, 3)))


def registered(model, measured, max_iterations: int):
    """W and T of what passes the screening whole. Raises as both do."""
    screened(model, measured, reject_outliers=False)
    return register(model, measured, max_iterations)


def table(loaded, channels, n: int, seed: int):
    """A good one."""
    noise = np.random.default_rng([seed, 3])
    return loaded.measure(loaded.random_parameters(seed), loaded.readings(n, seed), channels, SIGMA, noise)


def named(message: str) -> set[str]:
    """The mistakes a message names: of swapped joints the sentence, of others the key of WORDS."""
    cause = message.partition("likely cause: ")[2]
    swapped = {c.removeprefix("the columns ") for c in cause.split(", or ") if c.endswith("_slide are swapped")}
    return {key for key, words in WORDS.items() if words in message} | swapped


def refusal(loaded, measured) -> str:
    with pytest.raises(InputError) as caught:
        registered(loaded.model, measured, 300)
    message = str(caught.value)
    assert "\n" not in message
    return message


# A table's mistakes


def times(channel: str, factor):
    return lambda m: m.replaced(**{channel: m.values[channel] * factor})


def quaternion_as(order: str):
    """The file's columns hold `order`; they are read as x, y, z, w."""

    def change(m):
        read = Rotation.from_matrix(m.values["orientation"]).as_quat()[:, ["xyzw".index(c) for c in order]]
        return m.replaced(orientation=Rotation.from_quat(read).as_matrix())

    return change


def transposed(m):
    return m.replaced(orientation=m.values["orientation"].swapaxes(1, 2))


def joints_swapped(i: int, j: int):
    order = {i: j, j: i}
    return lambda m: replace(m, readings=m.readings[:, [order.get(k, k) for k in range(m.readings.shape[1])]])


def tilt_swapped(m):
    return m.replaced(tilt=m.values["tilt"][:, ::-1].copy())


def of_other_poses(channel: str):
    return lambda m: m.replaced(**{channel: np.roll(m.values[channel], 1, axis=0)})


# Some mistakes are one mistake to a W and T that nobody knows:
# - with orientation alone: w-first is an improper rotation of quaternions, so is the inverse; W and T the proper
# - two wrong signs of roll, pitch and yaw are half a turn of W and T; one of the three is like any other
# - legs of ups3_s and rps3 stand 120 degrees apart: two are swapped, and the frames turned
DEGREES = 180 / np.pi
SIGNS = ("pitch", "roll", "yaw")
MISTAKES = {
    "position in mm": ("rps3", POSE, times("position", 1e3), ("mm",)),
    "position in km": ("rps3", POSE, times("position", 1e-3), ("too small",)),
    "w first": ("ups3_s", ("orientation",), quaternion_as("wxyz"), ("w, x, y, z", "inverted")),
    "w first, with position": ("rps3", POSE, quaternion_as("wxyz"), ("w, x, y, z",)),
    "w first, backwards": ("ur10", POSE, quaternion_as("wzyx"), ("w, z, y, x",)),
    "inverted": ("ups3_s", ("orientation",), transposed, ("w, x, y, z", "inverted")),
    "tilt in degrees": ("ups3_s", LEVEL, times("tilt", DEGREES), ("tilt in degrees",)),
    "tilt alone in degrees": ("ups3_s", ("tilt",), times("tilt", DEGREES), ("tilt in degrees",)),
    "yaw in degrees": ("ups3_s", LEVEL, times("yaw", DEGREES), ("yaw in degrees",)),
    "sign of pitch": ("ups3_s", LEVEL, times("tilt", [1, -1]), SIGNS),
    "sign of roll": ("ups3_s", LEVEL, times("tilt", [-1, 1]), SIGNS),
    "sign of yaw": ("ups3_s", LEVEL, times("yaw", -1), SIGNS),
    "roll for pitch": ("ups3_s", LEVEL, tilt_swapped, ("roll-pitch",)),
    "legs 1 and 2": ("ups3_s", ("orientation",), joints_swapped(0, 1), LEGS),
    "legs 1 and 3, tilt alone": ("ups3_s", ("tilt",), joints_swapped(0, 2), LEGS),
    "legs 2 and 3, with position": ("rps3", POSE, joints_swapped(1, 2), LEGS),
}


@pytest.mark.parametrize("name, channels, mistake, causes", MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_named_and_no_other(name, channels, mistake, causes, robot):
    loaded = robot(name)
    good = table(loaded, channels, 6, 1)
    registered(loaded.model, good, 300)
    message = refusal(loaded, mistake(good))
    assert named(message) == set(causes)


@pytest.mark.parametrize(
    "name, channels, wrong, other",
    [
        ("rps3", POSE, "position", "orientation"),
        ("ups3_s", LEVEL, "yaw", "tilt"),
    ],
)
def test_a_sensor_that_contradicts_the_others_is_named(name, channels, wrong, other, robot):
    """Its rows are of the pose before."""
    loaded = robot(name)
    message = refusal(loaded, of_other_poses(wrong)(table(loaded, channels, 10, 1)))
    assert f"likely cause: {wrong} contradicts {other}: without it" in message
    assert named(message) == {"contradiction"}


@pytest.mark.parametrize(
    "channels, mistake",
    [(("orientation",), quaternion_as("wzyx")), (("tilt",), times("tilt", [1, -1])), (LEVEL, times("tilt", -1))],
    ids=["w, z, y, x", "pitch of a robot that may hang head down", "roll and pitch"],
)
def test_what_another_w_and_t_are_is_no_mistake(channels, mistake, robot):
    """The residuals are those of the right table; neither is refused."""
    loaded = robot("ups3_s")
    good = table(loaded, channels, 8, 1)
    wrong = mistake(good)
    right, other = (registered(loaded.model, m, 300) for m in (good, wrong))
    assert other.cost == pytest.approx(right.cost, rel=1e-6)
    assert np.abs((other.p - right.p)[[-9, -8, -7, -3, -2, -1]]).max() > 1.0  # rad: a great turn of W or T


# Poses and sensors that say nothing


def test_poses_that_are_all_the_same_are_refused(robot):
    loaded = robot("ups3_s")
    readings = loaded.readings(2, 1)
    for kept, count in (([0] * 8, "all 8 poses have the same joint values"), ([0, 1] * 4, "8 poses, 2 different")):
        noise = np.random.default_rng(1)
        same = loaded.measure(loaded.random_parameters(1), readings[kept], ("orientation",), SIGMA, noise)
        message = refusal(loaded, same)
        assert message.startswith(f"measurements: {count}")
        assert "they do not excite" in message


@pytest.mark.parametrize("channels", [("orientation",), ("tilt",)])
def test_poses_that_differ_by_noise_are_refused(channels, robot):
    """A hundred thousandth of the workspace is less than the sensor's noise; a hundredth is not."""
    loaded = robot("ups3_s")
    p, readings = loaded.random_parameters(1), loaded.readings(9, 1)
    for spread, refused in ((1e-5, True), (1e-2, False)):
        near = readings[:1] + spread * (readings - readings[:1])
        measured = loaded.measure(p, near, channels, SIGMA, np.random.default_rng(1))
        if refused:
            assert "no more than the sensors' noise: they do not excite" in refusal(loaded, measured)
        else:
            registered(loaded.model, measured, 300)


@pytest.mark.parametrize(
    "name, channels, stuck",
    [
        ("ups3_s", ("orientation",), "orientation"),
        ("ups3_s", LEVEL, "tilt"),
        ("ups3_s", LEVEL, "yaw"),
        ("rps3", POSE, "position"),
        ("rps3", POSE, "orientation"),
    ],
)
def test_a_stuck_sensor_is_named(name, channels, stuck, robot):
    loaded = robot(name)
    measured = table(loaded, channels, 8, 1)
    same = np.repeat(measured.values[stuck][:1], 8, axis=0)
    message = refusal(loaded, measured.replaced(**{stuck: same}))
    assert message == f"measurements: {stuck} is the same at every pose, though the robot moves: is it stuck?"


# Parameters that moved far


def named_parameters(*names: str) -> tuple[Parameters, np.ndarray]:
    """Of tolerance 0.3 mm, 0.05 deg or 1e-3, and W and T behind; and sigmas of a tenth of that."""
    frames = tuple(f"{f}.{c}" for f in ("instrument", "target") for c in ("x", "y", "z", "rx", "ry", "rz"))
    tolerance = {"zero": 3e-4, "gain": 1e-3, "x": 3e-4, "ry": np.deg2rad(0.05)}
    unit = {"zero": "m", "gain": "m/reading", "x": "m", "ry": "rad"}
    what = [n.rpartition(".")[2] for n in names]
    sigma = np.array([tolerance[w] for w in what] + [np.inf] * 12)
    units = tuple(unit[w] for w in what) + ("m", "m", "m", "rad", "rad", "rad") * 2
    return Parameters((*names, *frames), units, np.zeros(len(sigma)), sigma), 0.1 * np.append(sigma[:-12], [1e-6] * 12)


KINDS = {
    "leg.zero": ("+1.5 mm", "check whether it was homed where actuator.leg.zero says"),
    "leg.gain": ("+5 mm/reading", "check actuator.leg.gain and the unit of the readings"),
    "platform.x": ("+1.5 mm", "whether tolerance.position_mm is too small"),
    "platform.ry": ("+0.25 deg", "whether tolerance.rotation_deg is too small"),
}


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", KINDS)
def test_four_tolerances_are_flagged_and_twelve_refused(name, sign, robot):
    parameters, std = named_parameters("first.x", name, "last.gain")
    p = np.zeros(len(std))
    p[-12:] = 3.0  # W and T may be anywhere
    size, cause = KINDS[name]

    def moved(tolerances: float) -> np.ndarray:
        p[1] = sign * tolerances * parameters.tolerance[1]
        return p

    assert moved_far(parameters, moved(3.9), std) == ()
    for tolerances in (4.1, 11.9):
        (finding,) = moved_far(parameters, moved(tolerances), std)
        assert finding.startswith(f"{name} moved by {tolerances} tolerances (")
        assert finding.endswith(cause)
    (finding,) = moved_far(parameters, moved(5), std)
    assert (size if sign > 0 else size.replace("+", "-")) in finding
    with pytest.raises(CalibrationError) as caught:
        moved_far(parameters, moved(12.1), std)
    message = str(caught.value)
    assert message.startswith(f"identification is refused: {name} moved by 12.1 tolerances (")
    assert f"{cause}; allowed are 12 tolerances" in message
    assert "\n" not in message


def test_the_parameter_that_moved_farthest_comes_first():
    parameters, std = named_parameters("a.x", "b.zero", "c.gain")
    p = np.concatenate([[-5, 7, 3] * parameters.tolerance[:3], np.zeros(12)])
    assert [said.split()[0] for said in moved_far(parameters, p, std)] == ["b.zero", "a.x"]
    with pytest.raises(CalibrationError, match=r"refused: a\.x moved by 50\.0 tolerances"):
        moved_far(parameters, p * [10, 2, 1, *[1] * 12], std)


def test_a_parameter_that_is_hardly_told_is_the_estimators_fault():
    parameters, std = named_parameters("a.zero")
    std[0] = 3 * parameters.tolerance[0]
    (finding,) = moved_far(parameters, np.append(5 * parameters.tolerance[0], np.zeros(12)), std)
    assert "determine it to 3.0 tolerances only; estimator = 'map'" in finding
    assert "homed" not in finding


GAIN = "check actuator.{}.gain and the unit of the readings"
HOMED = "check whether it was homed where actuator.{}.zero says"


def fitted(loaded, measured):
    """What the pipeline's stage does: its Identification."""
    start = registered(loaded.model, measured, 300)
    return summarise(loaded.model, measured, estimate_parameters(loaded.model, measured, None, start), start)


def far_off(loaded, channels, name: str, tolerances: float):
    """Measurements of an else good robot, one of whose parameters is so many tolerances off."""
    p = loaded.random_parameters(5, 0.3)
    j = loaded.model.parameters.names.index(name)
    p[j] = tolerances * loaded.model.parameters.tolerance[j]
    return loaded.measure(p, loaded.readings(25, 5), channels, SIGMA, np.random.default_rng(1))


@pytest.mark.parametrize(
    "name, channels, joint, what, flagged, refused, cause",
    [
        ("ups3_s", ("orientation",), "leg2_slide", "gain", 12, 30, GAIN),  # a share of 0.6 is told from others
        ("ur10", POSE, "elbow_joint", "gain", 7, 20, GAIN),  # nearly all of it
        ("ur10", POSE, "elbow_joint", "zero", 20, None, HOMED),  # a third: placements turn as it does
    ],
)
def test_a_robot_far_from_its_drawing(name, channels, joint, what, flagged, refused, cause, robot):
    loaded, parameter = robot(name), f"{joint}.{what}"
    assert not any("moved by" in said for said in fitted(loaded, far_off(loaded, channels, parameter, 1)).findings)
    said = [f for f in fitted(loaded, far_off(loaded, channels, parameter, flagged)).findings if "moved by" in f]
    (mine,) = [f for f in said if f.startswith(f"{parameter} moved by ")]
    assert mine.endswith(cause.format(joint))
    if what == "gain":  # nothing else does what it does
        assert said == [mine]
        with pytest.raises(CalibrationError) as caught:
            fitted(loaded, far_off(loaded, channels, parameter, refused))
        assert f"refused: {parameter} moved by" in str(caught.value)
        assert f"{cause.format(joint)}; allowed are 12 tolerances" in str(caught.value)


# No false alarm

SHIPPED = sorted(p.name for p in ROBOTS.iterdir() if (p / "robot.toml").is_file() and p.name != "ups3_s_printed")
GOOD = [
    *((name, None, 20, 0, False) for name in SHIPPED),
    *(("ups3_s", ("orientation",), 20, seed, False) for seed in range(1, 5)),
    *(("ups3_s", ("orientation",), 20, seed, True) for seed in range(5, 8)),
    *(("ups3_s", ("orientation",), 6, seed, False) for seed in range(8, 11)),
    *(("ups3_s", ("tilt",), 20, seed, seed > 13) for seed in range(11, 15)),
    *(("ups3_s", ("tilt",), 6, seed, False) for seed in range(15, 17)),
    *(("ups3_s", LEVEL, 6, seed, seed > 18) for seed in range(17, 20)),
    *(("rps3", POSE, 6, seed, seed > 20) for seed in range(20, 22)),
    *(("ur10", POSE, n, n, n > 6) for n in (6, 12)),
]


@pytest.mark.parametrize("name, channels, n, seed, far", GOOD)
def test_good_robots_are_left_alone(name, channels, n, seed, far, robot):
    """All errors on, legs that give and screws among them; sensors as shipped; W and T near or of any size."""
    loaded = robot(name)
    chain, sensor = loaded.chain, loaded.description.sensor
    channels = channels or loaded.description.measure.channels or default_channels(chain.tool_axes)
    errors = VirtualErrors()
    assert errors.geometric
    assert errors.elastic
    assert errors.screw
    truth = draw(loaded.model, errors, seed)
    if far:
        truth = replace(truth, p=loaded.model.with_frames(truth.p, FAR_W, FAR_T))
    readings = loaded.readings(n, seed)
    pose = VirtualRobot.of(loaded.model, truth).pose(readings)
    columns = to_table(chain.actuated_names, readings, measure(pose, channels, sensor, seed))
    measured = to_measurements(columns, chain.actuated_names, sensor)
    assert not any("moved by" in said for said in fitted(loaded, measured).findings)


def test_a_good_registration_is_the_estimators_own(robot):
    loaded = robot("ups3_s")
    measured = table(loaded, ("orientation",), 8, 1)
    np.testing.assert_array_equal(registered(loaded.model, measured, 300).p, register(loaded.model, measured, 300).p)


def test_poses_too_few_are_refused_as_ever(robot):
    loaded = robot("ups3_s")
    assert "2 poses can't register W and T" in refusal(loaded, table(loaded, ("orientation",), 2, 1))
