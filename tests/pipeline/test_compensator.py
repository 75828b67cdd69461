"""The compensator as C: compiled and called through ctypes, against what the methods say of whole batches."""

import ctypes
import re
import subprocess
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kincal.identification.compiled import build, find_compiler
from kincal.identification.measurements import quaternions
from kincal.pipeline.compensator.code import quoted, sources
from kincal.pipeline.compensator.compensator import Compensator
from kincal.pipeline.compensator.goal import Goal
from kincal.pipeline.compensator.library import (
    BEYOND_LIMITS,
    NOT_CONVERGED,
    OUTSIDE_WORKSPACE,
    Answers,
    Library,
)
from kincal.pipeline.compensator.solver import ModelSolver
from kincal.pipeline.methods.predictors import HybridMethod, ModelMethod
from kincal.urdf.errors import InputError
from kincal.urdf.kinematics import pose_at
from kincal.urdf.rigid_motion import Motion, exp, from_zyx_angles

# robot, method, what is measured (and so desired)
KINDS = {
    "ups3_s, geometric": ("ups3_s", "geometric", ("tilt", "yaw")),
    "ups3_s, hybrid": ("ups3_s", "hybrid", ("tilt", "yaw")),
    "frame loops": ("ups3_frame", "hybrid", ("orientation",)),
    "serial, revolute": ("ur10", "hybrid", ("orientation", "position")),
    "position of a delta": ("linear_delta", "hybrid", ("position",)),
    "tilt alone": ("ups2_u", "hybrid", ("tilt",)),
    "parasitic motion": ("rps3", "geometric", ("tilt", "position")),
}
HYBRID = "ups3_s, hybrid"
STRANGE = ["plain", 'a "quoted" \\ name', "*/ /* // ", "trigraphs ??/ ??'", "é ü 中", "new\nline\ttab", "%s %d", ""]


@dataclass(frozen=True)
class Case:
    """A robot as built with a method, its compensator, and the compiled code."""

    loaded: object
    compensator: Compensator
    channels: tuple[str, ...]
    files: dict[str, str]
    library: Library
    folder: Path

    @property
    def method(self) -> ModelMethod | HybridMethod:
        return self.solver.method

    @property
    def solver(self) -> ModelSolver:
        return self.compensator.solver

    def commanded(self, desired: Motion) -> tuple[np.ndarray, np.ndarray]:
        """By the same steps in batches; which are checked against the method's predictions."""
        commanded = self.solver.commands(desired)
        return commanded.readings, commanded.reached

    def readings(self, n: int, seed: int) -> np.ndarray:
        """Of the workspace: the correction is believed in the middle, fades, and is gone in the corners."""
        return self.loaded.readings(n, seed)

    def apart(self, found: np.ndarray, expected: np.ndarray) -> float:
        return float(np.abs(self.solver.robot.actuators.gain * (found - expected)).max())


@pytest.fixture(scope="session")
def compiler() -> str:
    found = find_compiler()
    if found is None:
        pytest.skip("there is no C compiler here")
    return found


@pytest.fixture(scope="session")
def compensated(robot, correction):
    """compensated(kind): the robot, and the compensator of its method."""

    @cache
    def make(kind: str):
        name, method, channels = KINDS[kind]
        loaded = robot(name)
        p = loaded.random_parameters(3)
        if "tilt" in channels or "yaw" in channels:
            p[-12:] *= 0.5
        refined = p + 0.2 * loaded.random_parameters(4) * np.repeat([1.0, 0.0], [len(p) - 12, 12])
        geometric = ModelMethod(loaded.model.robot(p))
        chosen = geometric
        if method == "hybrid":
            learned = correction(loaded, 1e-4, shrinkage=0.9, hull=0.6)
            chosen = HybridMethod(geometric, loaded.model.robot(refined), learned)
        return loaded, Compensator.of(chosen, channels, loaded.description.workspace)

    return make


@pytest.fixture(scope="session")
def case(compensated, compiler, tmp_path_factory):
    """case(kind): compiled once a session."""

    @cache
    def make(kind: str) -> Case:
        loaded, compensator = compensated(kind)
        files, folder = sources(compensator, "kincal_it", ["test */ ??/"]), tmp_path_factory.mktemp("code")
        chain = compensator.solver.robot.chain
        counts = (len(chain.actuated), chain.n_joints, len(chain.passive))
        library = Library.of(files, "kincal_it", counts, compiler, folder)
        return Case(loaded, compensator, KINDS[kind][2], files, library, folder)

    return make


