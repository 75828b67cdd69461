"""The URDF of an identified robot: the drawing's own text with other placements, and W and T as two more links.

Pinocchio merges what fixed joints hold together, so a placement that was identified stands in the frame of the moving
joint before it. A URDF has it in its parent link's: origin = (parent link in that joint's frame)^-1 * placement.
"""

from __future__ import annotations

import xml.etree.ElementTree as Xml
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import pinocchio as pin  # pyright: ignore[reportMissingImports] - a wheel without stubs
from defusedxml.ElementTree import DefusedXMLParser

from kincal.identification.error_model import BuiltRobot
from kincal.urdf.closed_chain import BASE
from kincal.urdf.description import Mechanism
from kincal.urdf.errors import InputError
from kincal.urdf.rigid_motion import Motion, zyx_angles


@dataclass(frozen=True)
class CalibratedUrdf:
    """A URDF's text, and the names that robot.toml needs from it."""

    text: str
    loop_frames: tuple[tuple[str, str], ...]  # of every loop, in the mechanism's order
    instrument: str  # the link that is W: the pose of X in it is W * (pose of X in the base frame)
    target: str  # the link that is T: its pose in the tool frame


def calibrated_urdf(urdf: str, robot: BuiltRobot, mechanism: Mechanism, remarks: Sequence[str]) -> CalibratedUrdf:
    """`urdf`, the text that the robot's chain was read from, with the robot's placements, W and T.

    A loop's frame is moved where its link is a leaf on a fixed joint that serves nothing else; it gets a new link
    otherwise. said: comments for its first lines.
    """
    document = _Document(urdf)
    chain = robot.chain
    bodies = [frame for frame in chain.model.frames if frame.type == pin.FrameType.BODY]
    links = {f.name: Motion(f.placement.rotation, f.placement.translation) for f in bodies}
    placed = Motion(chain.rotation, chain.translation)
    for k, name in enumerate(chain.joint_names):
        parent = document.end(name, "parent")
        document.place(name, links[parent].inverse() @ placed[k])
    frames = [mechanism.base_frame, mechanism.tool_frame, *(f for loop in chain.loops for f in loop.frames)]
    uses = Counter(document.link(frame) for frame in frames)
    loop_frames = []
    for loop in chain.loops:
        names = []
        for frame, joint, k in zip(loop.frames, loop.joints, loop.bodies, strict=True):
            link = document.link(frame)
            mount = document.mount(link)
            if mount is not None and document.leaf(link) and uses[link] == 1:
                document.place(mount, links[document.end(mount, "parent")].inverse() @ placed[k])
                names.append(frame)
            else:
                carrier = document.root if joint == BASE else document.end(chain.joint_names[joint], "child")
                names.append(document.add(f"{loop.name}_{frame}", carrier, placed[k]))
        loop_frames.append((names[0], names[1]))
    instrument = document.add("instrument", document.link(mechanism.base_frame), robot.instrument.inverse())
    target = document.add("target", document.link(mechanism.tool_frame), robot.target)
    return CalibratedUrdf(document.text(remarks), tuple(loop_frames), instrument, target)


def require_urdf(text: str) -> None:
    """InputError where a robot was read from something else."""
    root, _ = _parse(text)
    if root.tag != "robot":
        raise InputError(f"--format urdf: the robot was read from <{root.tag}>, no URDF; allowed is --format json")


class _Document:
    """A URDF that is being edited."""

    def __init__(self, urdf: str) -> None:
        self._root, self._comments = _parse(urdf)
        self._links = [link.get("name", "") for link in self._root.findall("link")]
        self._joints = {joint.get("name", ""): joint for joint in self._root.findall("joint")}

    @property
    def root(self) -> str:
        """The link that hangs on no joint."""
        children = {self.end(joint, "child") for joint in self._joints}
        return next(link for link in self._links if link not in children)

    def end(self, joint: str, which: str) -> str:
        """The `parent` or `child` link of a joint."""
        element = self._joints[joint].find(which)
        assert element is not None  # the loader has seen to it
        return element.get("link", "")

    def link(self, frame: str) -> str:
        """The link of a frame: a fixed joint's name stands for its child."""
        return frame if frame in self._links else self.end(frame, "child")

    def mount(self, link: str) -> str | None:
        """The fixed joint that carries a link; None where that joint moves, and for the root."""
        for name, joint in self._joints.items():
            if self.end(name, "child") == link:
                return name if joint.get("type") == "fixed" else None
        return None

    def leaf(self, link: str) -> bool:
        return all(self.end(joint, "parent") != link for joint in self._joints)

    def place(self, joint: str, placement: Motion) -> None:
        """Set a joint's origin, which is all that is changed of it."""
        element = self._joints[joint]
        origin = element.find("origin")
        if origin is None:
            origin = Xml.SubElement(element, "origin")
        origin.attrib.clear()
        origin.set("xyz", _numbers(placement.translation))
        origin.set("rpy", _numbers(zyx_angles(placement.rotation)[::-1]))

    def add(self, wanted: str, parent: str, placement: Motion) -> str:
        """A new link, fixed to `parent`; returns its name, which no other link or joint has."""
        name = self._unique(wanted)
        self._links.append(name)
        mount = self._unique(f"{name}_mount")
        link, joint = Xml.Element("link", name=name), Xml.Element("joint", name=mount, type="fixed")
        Xml.SubElement(joint, "parent", link=parent)
        Xml.SubElement(joint, "child", link=name)
        self._joints[mount] = joint
        self.place(mount, placement)
        Xml.indent(joint, level=1)
        indent, end = "\n  ", "\n"
        if len(self._root):
            self._root[-1].tail = indent
        else:
            self._root.text = indent
        link.tail, joint.tail = indent, end
        self._root.extend([link, joint])
        return name

    def _unique(self, wanted: str) -> str:
        taken = {*self._links, *self._joints}
        names = (wanted, *(f"{wanted}_{k}" for k in range(2, len(taken) + 3)))
        return next(name for name in names if name not in taken)

    def text(self, remarks: Sequence[str]) -> str:
        comments = "".join(f"<!--{text}-->\n" for text in (*map(_as_comment, remarks), *self._comments))
        return f'<?xml version="1.0"?>\n{comments}{Xml.tostring(self._root, encoding="unicode")}\n'


class _Keeper(Xml.TreeBuilder):
    """Builds the tree with its comments; those before and after the root stand in `outside`."""

    def __init__(self) -> None:
        super().__init__(insert_comments=True, insert_pis=True)
        self.outside: list[str] = []
        self._depth = 0

    def start(self, tag, attrs, /):
        self._depth += 1
        return super().start(tag, attrs)

    def end(self, tag, /):
        self._depth -= 1
        return super().end(tag)

    def comment(self, text, /):
        if self._depth:
            return super().comment(text)
        self.outside.append(text or "")
        return None

    def pi(self, target, text=None, /):
        return super().pi(target, text) if self._depth else None


def _parse(text: str) -> tuple[Xml.Element, list[str]]:
    """The root, and the comments outside of it. The loader has refused what is not well-formed."""
    keeper = _Keeper()
    parser = DefusedXMLParser(target=keeper, forbid_dtd=True)
    parser.feed(text)
    return parser.close(), keeper.outside


def _numbers(values) -> str:
    return " ".join(repr(float(value)) for value in values)


def _as_comment(text: str) -> str:
    """Text as XML allows it in a comment: no two hyphens side by side."""
    shown = "".join(c if c.isprintable() else "?" for c in text)
    while "--" in shown:
        shown = shown.replace("--", "- -")
    return f" {shown} "
