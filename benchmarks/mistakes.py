"""Tables with one mistake each: which causes kincal names. `python -m benchmarks.mistakes --tables 300 --clean 600`.

Mistakes are made on the tables themselves, by code of its own. A mistake that hardly raises the misfit is "not seen".
The table in docs/reference/mistakes.md is what this prints.
"""

from __future__ import annotations

import argparse
import re
import time
from collections import Counter, defaultdict
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

import kincal
from kincal.identification.likely_causes import misfit
from kincal.pipeline.interface.fit import measured_table
from kincal.pipeline.run.in_memory import InMemory
from kincal.pipeline.stages.robot_data import Poses
from kincal.urdf.description import ROBOTS, Robot

RAISED = 2.0  # a mistake counts where it makes the misfit so many times larger, and larger than that
SLOW = 20.0  # [s] of an identification that is worth a line
QUATERNION, ANGLES, POSITION = ["qx", "qy", "qz", "qw"], ["rx", "ry", "rz"], ["x", "y", "z"]


@dataclass(frozen=True)
class Case:
    """A table that is to be spoilt."""

    robot: Robot
    table: pd.DataFrame
    random: np.random.Generator

    @property
    def joints(self) -> list[str]:
        return list(self.robot.description.actuated)

    @property
    def measured(self) -> list[str]:
        names = [str(name) for name in self.table]
        return [name for name in names if name not in ("pose", *self.joints) and not name.endswith("_std")]

    def joint(self) -> str:
        return str(self.random.choice(self.joints))

    def rotations(self) -> Rotation:
        return Rotation.from_quat(self.table[QUATERNION])

    def written(self, quaternions: np.ndarray) -> pd.DataFrame:
        return self.table.assign(**dict(zip(QUATERNION, quaternions.T, strict=True)))

    def angles(self, angles: np.ndarray) -> pd.DataFrame:
        table = self.table.drop(columns=QUATERNION)
        return table.assign(**dict(zip(ANGLES, angles.T, strict=True)))


Spoilt = tuple[pd.DataFrame, str]  # and a pattern of what must be named
MISTAKES: dict[str, Callable[[Case], Spoilt]] = {}


def mistake(make: Callable[[Case], Spoilt]) -> Callable[[Case], Spoilt]:
    MISTAKES[make.__name__.replace("_", " ")] = make
    return make


@mistake
def position_unit(case: Case) -> Spoilt:
    name, factor = [("millimetres", 1e3), ("centimetres", 1e2), ("inches", 1 / 0.0254)][case.random.integers(3)]
    return case.table.assign(**{axis: factor * case.table[axis] for axis in POSITION}), f"x, y, z are in {name}"


@mistake
def joint_unit(case: Case) -> Spoilt:
    joint = case.joint()
    sliding = case.robot.description.actuated and joint in _slides(case.robot)
    name, factor = ("millimetres", 1e3) if sliding else ("degrees", 180 / np.pi)
    return case.table.assign(
        **{joint: factor * case.table[joint]}
    ), f"{joint} is in {name}|is it in {'mm' if sliding else 'deg'}"


@mistake
def quaternion_order(case: Case) -> Spoilt:
    return case.written(case.table[["qw", "qx", "qy", "qz"]].to_numpy()), "hold w, x, y, z"


@mistake
def conjugate(case: Case) -> Spoilt:
    return case.written(case.table[QUATERNION].to_numpy() * [-1, -1, -1, 1]), "orientations are inverted"


@mistake
def rotation_vector(case: Case) -> Spoilt:
    return case.angles(case.rotations().as_rotvec()), "rotation vector"


@mistake
def euler_order(case: Case) -> Spoilt:
    order = ["XZY", "YXZ", "YZX", "ZXY", "ZYX"][case.random.integers(5)]
    by_axis = case.rotations().as_euler(order)[:, [order.index(axis) for axis in "XYZ"]]
    return case.angles(by_axis), f"intrinsic {order}"


@mistake
def proper_euler(case: Case) -> Spoilt:
    order = ["ZYZ", "ZXZ"][case.random.integers(2)]
    return case.angles(case.rotations().as_euler(order)), f"Euler angles {order}"