@pytest.mark.parametrize("kind", KINDS)
def test_commands_are_those_of_the_method(case, kind):
    """Poses that the robot can have, inside the hull, where the correction fades, and outside of it."""
    found = case(kind)
    desired = found.method.predict(found.readings(150, seed=21))
    expected, reached = found.commanded(desired)
    answers = found.library.commands(desired)
    assert reached.all()
    assert answers.found.all()
    assert found.apart(answers.values, expected) < 1e-9
    most = found.compensator.most
    assert answers.iterations.max() <= most.inverse + most.hybrid
    assert (answers.error <= 1e-10).all()
    if KINDS[kind][1] == "hybrid":
        share = found.method.correction.share(expected)
        np.testing.assert_allclose(answers.share, share, atol=1e-6)  # of the step before the last
        assert (share == 0.9).sum() > 3
        assert ((share > 0) & (share < 0.9)).sum() > 3
        if kind != "serial, revolute":
            assert (share == 0).sum() > 0
    else:
        assert (answers.share == 0).all()


@pytest.mark.parametrize("kind", KINDS)
def test_predictions_are_those_of_the_method(case, kind):
    found = case(kind)
    readings = found.readings(100, seed=22)
    answers = found.library.predictions(readings)
    assert answers.found.all()
    expected = found.method.predict(readings)
    same = np.sign(np.sum(quaternions(expected.rotation) * answers.values[:, 3:], axis=1))[:, None]
    np.testing.assert_allclose(answers.values[:, :3], expected.translation, rtol=0, atol=1e-9)
    np.testing.assert_allclose(same * answers.values[:, 3:], quaternions(expected.rotation), rtol=0, atol=1e-9)


@pytest.mark.parametrize("kind", ["tilt alone", "position of a delta", "parasitic motion"])
def test_what_is_not_asked_for_changes_nothing(case, kind):
    """Desired poses spoiled where nobody measured: heading with tilt alone, orientation with positions alone."""
    found = case(kind)
    desired = found.method.predict(found.readings(40, seed=23))
    turn = exp(np.array([0.0, 0.0, 0.4]))
    turned = (
        desired.rotation @ exp(np.array([0.1, 0.2, -0.3])) if kind == "position of a delta" else turn @ desired.rotation
    )
    spoiled = Motion(turned, desired.translation + (0.0 if "position" in found.channels else 0.3))
    answers = found.library.commands(spoiled)
    expected, reached = found.commanded(spoiled)
    assert reached.all()
    assert answers.found.all()
    assert found.apart(answers.values, expected) < 1e-9


def test_batches_without_a_compiler(compensated):
    """The readings at which the poses were predicted; the same with compiled steps."""
    loaded, compensator = compensated(HYBRID)
    solver, readings = compensator.solver, loaded.readings(60, seed=24)
    desired = solver.method.predict(readings)
    found = solver.commands(desired)
    assert found.reached.all()
    np.testing.assert_allclose(found.readings, readings, rtol=0, atol=1e-9)
    again = solver.compiled().commands(desired)
    np.testing.assert_allclose(again.readings, found.readings, rtol=0, atol=1e-13)


# What a controller relies on


def test_poses_out_of_reach(case):
    """Flagged after the fixed number of iterations; nothing is written, and the next call is as good as the first."""
    found = case(HYBRID)
    most = found.compensator.most
    robot = found.solver.robot
    u = np.zeros((3, 6))
    u[:, 3] = [2.6, -2.9, 3.0]
    away = found.library.commands(robot.measured(pose_at(robot.chain, u)))
    garbage = raw_command(found.library, np.zeros(3), np.array([np.nan, 0.0, 0.0, 1.0]))
    zero = raw_command(found.library, np.zeros(3), np.zeros(4))
    for flags, values in ((away.flags[0], away.values[0]), garbage, zero):
        assert flags & 3
        assert np.isnan(values).all()
    assert (away.flags & 3 > 0).all()
    assert away.iterations.max() <= most.inverse + most.hybrid
    good = found.method.predict(found.readings(1, seed=25))
    mixed = Motion(
        np.concatenate([pose_at(robot.chain, u).rotation[:1], good.rotation]),
        np.concatenate([good.translation, good.translation]),
    )
    after = found.library.commands(mixed, warm=True)
    assert after.flags[0] & NOT_CONVERGED
    np.testing.assert_allclose(after.values[1], found.library.commands(good).values[0], rtol=0, atol=1e-10)


