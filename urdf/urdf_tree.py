"""A URDF, which must be one tree -> Drawing, by Pinocchio."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - a wheel without stubs

from kincal.urdf.description import nearest
from kincal.urdf.drawing import MAX_JOINTS, MAX_NUMBER, Drawing
from kincal.urdf.errors import InputError, quoted, shortened
from kincal.urdf.input_files import floats

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed")


def read_urdf(root, text: str, file: Path) -> Drawing:
    """The drawing of a URDF, as text and as its root element; `file` is where it came from, for messages.

    Raises InputError for a URDF that is no tree, and for what pinocchio can't read.
    """
    link = _check_tree(root, file)
    with _stderr() as errors:
        try:
            model = pin.buildModelFromXML(text)
        except (ValueError, RuntimeError) as error:
            why = _first_line(errors) or str(error)
            raise InputError(f"{file}: not a URDF that pinocchio can read: {shortened(why)}") from None
    return Drawing(model, np.zeros(model.njoints - 1), link)


@contextmanager
def _stderr() -> Iterator[IO[bytes]]:
    """What the URDF parser below pinocchio prints; it has no other way to say what it misses."""
    with tempfile.TemporaryFile() as captured:
        sys.stderr.flush()
        kept = os.dup(2)
        os.dup2(captured.fileno(), 2)
        try:
            yield captured
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def _first_line(stream: IO[bytes]) -> str:
    stream.seek(0)
    first = stream.read(2000).decode(errors="replace").partition("\n")[0]
    return first.removeprefix("Error:").strip()


def _check_tree(root, file: Path) -> str:
    """The root link. Refuses what pinocchio would accept without a word: loops, doubled names, unknown joints."""
    links = [_attribute(link, "name", file, "link") for link in root.findall("link")]
    joints = {}
    for joint in root.findall("joint"):
        name = _attribute(joint, "name", file, "joint")
        if name in joints:
            raise InputError(f"{file}: two joints are called {quoted(name)}; their names must differ")
        joints[name] = joint
    if len(joints) > MAX_JOINTS:
        raise InputError(f"{file}: {len(joints)} joints; allowed are {MAX_JOINTS}")
    if len(links) > MAX_JOINTS + 1:
        raise InputError(f"{file}: {len(links)} links; allowed are {MAX_JOINTS + 1}")
    for name in links:
        if links.count(name) > 1:
            raise InputError(f"{file}: two links are called {quoted(name)}; their names must differ")
        if name in joints:
            raise InputError(f"{file}: a link and a joint are both called {quoted(name)}; frames would be ambiguous")
    parent_of: dict[str, str] = {}
    for name, joint in joints.items():
        kind = joint.get("type")
        if kind not in JOINT_TYPES:
            allowed = ", ".join(JOINT_TYPES)
            raise InputError(f"{file}: joint {quoted(name)} has type {quoted(kind)}; allowed are {allowed}")
        if joint.find("mimic") is not None:
            raise InputError(f"{file}: joint {quoted(name)} mimics another; describe the coupling as a loop")
        ends = []
        for end in ("parent", "child"):
            element = joint.find(end)
            link = "" if element is None else _attribute(element, "link", file, f"joint {quoted(name)}: {end}")
            if link not in links:
                wrong = f"{end} link {quoted(link)} does not exist"
                raise InputError(f"{file}: joint {quoted(name)}: {wrong}; {nearest(link, links)}")
            ends.append(link)
        if ends[1] in parent_of:
            parents = f"{quoted(parent_of[ends[1]])} and {quoted(ends[0])}"
            raise InputError(
                f"{file}: link {quoted(ends[1])} has two parents ({parents}): a URDF must be a tree; cut the loop "
                "there and close it with a [[loop]] in robot.toml"
            )
        parent_of[ends[1]] = ends[0]
        _check_numbers(joint, name, file)
    return _check_connected(links, parent_of, file)


def _check_connected(links: list[str], parent_of: Mapping[str, str], file: Path) -> str:
    roots = [link for link in links if link not in parent_of]
    if len(roots) != 1:
        listed_roots = ", ".join(map(quoted, roots[:4])) if roots else "none (the links form a ring)"
        raise InputError(f"{file}: a URDF must be one tree with one root link; found {listed_roots}")
    for link in links:
        seen = {link}
        while link in parent_of:
            link = parent_of[link]
            if link in seen:
                raise InputError(f"{file}: link {quoted(link)} is its own ancestor: a URDF must be a tree")
            seen.add(link)
    return roots[0]


def _check_numbers(joint, name: str, file: Path) -> None:
    for tag, attributes in (("origin", ("xyz", "rpy")), ("axis", ("xyz",)), ("limit", ("lower", "upper"))):
        element = joint.find(tag)
        for attribute in attributes:
            text = None if element is None else element.get(attribute)
            if text is None:
                continue
            try:
                values = floats(text)
            except ValueError:
                values = []
            n, largest = (1, np.inf) if tag == "limit" else (3, MAX_NUMBER)
            if len(values) != n or not np.all(np.abs(values) < largest):
                shown = f"{tag} {attribute} is {quoted(text)}"
                raise InputError(f"{file}: joint {quoted(name)}: {shown}; allowed are finite numbers")
            if tag == "axis" and np.linalg.norm(values) < 1e-9:
                raise InputError(f"{file}: joint {quoted(name)}: the axis is zero; allowed is a direction")


def _attribute(element, key: str, file: Path, label: str) -> str:
    value = element.get(key)
    if not value:
        raise InputError(f"{file}: {label} without {key!r}")
    return value
