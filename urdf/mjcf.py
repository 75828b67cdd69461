"""An MJCF (MuJoCo's XML) -> Drawing: its bodies as a tree of one-number joints, `connect` and `weld` as loops.

Read here and not by Pinocchio 4.1, which takes the first body of <worldbody> alone, turns the range of a slide from
degrees, forgets the defaults of sites and passes over `active="false"` and joint couplings without a word.
Names, defaults and conventions are those of MuJoCo's XML reference (https://mujoco.readthedocs.io).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - a wheel without stubs

from kincal.urdf.description import nearest
from kincal.urdf.drawing import BASE, MAX_JOINTS, Drawing, DrawnLoop
from kincal.urdf.errors import InputError, quoted
from kincal.urdf.mjcf_text import Attributes, MjcfText, from_quaternion
from kincal.urdf.rigid_motion import Motion, exp

WORLD = "world"  # the name that MuJoCo gives to what everything hangs on
_WITHOUT_MOTION = {"inertial", "geom", "camera", "light", "plugin", "site"}  # of a body's elements
_NOT_READ = {
    "include": "put the file's content there",
    "attach": "attach it with MuJoCo and save that as one file",
    "replicate": "write the copies out",
    "composite": "write its bodies out",
    "flexcomp": "leave what is soft out",
}
_JOINTS = ("joint", "freejoint")
_COUNTED = ("body", "frame", "joint", "freejoint", "site", "default")
_IDENTITY = Motion.identity()


@dataclass(frozen=True)
class _Joint:
    """A joint with one number."""

    name: str
    axis: np.ndarray
    slides: bool
    parent: int
    placement: Motion  # in its parent joint's frame
    limits: tuple[float, float]  # [rad or m]
    drawn: float = 0.0  # its value in the configuration that the file shows [rad or m]


@dataclass(frozen=True)
class _Frame:
    """A body's or a site's frame."""

    joint: int  # that carries it, BASE for none
    placement: Motion  # in that joint's frame
    drawn: Motion  # in the world, in the configuration that the file shows
    parent: str = ""  # the body that it hangs on


def read_mjcf(root, file: Path) -> Drawing:
    """The drawing of an MJCF by its root element; `file` is where it came from, for messages.

    A ball joint becomes three hinges, a free joint three slides and three hinges. Nothing else is opened: no meshes.
    Raises InputError for what it can't represent.
    """
    for tag, advice in _NOT_READ.items():
        if root.find(f".//{tag}") is not None:
            raise InputError(f"{file}: <{tag}> is not read; {advice}")
    if root.find("worldbody") is None:
        raise InputError(f"{file}: <mujoco> without <worldbody>: there is no robot")
    equalities = sum(len(equality) for equality in root.findall("equality"))
    count = equalities + sum(1 for tag in _COUNTED for _ in root.iter(tag))
    if count > 4 * MAX_JOINTS:
        raise InputError(f"{file}: {count} {', '.join(_COUNTED)} and equality elements; allowed are {4 * MAX_JOINTS}")
    tree = _Tree(MjcfText.of(root, file))
    tree.grow(root)
    loops = _loops(root, tree)
    driven = [j for a in root.findall("actuator") for e in a if (j := e.get("joint")) in {j.name for j in tree.joints}]
    configuration = np.array([joint.drawn for joint in tree.joints])
    return Drawing(_model(tree, root.get("model", "mujoco")), configuration, WORLD, loops, tuple(dict.fromkeys(driven)))


@dataclass
class _Tree:
    """The bodies of <worldbody>, walked once: joints, and the frames of bodies and sites by name."""

    text: MjcfText
    joints: list[_Joint] = field(default_factory=list)
    bodies: dict[str, _Frame] = field(default_factory=dict)
    sites: dict[str, _Frame] = field(default_factory=dict)
    _names: set[str] = field(default_factory=set)

    def grow(self, root) -> None:
        """Depth first, in the file's order."""
        self._names = {WORLD, *(name for body in root.iter("body") if (name := body.get("name")))}
        world = _Frame(BASE, _IDENTITY, _IDENTITY)
        self.bodies[WORLD] = world
        stack = []
        for worldbody in reversed(root.findall("worldbody")):
            stack += self._fill(worldbody, WORLD, "main")
        while stack:
            stack += self._body(*stack.pop())
        if len(self.joints) > MAX_JOINTS:
            raise InputError(f"{self.text.file}: {len(self.joints)} joints; allowed are {MAX_JOINTS}")
        names = [joint.name for joint in self.joints]
        for name in names:
            if names.count(name) > 1:
                raise InputError(f"{self.text.file}: two joints are called {quoted(name)}; their names must differ")

    def _body(self, element, placed: Motion, on: str, childclass: str) -> list:
        """Add a body, its joints and sites; what is left to do: the bodies in it, the last one first."""
        name = element.get("name") or self._new_name("body")
        label = f"body {quoted(name)}"
        if name in self.bodies:
            raise InputError(f"{self.text.file}: two bodies are called {quoted(name)}; their names must differ")
        if element.get("mocap") == "true":
            raise InputError(f"{self.text.file}: {label} is moved by hand (mocap); leave it out")
        parent, pose = self.bodies[on], placed @ self.text.placement(element.attrib, label)
        childclass = element.get("childclass", childclass)
        frame = _Frame(parent.joint, parent.placement @ pose, parent.drawn @ pose)
        joints = [(e, at, own) for e, at, own in _contents(element, childclass, self.text) if e.tag in _JOINTS]
        if len(joints) > 1 and any(self._kind(e, own) == "free" for e, _, own in joints):
            raise InputError(f"{self.text.file}: {label} has a free joint and others; allowed is the free one alone")
        for k, (joint, at, own) in enumerate(joints):
            default = f"{name}_free" if self._kind(joint, own) == "free" else f"{name}_joint{k + 1 if k else ''}"
            frame = self._joint(joint, joint.get("name") or default, at, own, frame)
        self.bodies[name] = replace(frame, parent=on)
        return self._fill(element, name, childclass)

    def _new_name(self, stem: str) -> str:
        name = next(n for k in range(1, len(self._names) + 2) if (n := f"{stem}{k}") not in self._names)
        self._names.add(name)
        return name

    def _kind(self, joint, childclass: str) -> str:
        if joint.tag == "freejoint":
            return "free"
        return self.text.attributes(joint, childclass).get("type", "hinge")

    def _joint(self, element, name: str, placed: Motion, childclass: str, body: _Frame) -> _Frame:
        """Add a joint of `body`, at `placed` in it; the body's frame after that joint."""
        label, kind = f"joint {quoted(name)}", self._kind(element, childclass)
        if kind == "free":
            return self._free(name, label, body)
        attributes = self.text.attributes(element, childclass)
        at = Motion(
            np.eye(3), placed.rotation @ self.text.numbers(attributes, "pos", "0 0 0", label) + placed.translation
        )
        anchor = body.placement @ at
        limits = self._limits(attributes, kind, label)
        if kind == "ball":
            self._add([(f"{name}_{c}", c, False, limits) for c in "xyz"], body.joint, anchor)
        elif kind in ("hinge", "slide"):
            axis = placed.rotation @ self.text.direction(attributes, "axis", "0 0 1", label)
            unit = 1.0 if kind == "slide" else self.text.angle
            drawn = unit * float(self.text.numbers(attributes, "ref", "0", label)[0])
            back = -drawn * axis  # the file shows the joint at `ref`: its placement is that of its zero
            start = Motion(np.eye(3), back) if kind == "slide" else Motion(exp(back), np.zeros(3))
            self.joints.append(_Joint(name, axis, kind == "slide", body.joint, anchor @ start, limits, drawn))
        else:
            raise InputError(f"{self.text.file}: {label} has type {quoted(kind)}; allowed are hinge, slide, ball, free")
        return _Frame(len(self.joints) - 1, at.inverse(), body.drawn)

    def _free(self, name: str, label: str, body: _Frame) -> _Frame:
        if body.joint != BASE:
            raise InputError(
                f"{self.text.file}: {label} is free, but its body hangs on another joint; allowed: on none"
            )
        endless, at = (-np.inf, np.inf), body.placement
        self._add([(f"{name}_{c}", c, True, endless) for c in "xyz"], BASE, Motion(np.eye(3), at.translation))
        turning = [(f"{name}_r{c}", c, False, endless) for c in "xyz"]
        self._add(turning, len(self.joints) - 1, Motion(at.rotation, np.zeros(3)))
        return _Frame(len(self.joints) - 1, _IDENTITY, body.drawn)

    def _add(self, joints: list[tuple[str, str, bool, tuple[float, float]]], parent: int, placement: Motion) -> None:
        """Joints (name, axis, slides, limits), each on the one before it: the first at `placement` on `parent`."""
        for name, axis, slides, limits in joints:
            self.joints.append(_Joint(name, np.eye(3)["xyz".index(axis)], slides, parent, placement, limits))
            parent, placement = len(self.joints) - 1, _IDENTITY

    def _limits(self, attributes: Attributes, kind: str, label: str) -> tuple[float, float]:
        """[rad or m]; of a ball joint those of each of its three angles: none is beyond the whole rotation's."""
        limited = attributes.get("limited", "auto")
        if limited not in ("true", "false", "auto"):
            raise InputError(f"{self.text.file}: {label}: limited is {quoted(limited)}; allowed are true, false, auto")
        if limited == "auto" and "range" in attributes and not self.text.autolimits:
            raise InputError(
                f'{self.text.file}: {label} has a range but no `limited`, which autolimits="false" demands'
            )
        low, high = self.text.numbers(attributes, "range", "0 0", label) * (1.0 if kind == "slide" else self.text.angle)
        if limited == "false" or (limited == "auto" and "range" not in attributes):
            return (-np.inf, np.inf)
        if not low < high or (kind == "ball" and low != 0):
            allowed = "0 and a positive angle" if kind == "ball" else "two numbers, the lower one first"
            shown = quoted(attributes.get("range"))
            raise InputError(f"{self.text.file}: {label}: range is {shown}; allowed: {allowed}")
        if kind == "ball":
            return (-high, high) if high <= np.pi / 2 else (-np.inf, np.inf)
        return float(low), float(high)

    def _fill(self, element, name: str, childclass: str) -> list:
        """Add the sites of a body; the bodies in it, the last one first."""
        inner, frame = [], self.bodies[name]
        for child, placed, own in _contents(element, childclass, self.text):
            if child.tag == "body":
                inner.append((child, placed, name, own))
            elif child.tag == "site" and (site := child.get("name")):
                if site in self.sites:
                    raise InputError(f"{self.text.file}: two sites are called {quoted(site)}; their names must differ")
                at = placed @ self.text.placement(self.text.attributes(child, own), f"site {quoted(site)}")
                self.sites[site] = _Frame(frame.joint, frame.placement @ at, frame.drawn @ at, name)
            elif child.tag in _JOINTS:
                if name == WORLD:
                    raise InputError(f"{self.text.file}: <worldbody> has a joint; allowed are joints of bodies")
            elif child.tag not in _WITHOUT_MOTION:
                legal = nearest(child.tag, ("body", "joint", "freejoint", "frame", *sorted(_WITHOUT_MOTION)))
                raise InputError(f"{self.text.file}: body {quoted(name)} has an element <{child.tag}>; {legal}")
        return inner[::-1]


