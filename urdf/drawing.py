"""What a robot's file shows, be it URDF or MJCF: a tree of one-number joints, named frames, and loops."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - a wheel without stubs
from defusedxml import DefusedXmlException
from defusedxml import ElementTree as SafeXml

from kincal.urdf.errors import InputError
from kincal.urdf.rigid_motion import Motion

MAX_JOINTS = 500
MAX_NUMBER = 1e9  # of a placement or a direction [m, rad]: more is a slip, and its squares must not overflow
BASE = -1  # the parent of a joint that hangs on the base


@dataclass(frozen=True)
class DrawnLoop:
    """Two frames that meet: their names, the joints that carry them (BASE for none), their placements there."""

    name: str
    kind: str  # point or frame
    frames: tuple[str, str]
    joints: tuple[int, int]
    placements: tuple[Motion, Motion]


@dataclass(frozen=True)
class Drawing:
    """A robot's file as read. Joints have one number each, in pinocchio's order."""

    model: pin.Model
    configuration: np.ndarray  # (n_joints,) in which the file shows the robot: 0, or MJCF's `ref` [rad or m]
    root: str  # the frame that everything hangs on
    loops: tuple[DrawnLoop, ...] = ()  # of an MJCF's <equality>; a URDF has none
    driven: tuple[str, ...] = ()  # joints that an MJCF's <actuator> moves


def parse(text: str, file: Path):
    """The root element. Refuses what an XML parser should not expand, or can't read."""
    try:
        return SafeXml.fromstring(text, forbid_dtd=True)
    except DefusedXmlException as error:
        raise InputError(f"{file}: XML entities and document types are not allowed ({type(error).__name__})") from None
    except (SafeXml.ParseError, ValueError) as error:
        raise InputError(f"{file}: not well-formed XML: {error}") from None
