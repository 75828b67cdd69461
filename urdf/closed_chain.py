"""URDF or MJCF + loop closures -> ClosedChain: the pinocchio model, its constraint models, joint and frame indexes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - a wheel without stubs

from kincal.urdf.description import Loop, Mechanism, Workspace, nearest
from kincal.urdf.drawing import BASE, Drawing, DrawnLoop, parse
from kincal.urdf.errors import InputError, quoted
from kincal.urdf.mjcf import read_mjcf
from kincal.urdf.rigid_motion import Motion
from kincal.urdf.urdf_tree import read_urdf


@dataclass(frozen=True)
class LoopClosure:
    """Two frames that meet. Its frames' placements stand in the chain's geometry, behind the joints'."""

    name: str
    kind: str  # point or frame
    frames: tuple[str, str]
    joints: tuple[int, int]  # the joint that carries each frame; BASE for none
    bodies: tuple[int, int]  # rows of each frame in the chain's `rotation` and `translation`

    @property
    def rows(self) -> int:
        return 3 if self.kind == "point" else 6


@dataclass(frozen=True)
class ClosedChain:
    """A robot with closed kinematic loops (or none): structure, geometry and a home configuration.

    Joint values are q: (n, n_joints) [rad or m], one number a joint, in pinocchio's order. `rotation` (n_bodies, 3, 3)
    and `translation` (n_bodies, 3) [m] are the placement of every joint in its parent joint's frame, followed by the
    two frames of every loop in the frames of the joints that carry them. Changing them (`with_geometry`) is what
    turns the robot as drawn into the robot as built.
    """

    model: pin.Model
    joint_names: tuple[str, ...]
    parents: tuple[int, ...]
    axes: np.ndarray  # (n_joints, 3), in the joint's frame
    prismatic: np.ndarray  # (n_joints,) bool
    lower: np.ndarray  # (n_joints,) [rad or m]
    upper: np.ndarray
    rotation: np.ndarray
    translation: np.ndarray
    loops: tuple[LoopClosure, ...]
    actuated: np.ndarray  # (n_actuated,) joint indexes, in the description's order
    base: Motion  # of the base frame in the world
    tool_joint: int
    tool: Motion  # of the tool frame in its joint's frame
    tool_axes: tuple[int, ...]  # of (x, y, z, rx, ry, rz): the degrees of freedom that inverse kinematics solves
    drawn: np.ndarray  # (n_joints,) the configuration that the file shows: 0 in a URDF, `ref` in an MJCF
    home: np.ndarray  # (n_joints,) a configuration that closes the loops (a first guess before `kinematics.at_home`)
    home_pose: Motion  # of the tool in the base frame: the origin of the tool coordinates

    @property
    def n_joints(self) -> int:
        return len(self.joint_names)

    @property
    def passive(self) -> np.ndarray:
        return np.setdiff1d(np.arange(self.n_joints), self.actuated)

    @property
    def n_equations(self) -> int:
        return sum(loop.rows for loop in self.loops)

    @property
    def actuated_names(self) -> tuple[str, ...]:
        return tuple(self.joint_names[j] for j in self.actuated)

    @property
    def body_names(self) -> tuple[str, ...]:
        """One name a placement: the joint's, or loop.frame."""
        frames = (f"{loop.name}.{frame}" for loop in self.loops for frame in loop.frames)
        return (*self.joint_names, *frames)

    def path(self, joint: int) -> list[int]:
        """The joints from the base to `joint`, both included."""
        path = []
        while joint != BASE:
            path.append(joint)
            joint = self.parents[joint]
        return path[::-1]

    def with_geometry(self, rotation: np.ndarray, translation: np.ndarray) -> ClosedChain:
        """The same structure with other placements: rotation (n_bodies, 3, 3), translation (n_bodies, 3) [m]."""
        return replace(self, rotation=rotation, translation=translation)

    def pinocchio_model(self) -> tuple[pin.Model, list]:
        """A pinocchio model with this geometry, and a constraint model for each loop."""
        model = self.model.copy()
        for j in range(self.n_joints):
            model.jointPlacements[j + 1] = pin.SE3(self.rotation[j], self.translation[j])
        kinds = {"point": pin.PointAnchorConstraintModel, "frame": pin.FrameAnchorConstraintModel}
        constraints = []
        for loop in self.loops:
            placed = []
            for joint, body in zip(loop.joints, loop.bodies, strict=True):
                placed += [joint + 1, pin.SE3(self.rotation[body], self.translation[body])]
            constraints.append(kinds[loop.kind](model, *placed))
        return model, constraints


