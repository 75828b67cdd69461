"""URDF + loop closures -> ClosedChain: the pinocchio model, its constraint models, joint and frame indexes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - a wheel without stubs
from defusedxml import DefusedXmlException
from defusedxml import ElementTree as SafeXml

from urdf.description import Loop, Mechanism, Workspace, nearest
from urdf.errors import InputError
from urdf.rigid_motion import Motion

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")
MAX_JOINTS = 500
BASE = -1  # the parent of a joint that hangs on the base


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


def load_chain(mechanism: Mechanism, urdf: str, file: Path) -> ClosedChain:
    """The chain of a mechanism and the text of its URDF; `file` is where that text came from, for messages.

    Its home is a first guess, the URDF's zero configuration moved into the joint limits: see `kinematics.at_home`.
    Raises InputError for a URDF that is no tree, and for names that don't exist or are ambiguous.
    """
    _check_tree(urdf, file)
    try:
        model = pin.buildModelFromXML(urdf)
    except (ValueError, RuntimeError) as error:
        raise InputError(f"{file}: not a URDF that pinocchio can read: {_one_line(error)}") from None
    names = tuple(model.names[1:])
    axes, prismatic = _axes(model)
    joint_index = {name: i for i, name in enumerate(names)}
    for name in mechanism.actuated:
        if name not in joint_index:
            raise InputError(
                f"actuated: joint {name!r} is not among the moving joints of {file}; {nearest(name, names)}"
            )
    base = _frame(model, mechanism.base_frame, "base_frame", file)
    if base[0] != BASE:
        raise InputError(f"base_frame: {mechanism.base_frame!r} moves with joint {names[base[0]]!r}; allowed is fixed")
    tool = _frame(model, mechanism.tool_frame, "tool_frame", file)
    lower, upper = _limits(model)
    placements = [Motion(m.rotation.copy(), m.translation.copy()) for m in list(model.jointPlacements)[1:]]
    loops = []
    for loop in mechanism.loop:
        closure, placed = _closure(model, loop, len(placements), file)
        placements += placed
        loops.append(closure)
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
        home=np.where((lower <= 0) & (upper >= 0), 0.0, 0.5 * (lower + upper)),
        home_pose=Motion.identity(),
    )


def _tool_axes(workspace: Workspace) -> tuple[int, ...]:
    return tuple(
        ["xyz".index(a) for a in workspace.translation_mm] + [3 + "xyz".index(a) for a in workspace.rotation_deg]
    )


def _closure(model: pin.Model, loop: Loop, first: int, file: Path) -> tuple[LoopClosure, list[Motion]]:
    if loop.frames[0] == loop.frames[1]:
        raise InputError(f"loop {loop.name!r}: both frames are {loop.frames[0]!r}; allowed are two different ones")
    ends = [_frame(model, frame, f"loop {loop.name!r}", file) for frame in loop.frames]
    joints = (ends[0][0], ends[1][0])
    if joints[0] == joints[1]:
        raise InputError(f"loop {loop.name!r}: both frames sit on one body; it closes nothing")
    return LoopClosure(loop.name, loop.kind, loop.frames, joints, (first, first + 1)), [ends[0][1], ends[1][1]]


def _frame(model: pin.Model, name: str, field: str, file: Path) -> tuple[int, Motion]:
    """The joint that carries a frame (BASE for none), and the frame's placement in that joint's frame."""
    found = [f for f in model.frames if f.name == name and f.type != pin.FrameType.JOINT]
    if len(found) != 1:
        legal = [f.name for f in model.frames if f.name != "universe"]
        raise InputError(f"{field}: frame {name!r} is not in {file}; {nearest(name, legal)}")
    placement = found[0].placement
    return found[0].parentJoint - 1, Motion(placement.rotation.copy(), placement.translation.copy())


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


def _check_tree(urdf: str, file: Path) -> None:
    """Refuse what pinocchio would accept without a word: loops, doubled names, joints it cannot turn."""
    try:
        root = SafeXml.fromstring(urdf, forbid_dtd=True)
    except DefusedXmlException as error:
        raise InputError(f"{file}: XML entities and document types are not allowed ({type(error).__name__})") from None
    except (SafeXml.ParseError, ValueError) as error:
        raise InputError(f"{file}: not well-formed XML: {error}") from None
    if root.tag != "robot":
        raise InputError(f"{file}: the root element is <{root.tag}>; allowed is <robot>")
    links = [_attribute(link, "name", file, "link") for link in root.findall("link")]
    joints = {}
    for joint in root.findall("joint"):
        name = _attribute(joint, "name", file, "joint")
        if name in joints:
            raise InputError(f"{file}: two joints are called {name!r}; their names must differ")
        joints[name] = joint
    if len(joints) > MAX_JOINTS:
        raise InputError(f"{file}: {len(joints)} joints; allowed are {MAX_JOINTS}")
    for name in links:
        if links.count(name) > 1:
            raise InputError(f"{file}: two links are called {name!r}; their names must differ")
        if name in joints:
            raise InputError(f"{file}: a link and a joint are both called {name!r}; frames would be ambiguous")
    parent_of: dict[str, str] = {}
    for name, joint in joints.items():
        kind = joint.get("type")
        if kind not in JOINT_TYPES:
            raise InputError(f"{file}: joint {name!r} has type {kind!r}; allowed are {', '.join(JOINT_TYPES)}")
        if joint.find("mimic") is not None:
            raise InputError(f"{file}: joint {name!r} mimics another; describe the coupling as a loop")
        ends = []
        for end in ("parent", "child"):
            element = joint.find(end)
            link = "" if element is None else _attribute(element, "link", file, f"joint {name!r}: {end}")
            if link not in links:
                raise InputError(f"{file}: joint {name!r}: {end} link {link!r} does not exist; {nearest(link, links)}")
            ends.append(link)
        if ends[1] in parent_of:
            raise InputError(
                f"{file}: link {ends[1]!r} has two parents ({parent_of[ends[1]]!r} and {ends[0]!r}): a URDF must be a "
                "tree; cut the loop there and close it with a [[loop]] in robot.toml"
            )
        parent_of[ends[1]] = ends[0]
        _check_numbers(joint, name, file)
    _check_connected(links, parent_of, file)


def _check_connected(links: list[str], parent_of: Mapping[str, str], file: Path) -> None:
    roots = [link for link in links if link not in parent_of]
    if len(roots) != 1:
        found = ", ".join(map(repr, roots[:4])) if roots else "none (the links form a ring)"
        raise InputError(f"{file}: a URDF must be one tree with one root link; found {found}")
    for link in links:
        seen = {link}
        while link in parent_of:
            link = parent_of[link]
            if link in seen:
                raise InputError(f"{file}: link {link!r} is its own ancestor: a URDF must be a tree")
            seen.add(link)


def _check_numbers(joint, name: str, file: Path) -> None:
    for tag, attributes in (("origin", ("xyz", "rpy")), ("axis", ("xyz",)), ("limit", ("lower", "upper"))):
        element = joint.find(tag)
        for attribute in attributes:
            text = None if element is None else element.get(attribute)
            if text is None:
                continue
            try:
                values = [float(part) for part in text.split()]
            except ValueError:
                values = []
            if len(values) != (1 if tag == "limit" else 3) or not np.all(np.isfinite(values)):
                raise InputError(f"{file}: joint {name!r}: {tag} {attribute} is {text!r}; allowed are finite numbers")
            if tag == "axis" and np.linalg.norm(values) < 1e-9:
                raise InputError(f"{file}: joint {name!r}: the axis is zero; allowed is a direction")


def _attribute(element, key: str, file: Path, what: str) -> str:
    value = element.get(key)
    if not value:
        raise InputError(f"{file}: {what} without {key!r}")
    return value


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