def at(array: np.ndarray) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def raw_command(library: Library, position: np.ndarray, quaternion: np.ndarray) -> tuple[int, np.ndarray]:
    """The call as it is, with a quaternion that is none."""
    actuators, joints, passive = library.counts
    state, found = np.zeros(joints + max(passive, 1)), np.full(actuators, np.nan)
    library.handle.kincal_it_start(at(state))
    return library.handle.kincal_it_command(*map(at, (position, quaternion, state, found)), None), found


def test_outside_of_the_workspace_and_of_joint_limits(compiler, tmp_path, case):
    """Such commands are written, and say so."""
    found = case(HYBRID)
    chain, bounds = found.solver.robot.chain, found.compensator.workspace
    u = np.zeros((2, 6))
    u[:, 3] = bounds[0, 1] * np.array([1.0, 1.1]) - [1e-4, 0.0]
    desired = found.solver.robot.measured(pose_at(chain, u))
    flags = found.library.commands(desired).flags
    assert list(flags & OUTSIDE_WORKSPACE) == [0, OUTSIDE_WORKSPACE]
    assert not (flags & BEYOND_LIMITS).any()
    tight = replace(found.solver.robot, chain=replace(chain, upper=np.minimum(chain.upper, chain.home + 0.05)))
    narrow = Compensator.of(ModelMethod(tight), found.channels, found.loaded.description.workspace)
    counts = (len(chain.actuated), chain.n_joints, len(chain.passive))
    library = Library.of(sources(narrow, "kincal_it", ["tight"]), "kincal_it", counts, compiler, tmp_path)
    desired = narrow.solver.method.predict(found.readings(50, seed=26))
    answers = library.commands(desired)
    assert answers.found.all()
    assert library.commands(tight.measured(pose_at(tight.chain, np.zeros((1, 6))))).flags[0] == 0
    joints = tight.close(answers.values).q
    beyond = (joints > tight.chain.upper).any(axis=1)
    np.testing.assert_array_equal(answers.flags & BEYOND_LIMITS > 0, beyond)
    assert 0 < beyond.sum() < 50


@pytest.mark.parametrize("kind", [HYBRID, "serial, revolute"])
def test_a_warm_start_finds_the_same_and_sooner(case, kind):
    """Along a slow path through the workspace; from anywhere else it finds the same, too."""
    found = case(kind)
    low, high = found.readings(2, seed=27)
    path = found.method.predict(low + np.linspace(0, 1, 300)[:, None] * (high - low) * 0.3)
    cold, warm = found.library.commands(path), found.library.commands(path, warm=True)
    assert warm.found.all()
    assert found.apart(warm.values, cold.values) < 1e-9
    assert warm.iterations[1:].mean() < cold.iterations[1:].mean()
    anywhere = found.method.predict(found.readings(100, seed=28))
    cold, warm = found.library.commands(anywhere), found.library.commands(anywhere, warm=True)
    assert warm.found.all()
    assert found.apart(warm.values, cold.values) < 1e-9


def test_no_loop_without_a_bound_and_no_memory(case):
    """In the code itself: loops run to a number or to a length that is passed as one; nothing is allocated or kept."""
    code = re.sub(r"/\*.*?\*/", "", case(HYBRID).files["kincal_it.c"], flags=re.S)
    assert re.findall(r"\bfor \([^;]*;([^;]*);", code)
    for condition in re.findall(r"\bfor \([^;]*;([^;]*);", code):
        assert re.search(r"\b[ik] < (\d+|n)\b", condition), condition
    for call in re.findall(r"\b(?:take)\(([^;]*)\)", code):
        assert call.startswith("double *joints") or re.search(r", \d+$", call.split(")")[0]), call
    assert not re.search(r"\b(while|do|goto|malloc|calloc|realloc|free|alloca|setjmp)\b", code)
    assert set(re.findall(r"#include (\S+)", code)) == {"<math.h>", '"kincal_it.h"'}
    kept = re.findall(r"^static (?!const\b|int \w+\(|double \w+\(|void \w+\().*$", code, flags=re.M)
    assert not kept


def test_two_robots_at_once(case):
    """Calls with states of their own don't know of each other."""
    found = case(HYBRID)
    desired = found.method.predict(found.readings(20, seed=29))
    expected = found.library.commands(desired[:10], warm=True).values
    actuators, joints, passive = found.library.counts
    states = [np.zeros(joints + max(passive, 1)) for _ in range(2)]
    for state in states:
        found.library.handle.kincal_it_start(at(state))
    quaternion = quaternions(desired.rotation)
    for row in range(10):
        for k, state in enumerate(states):
            command = np.zeros(actuators)
            pose = (np.ascontiguousarray(desired.translation[row + 10 * k]), quaternion[row + 10 * k].copy())
            assert not found.library.handle.kincal_it_command(*map(at, pose), at(state), at(command), None) & 3
            if not k:
                np.testing.assert_array_equal(command, expected[row])