_NUMBERS = ("xyz", "rpy", "value", "lower", "upper")  # attributes; a name may be anything


def load_drawing(text: str, file: Path) -> Drawing:
    """The text of a URDF or an MJCF as a drawing; `file` is where it came from, for messages."""
    root = parse(text, file)
    if root.tag == "mujoco":
        return read_mjcf(root, file)
    if any("xacro" in str(e.tag) or any("${" in e.get(key, "") for key in _NUMBERS) for e in root.iter()):
        raise InputError(f"{file}: it is a xacro file; expand it first, as `xacro robot.urdf.xacro > robot.urdf` does")
    if root.tag != "robot":
        raise InputError(f"{file}: the root element is <{root.tag}>; allowed are <robot> (URDF) and <mujoco> (MJCF)")
    return read_urdf(root, text, file)


def load_chain(mechanism: Mechanism, text: str, file: Path) -> ClosedChain:
    """The chain of a mechanism and the text of its URDF or MJCF; `file` is where that came from, for messages.

    Its home is a first guess, the file's own configuration moved into the joint limits: see `kinematics.at_home`.
    Raises InputError for a file that can't be read, and for names that don't exist or are ambiguous.
    """
    drawing = load_drawing(text, file)
    model = drawing.model
    names = tuple(model.names[1:])
    axes, prismatic = _axes(model)
    joint_index = {name: i for i, name in enumerate(names)}
    for name in mechanism.actuated:
        if name not in joint_index:
            raise InputError(
                f"actuated: joint {quoted(name)} is not among the moving joints of {file}; {nearest(name, names)}"
            )
    base = _frame(model, mechanism.base_frame, "base_frame", file)
    if base[0] != BASE:
        problem = f"{quoted(mechanism.base_frame)} moves with joint {quoted(names[base[0]])} of {file}"
        raise InputError(f"base_frame: {problem}; allowed is a frame that is fixed")
    tool = _frame(model, mechanism.tool_frame, "tool_frame", file)
    lower, upper = _limits(model)
    for j in np.flatnonzero(lower > upper):
        problem = f"[{lower[j]:.6g}, {upper[j]:.6g}]"
        raise InputError(f"{file}: joint {quoted(names[j])}: its limits are {problem}; allowed is the lower one first")
    drawn = drawing.configuration
    placements = [Motion(m.rotation.copy(), m.translation.copy()) for m in list(model.jointPlacements)[1:]]
    loops = []
    for loop in _loops(drawing, mechanism, file):
        first = len(placements)
        loops.append(LoopClosure(loop.name, loop.kind, loop.frames, loop.joints, (first, first + 1)))
        placements += loop.placements
    return ClosedChain(
        model=model,
        joint_names=names,
        parents=tuple(model.parents[i] - 1 for i in range(1, model.njoints)),
        axes=axes,
        prismatic=prismatic,
        lower=lower,
        upper=upper,
        rotation=np.stack([p.rotation for p in placements]),
        translation=np.stack([p.translation for p in placements]),
        loops=tuple(loops),
        actuated=np.array([joint_index[n] for n in mechanism.actuated]),
        base=base[1],
        tool_joint=tool[0],
        tool=tool[1],
        tool_axes=_tool_axes(mechanism.workspace),
        drawn=drawn,
        home=_first_guess(drawn, lower, upper),
        home_pose=Motion.identity(),
    )