@mistake
def mirrored_axis(case: Case) -> Spoilt:
    axis = POSITION[case.random.integers(3)]
    return case.table.assign(**{axis: -case.table[axis]}), "left-handed"


@mistake
def swapped_axes(case: Case) -> Spoilt:
    a, b = case.random.choice(POSITION, 2, replace=False)
    return case.table.assign(**{a: case.table[b], b: case.table[a]}), "left-handed|are swapped"


@mistake
def swapped_joints(case: Case) -> Spoilt:
    a, b = case.random.choice(case.joints, 2, replace=False)
    pair = f"({a} and {b}|{b} and {a}) are swapped"
    return case.table.assign(**{a: case.table[b], b: case.table[a]}), pair


@mistake
def joint_sign(case: Case) -> Spoilt:
    joint = case.joint()
    return case.table.assign(**{joint: -case.table[joint]}), f"{joint} counts the other way round"


@mistake
def joint_zero(case: Case) -> Spoilt:
    joint = case.joint()
    shift = 0.02 if joint in _slides(case.robot) else np.deg2rad(2)
    return case.table.assign(**{joint: case.table[joint] + shift}), f"{joint} has another zero"


@mistake
def joint_scale(case: Case) -> Spoilt:
    joint = case.joint()
    factor = [2.0, 0.5, 1.05, 0.97][case.random.integers(4)]
    return case.table.assign(**{joint: factor * case.table[joint]}), f"{joint} has another scale"


@mistake
def common_scale(case: Case) -> Spoilt:
    factor = [1.02, 0.97][case.random.integers(2)]
    return case.table.assign(**{j: factor * case.table[j] for j in case.joints}), "all actuators have one wrong scale"


@mistake
def rows_late(case: Case) -> Spoilt:
    late = int(case.random.choice([-2, -1, 1, 2]))
    table = case.table.copy()
    table[case.measured] = table[case.measured].shift(late)
    table = table.dropna().reset_index(drop=True)
    return table, f"measured columns are {abs(late)} rows? {'late' if late > 0 else 'early'}"