def _contents(element, childclass: str, text: MjcfText) -> Iterator[tuple]:
    """What a body holds, in order: the element, where its <frame>s (which are no bodies) put it, its default class."""
    stack = [(child, _IDENTITY, childclass) for child in reversed(element)]
    while stack:
        child, placed, own = stack.pop()
        if child.tag == "frame":
            inside = placed @ text.placement(child.attrib, f"frame {quoted(child.get('name', ''))}")
            own = child.get("childclass", own)
            stack += [(inner, inside, own) for inner in reversed(child)]
        else:
            yield child, placed, own


def _loops(root, tree: _Tree) -> tuple[DrawnLoop, ...]:
    file = tree.text.file
    elements = [element for equality in root.findall("equality") for element in equality]
    names = [element.get("name") for element in elements]
    taken, loops = set(filter(None, names)), []
    for element in elements:
        name = element.get("name") or next(
            n for k in range(1, len(elements) + 2) if (n := f"{element.tag}{k}") not in taken
        )
        label = f"equality {quoted(name)}"
        if names.count(name) > 1:
            raise InputError(f"{file}: two equalities are called {quoted(name)}; their names must differ")
        taken.add(name)
        if element.tag not in ("connect", "weld"):
            raise InputError(
                f"{file}: {label} is of type <{element.tag}>; allowed are <connect> and <weld>: leave it out"
            )
        attributes = tree.text.attributes(element, tag="equality")
        if attributes.get("active", "true") != "true":
            raise InputError(f"{file}: {label} is not active; leave it out, or close that loop")
        loops.append(_loop(element.tag, name, attributes, tree, label))
    return tuple(loops)