def _first_guess(drawn: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> np.ndarray:
    """The drawn configuration where the limits allow it; else their middle, or the one that is finite."""
    nearest_allowed = np.clip(drawn, lower, upper)
    bounded = np.isfinite(lower) & np.isfinite(upper)
    middle = 0.5 * (np.where(bounded, lower, 0) + np.where(bounded, upper, 0))
    return np.where(bounded & (nearest_allowed != drawn), middle, nearest_allowed)


def _tool_axes(workspace: Workspace) -> tuple[int, ...]:
    return tuple(
        ["xyz".index(a) for a in workspace.translation_mm] + [3 + "xyz".index(a) for a in workspace.rotation_deg]
    )


def _loops(drawing: Drawing, mechanism: Mechanism, file: Path) -> list[DrawnLoop]:
    """The loops that the file closes, then those of robot.toml."""
    loops = [*drawing.loops, *(_closure(drawing.model, loop, file) for loop in mechanism.loop)]
    for k, loop in enumerate(loops):
        if loop.name in {other.name for other in loops[:k]}:
            raise InputError(f"loop {quoted(loop.name)}: {file} closes a loop of that name itself; name it otherwise")
        if loop.joints[0] == loop.joints[1]:
            raise InputError(f"loop {quoted(loop.name)}: both frames sit on one body of {file}; it closes nothing")
    return loops


def _closure(model: pin.Model, loop: Loop, file: Path) -> DrawnLoop:
    if loop.frames[0] == loop.frames[1]:
        both = f"both frames are {quoted(loop.frames[0])}"
        raise InputError(f"loop {quoted(loop.name)}: {both}; allowed are two different ones")
    first, second = (_frame(model, frame, f"loop {quoted(loop.name)}", file) for frame in loop.frames)
    return DrawnLoop(loop.name, loop.kind, loop.frames, (first[0], second[0]), (first[1], second[1]))


def _frame(model: pin.Model, name: str, field: str, file: Path) -> tuple[int, Motion]:
    """The joint that carries a frame (BASE for none), and the frame's placement in that joint's frame."""
    frames = [f for f in model.frames if f.name == name and f.type != pin.FrameType.JOINT]
    if len(frames) > 1:
        raise InputError(f"{field}: {file} has {len(frames)} frames called {quoted(name)}; their names must differ")
    if not frames:
        legal = [f.name for f in model.frames if f.name != "universe"]
        raise InputError(f"{field}: frame {quoted(name)} is not in {file}; {nearest(name, legal)}")
    placement = frames[0].placement
    return frames[0].parentJoint - 1, Motion(placement.rotation.copy(), placement.translation.copy())


def _axes(model: pin.Model) -> tuple[np.ndarray, np.ndarray]:
    """Every joint's axis in its own frame, read off pinocchio's motion subspace, and which joints slide."""
    axes, prismatic = [], []
    for joint in list(model.joints)[1:]:
        data = joint.createData()
        joint.calc(data, np.eye(1, joint.nq)[0] if joint.nq == 2 else np.zeros(joint.nq))
        subspace = np.asarray(data.S).reshape(6)
        prismatic.append(bool(np.linalg.norm(subspace[:3]) > 0.5))
        axes.append(subspace[:3] if prismatic[-1] else subspace[3:])
    return np.array(axes), np.array(prismatic)


def _limits(model: pin.Model) -> tuple[np.ndarray, np.ndarray]:
    lower = np.full(model.njoints - 1, -np.inf)
    upper = np.full(model.njoints - 1, np.inf)
    for i, joint in enumerate(list(model.joints)[1:]):
        if joint.nq == 1:  # a continuous joint is a point on the unit circle there, and has no limits
            lower[i] = model.lowerPositionLimit[joint.idx_q]
            upper[i] = model.upperPositionLimit[joint.idx_q]
    return lower, upper