@mistake
def pairing_lost(case: Case) -> Spoilt:
    """A measured row is missing: all after it come one too early."""
    n = len(case.table)
    first = int(case.random.integers(n // 4, 3 * n // 4))
    values = case.table[case.measured].to_numpy(float)
    table = _put(case.table, np.arange(n - 1) >= first, case.measured, values[1:], n - 1)
    return table, r"from pose \d+ on the measured columns are 1 row early"


@mistake
def target_turned(case: Case) -> Spoilt:
    wrong = case.random.random(len(case.table)) < 0.15
    wrong[case.random.integers(len(wrong))] = True
    turned = (case.rotations() * Rotation.from_euler("z", 180, degrees=True)).as_quat()
    return _put(case.table, wrong, QUATERNION, turned), _poses(case.table, wrong)


@mistake
def unseen_target(case: Case) -> Spoilt:
    wrong = np.zeros(len(case.table), dtype=bool)
    wrong[case.random.choice(len(wrong), 3, replace=False)] = True
    nothing = np.tile([float(column == "qw") for column in case.measured], (len(wrong), 1))
    return _put(case.table, wrong, case.measured, nothing), _poses(case.table, wrong)


@mistake
def repeated_rows(case: Case) -> Spoilt:
    wrong = np.zeros(len(case.table), dtype=bool)
    first = int(case.random.integers(2, len(wrong) - 5))
    wrong[first : first + 3] = True
    values = case.table[case.measured].to_numpy(float)
    return _put(case.table, wrong, case.measured, np.tile(values[first - 1], (len(wrong), 1))), _poses(
        case.table, wrong
    )


@mistake
def wrong_pose(case: Case) -> Spoilt:
    """One pose of all, by half a degree or a few millimetres."""
    row = int(case.random.integers(len(case.table)))
    table = _moved(case, np.arange(len(case.table)) == row, by_turning="qx" in case.table)
    return table, rf"pose {case.table['pose'].to_numpy()[row]} does not fit"


@mistake
def stuck_encoder(case: Case) -> Spoilt:
    joint, n = case.joint(), len(case.table)
    first = int(case.random.integers(n // 2, n - 6))
    values = case.table[[joint]].to_numpy(float)
    table = _put(case.table, np.arange(n) >= first, [joint], np.full((n, 1), values[first]))
    pose = table["pose"].to_numpy()
    same = int(np.flatnonzero(table[joint].to_numpy() != values[first])[-1]) + 2  # poses on a grid repeat some anyway
    return table, f"{joint} is stuck from pose ({pose[same]}|{pose[first + 1]})"


@mistake
def moved_instrument(case: Case) -> Spoilt:
    """Or the target: by half a degree or a few millimetres."""
    n = len(case.table)
    first = int(case.random.integers(n // 4, 3 * n // 4))
    table = _moved(case, np.arange(n) >= first, by_turning="x" not in case.table)
    pose = case.table["pose"].to_numpy()
    return table, f"moved between poses {pose[first - 1]} and {pose[first]}"


def _moved(case: Case, rows: np.ndarray, by_turning: bool) -> pd.DataFrame:
    """The instrument elsewhere at some rows (n,) bool."""
    direction = case.random.normal(size=3)
    direction /= np.linalg.norm(direction)
    if "roll" in case.table:
        return _put(case.table, rows, ["roll"], case.table[["roll"]].to_numpy() + np.deg2rad(0.5))
    if by_turning:
        turned = Rotation.from_rotvec(np.deg2rad(0.5) * direction) * case.rotations()
        return _put(case.table, rows, QUATERNION, turned.as_quat())
    return _put(case.table, rows, POSITION, case.table[POSITION].to_numpy() + 0.005 * direction)


def _put(
    table: pd.DataFrame, rows: np.ndarray, columns: list[str], values: np.ndarray, first: int | None = None
) -> pd.DataFrame:
    """The table, its `first` rows alone, with values (n, k) in some rows (n,) bool of some columns."""
    table = table.iloc[:first]
    data = table[columns].to_numpy(float, copy=True)
    data[rows] = values[rows]
    return table.assign(**dict(zip(columns, data.T, strict=True)))


def _slides(robot: Robot) -> set[str]:
    model = InMemory(robot.description).result("model")
    chain = model.chain()
    return {n for n, slide in zip(chain.actuated_names, chain.prismatic[chain.actuated], strict=True) if slide}


def _poses(table: pd.DataFrame, wrong: np.ndarray) -> str:
    numbers = table["pose"].to_numpy()[wrong].tolist()
    return "poses? " + ", ".join(map(str, numbers[:6]))


def fitting(name: str, table: pd.DataFrame) -> bool:
    """Whether a mistake can be made in this table."""
    turns = {"quaternion order", "conjugate", "rotation vector", "euler order", "proper euler", "target turned"}
    moves = {"position unit", "mirrored axis", "swapped axes"}
    return not (name in turns and "qx" not in table) and not (name in moves and "x" not in table)


def table_misfit(robot: Robot, table: pd.DataFrame) -> float:
    """Of a robot near its drawing to the table, as `likely_causes` has it; infinite where the table is refused."""
    run = InMemory(robot.description)
    model = run.result("model")
    try:
        run = InMemory(robot.description, {"model": model, "measure": measured_table(robot, model, table)})
        poses = Poses.measured_on(model, run.result("filter"), robot.description)
    except kincal.InputError:
        return np.inf
    return misfit(poses.errors, poses.measurements)


@dataclass(frozen=True)
class Answer:
    """What kincal says of a table."""

    refused: bool
    words: str
    seconds: float

    @property
    def accused(self) -> bool:
        return any(words in self.words for words in ("likely cause", "not fit the others", "left out"))


def answer(robot: Robot, table: pd.DataFrame) -> Answer:
    begin = time.perf_counter()
    try:
        words, refused = "; ".join(kincal.identify(robot, table).findings), False
    except (kincal.InputError, kincal.CalibrationError) as error:
        words, refused = str(error), True
    return Answer(refused, words, time.perf_counter() - begin)


def outcome(robot: Robot, table: pd.DataFrame, spoilt: pd.DataFrame, pattern: str) -> tuple[str, Answer]:
    """named, named with others, a wrong cause, no cause; or not seen, where the misfit is hardly raised."""
    given = answer(robot, spoilt)
    if re.search(pattern, given.words):
        cause = given.words.partition("likely cause: ")[2] or given.words.partition("left out: ")[2]
        return ("named with others" if ", or " in cause else "named"), given
    now = table_misfit(robot, spoilt)
    if now < max(RAISED * table_misfit(robot, table), RAISED):
        return ("a wrong cause" if given.accused else "not seen"), given
    return ("a wrong cause" if given.accused else "no cause"), given


def spoilt_tables(names: list[str], arguments: argparse.Namespace) -> tuple[dict[str, Counter], float]:
    """How often each mistake had which outcome, and the slowest answer [s]."""
    kinds = [name for name in MISTAKES if re.search(arguments.only, name)]
    outcomes: dict[str, Counter] = defaultdict(Counter)
    slowest, k, tables = 0.0, 0, 0
    while tables < arguments.tables:
        random = np.random.default_rng([arguments.seed, k])
        robot = _robot(names[k % len(names)], arguments.poses, arguments.seed + k)
        kind, k = kinds[(k // len(names)) % len(kinds)], k + 1
        table = kincal.measure(robot)
        if not fitting(kind, table):
            continue
        tables += 1
        spoilt, pattern = MISTAKES[kind](Case(robot, table, random))
        how, given = outcome(robot, table, spoilt, pattern)
        outcomes[kind][how] += 1
        slowest = max(slowest, given.seconds)
        if how in ("a wrong cause", "no cause") or given.seconds > SLOW:
            print(f"{robot.description.name:14} {kind:18} {how}, {given.seconds:.1f} s, seed {arguments.seed + k - 1}")
            print(f"     {given.words[:300]}\n     expected: {pattern}", flush=True)
    return outcomes, slowest


def clean_tables(names: list[str], arguments: argparse.Namespace) -> int:
    """How many tables without a mistake are refused, or are said to have one."""
    accused = 0
    for k in range(arguments.clean):
        seed = 5 * arguments.seed + k
        robot = _robot(names[k % len(names)], arguments.poses, seed)
        given = answer(robot, kincal.measure(robot))
        if given.refused or given.accused:
            accused += 1
            print(f"CLEAN {robot.description.name} seed {seed}: {given.words[:330]}", flush=True)
    return accused


def confusion(outcomes: dict[str, Counter]) -> pd.DataFrame:
    columns = ["named", "named with others", "a wrong cause", "no cause", "not seen"]
    frame = pd.DataFrame({kind: [counts[c] for c in columns] for kind, counts in outcomes.items()}, index=columns).T
    frame.loc["all"] = frame.sum()
    return frame


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--tables", type=int, default=60)
    parser.add_argument("--clean", type=int, default=40)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--poses", type=int, default=40)
    parser.add_argument("--only", default="", help="mistakes whose name this expression finds")
    parser.add_argument("--robots", default="", help="names, separated by commas; default: all that are shipped")
    arguments = parser.parse_args()
    names = arguments.robots.split(",") if arguments.robots else _robots()
    outcomes, slowest = spoilt_tables(names, arguments)
    print(confusion(outcomes).to_string())
    accused = clean_tables(names, arguments)
    print(
        f"without a mistake: {accused} of {arguments.clean} refused or accused; slowest identification {slowest:.1f} s"
    )


def _robot(name: str, poses: int, seed: int) -> Robot:
    robot = kincal.load(name, {"plan.poses": poses, "seed": seed})
    measure = robot.description.measure.model_copy(update={"columns": {}})  # tables are in kincal's own columns
    return replace(robot, description=robot.description.model_copy(update={"measure": measure}))


def _robots() -> list[str]:
    return [p.parent.name for p in sorted(ROBOTS.glob("*/robot.toml")) if p.parent.name != "ups3_s_printed"]


if __name__ == "__main__":
    main()