def _loop(tag: str, name: str, attributes: Attributes, tree: _Tree, label: str) -> DrawnLoop:
    """connect: two points meet; weld: two frames."""
    where = f"{tree.text.file}: {label}"
    by_site = [key for key in ("site1", "site2") if key in attributes]
    by_body = [key for key in ("body1", "body2", "anchor", "relpose") if key in attributes]
    if (by_site and (by_body or len(by_site) < 2)) or not (by_site or "body1" in attributes):
        raise InputError(f"{where} needs either body1 (and body2) or site1 and site2")
    kind = "point" if tag == "connect" else "frame"
    if by_site:
        names = (attributes["site1"], attributes["site2"])
        first, second = (_end(tree.sites, at, f"{where}: site") for at in names)
        return DrawnLoop(name, kind, names, (first.joint, second.joint), (first.placement, second.placement))
    names = (attributes["body1"], attributes.get("body2", WORLD))
    first, second = (_end(tree.bodies, at, f"{where}: body") for at in names)
    if tag == "connect":
        if "anchor" not in attributes:
            raise InputError(f"{where} needs an anchor, in the frame of {quoted(names[0])}")
        at = Motion(np.eye(3), tree.text.numbers(attributes, "anchor", "0 0 0", label))
        meeting = second.drawn.inverse() @ first.drawn @ at  # where they are in the configuration that the file shows
        inner = (at, Motion(np.eye(3), meeting.translation))
    else:
        inner = _weld(attributes, first, second, tree.text, label)
    placed = (first.placement @ inner[0], second.placement @ inner[1])
    return DrawnLoop(name, kind, names, (first.joint, second.joint), placed)