def test_the_test_program(case):
    """Poses in, commands out; readings in, poses out; and the time that it takes."""
    found = case(HYBRID)
    readings = found.readings(20, seed=30)
    desired = found.method.predict(readings)
    poses = "\n".join(" ".join(map(repr, map(float, row))) for row in _rows(desired))
    answers: Answers = found.library.commands(desired, warm=True)
    head, *lines = run(found, poses).splitlines()
    assert head == "# leg1_slide leg2_slide leg3_slide flags iterations error share"
    printed = np.array([line.split() for line in lines], dtype=float)
    np.testing.assert_array_equal(printed[:, :3], answers.values)
    np.testing.assert_array_equal(printed[:, 3], answers.flags)
    joints = "\n".join(" ".join(map(repr, map(float, row))) for row in readings)
    printed = np.array([line.split() for line in run(found, joints, "--predict").splitlines()], dtype=float)
    np.testing.assert_array_equal(printed[:, :7], found.library.predictions(readings).values)
    timed = run(found, poses, "--time", "2")
    assert re.match(r"cold [\d.]+ us a command, [\d.]+ iterations, 0 not reached", timed)


def run(found: Case, text: str, *options: str) -> str:
    command = [str(found.folder / "kincal_it"), *options]
    return subprocess.run(command, input=text, capture_output=True, text=True, check=True, timeout=20).stdout


def _rows(pose: Motion) -> np.ndarray:
    return np.column_stack([pose.translation, quaternions(pose.rotation)])


def test_roll_pitch_yaw(case):
    found = case(HYBRID)
    angles = np.random.default_rng(3).uniform(-1.5, 1.5, (20, 3))
    for roll, pitch, yaw in angles:
        quaternion = np.zeros(4)
        found.library.handle.kincal_it_quaternion(*map(ctypes.c_double, (roll, pitch, yaw)), at(quaternion))
        expected = quaternions(from_zyx_angles(np.array([[yaw, pitch, roll]])))[0]
        np.testing.assert_allclose(quaternion * np.sign(quaternion @ expected), expected, atol=1e-14)


def test_any_text_is_safe_in_strings(compiler, tmp_path):
    """Quotes, backslashes, ends of comments, trigraphs, other scripts: printed as they are."""
    prints = "".join(f"fputs({quoted(text)}, stdout); putchar(0);\n" for text in STRANGE)
    (tmp_path / "it.c").write_text(f"#include <stdio.h>\nint main(void) {{\n{prints}return 0; }}\n")
    build(compiler, [tmp_path / "it.c"], tmp_path / "it", "-std=c99", "-Wall", "-Werror")
    said = subprocess.run([tmp_path / "it"], capture_output=True, check=True, timeout=10).stdout
    assert said == b"".join(text.encode() + b"\0" for text in STRANGE)


def test_strange_names_in_comments(compensated, compiler, tmp_path):
    """What the code says of its robot can't end the comment that says it, nor break the code."""
    _, compensator = compensated("ups3_s, geometric")
    chain = compensator.solver.robot.chain
    names = tuple(f'{n} */ "x" ??/' for n in chain.joint_names)
    robot = replace(compensator.solver.robot, chain=replace(chain, joint_names=names))
    solver = replace(compensator.solver, goal=Goal(robot, compensator.solver.goal.asked))
    files = sources(replace(compensator, solver=solver), "kincal_it", STRANGE)
    counts = (len(chain.actuated), chain.n_joints, len(chain.passive))
    library = Library.of(files, "kincal_it", counts, compiler, tmp_path)
    names_in_c = (ctypes.c_char_p * counts[0]).in_dll(library.handle, "kincal_it_names")
    assert [n.decode() for n in names_in_c] == list(robot.chain.actuated_names)


def test_what_does_not_decide_the_tool_is_refused(compensated):
    """3-RPS by its heading alone: neither height nor tilt."""
    loaded, compensator = compensated("parasitic motion")
    with pytest.raises(InputError, match=r"yaw, does not determine"):
        Compensator.of(compensator.solver.method, ("yaw",), loaded.description.workspace)