def _weld(attributes: Attributes, first: _Frame, second: _Frame, text: MjcfText, label: str) -> tuple[Motion, Motion]:
    """The frame at the anchor, in either body: the anchor is written in the second's, its pose in the first's."""
    if text.numbers(attributes, "torquescale", "1", label)[0] <= 0:
        raise InputError(f"{text.file}: {label}: torquescale leaves the orientation free; write it as <connect>")
    at = Motion(np.eye(3), text.numbers(attributes, "anchor", "0 0 0", label))
    pose = text.numbers(attributes, "relpose", "0 0 0 0 0 0 0", label)
    if not np.any(pose[3:]):  # MuJoCo's way to say: as the file shows them
        return first.drawn.inverse() @ second.drawn @ at, at
    return Motion(from_quaternion(pose[3:] / np.linalg.norm(pose[3:])), pose[:3]), at


def _end(frames: Mapping[str, _Frame], name: str, where: str) -> _Frame:
    if name not in frames:
        raise InputError(f"{where} {quoted(name)} does not exist; {nearest(name, frames)}")
    return frames[name]


def _model(tree: _Tree, name: str) -> pin.Model:
    model = pin.Model()
    model.name = name
    for joint in tree.joints:
        kind = pin.JointModelPrismaticUnaligned if joint.slides else pin.JointModelRevoluteUnaligned
        free = np.array([np.inf])
        low, high = (np.array([limit]) for limit in joint.limits)
        placement = pin.SE3(joint.placement.rotation, joint.placement.translation)
        index = model.addJoint(joint.parent + 1, kind(joint.axis), placement, joint.name, free, free, low, high)
        model.addJointFrame(index)
    kinds = ((tree.bodies, pin.FrameType.BODY), (tree.sites, pin.FrameType.OP_FRAME))
    for frames, kind in kinds:
        for frame_name, frame in frames.items():
            placement = pin.SE3(frame.placement.rotation, frame.placement.translation)
            parent = model.getFrameId(frame.parent, pin.FrameType.BODY) if frame.parent else 0
            model.addFrame(pin.Frame(frame_name, frame.joint + 1, parent, placement, kind))
    return model
