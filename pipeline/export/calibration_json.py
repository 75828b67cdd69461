"""An identified robot as one JSON document, `kincal-calibration-1`, and back. SI units; quaternions are x, y, z, w."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pinocchio as pin  # pyright: ignore[reportMissingImports] - a wheel without stubs
from scipy.spatial.transform import Rotation

from kincal.identification.error_model import BuiltRobot
from kincal.identification.identification import Identification
from kincal.pipeline.report.parameters import parameters_json
from kincal.urdf.actuators import Actuators
from kincal.urdf.closed_chain import BASE, ClosedChain, LoopClosure
from kincal.urdf.description import RobotDescription
from kincal.urdf.rigid_motion import Motion
from kincal.urdf.workspace import AXES

SCHEMA = "kincal-calibration-1"
_JOINTS = {
    "revolute": pin.JointModelRevoluteUnaligned,
    "continuous": pin.JointModelRevoluteUnboundedUnaligned,
    "prismatic": pin.JointModelPrismaticUnaligned,
}


def calibration_document(
    description: RobotDescription,
    robot: BuiltRobot,
    identification: Identification,
    source: str,
    versions: Mapping[str, str],
) -> dict[str, Any]:
    """source: what was measured, `virtual` or a file's name. The robot's home must close its loops."""
    chain, actuators = robot.chain, robot.actuators
    return {
        "schema": SCHEMA,
        "robot": description.name,
        "source": source,
        "virtual": source == "virtual",
        "versions": dict(versions),
        "n_poses": identification.n_poses,
        "channels": list(identification.channels),
        "chi_square": identification.chi_square,
        "degrees_of_freedom": identification.degrees_of_freedom,
        "joints": [_joint(chain, j) for j in range(chain.n_joints)],
        "loops": [_loop(chain, loop) for loop in chain.loops],
        "actuators": [
            {"joint": name, "zero": float(zero), "gain": float(gain)}
            for name, zero, gain in zip(chain.actuated_names, actuators.zero, actuators.gain, strict=True)
        ],
        "base": {"frame": description.base_frame, "placement": _placement(chain.base)},
        "tool": {
            "frame": description.tool_frame,
            "joint": _carrier(chain, chain.tool_joint),
            "placement": _placement(chain.tool),
            "axes": [AXES[a] for a in chain.tool_axes],
        },
        "W": _placement(robot.instrument),
        "T": _placement(robot.target),
        "home": {
            "joints": dict(zip(chain.joint_names, chain.home.tolist(), strict=True)),
            "tool": _placement(chain.home_pose),
        },
        "parameters": parameters(description.name, identification),
    }


def parameters(robot: str, identification: Identification) -> list[dict[str, Any]]:
    """One row a parameter, as `inspect --json` has them; null where neither data nor prior see it."""
    words = {"name": "name", "unit": "unit", "nominal": "initial", "identified": "final", "change": "change"}
    words |= {"std": "sigma", "low": "low", "high": "high", "identifiable": "identifiable"}
    return [{word: row[k] for k, word in words.items()} for row in parameters_json(robot, identification)["parameters"]]


def read_calibration(document: Mapping[str, Any]) -> BuiltRobot:
    """The robot of a document that `calibration_document` made."""
    joints, loops = document["joints"], document["loops"]
    names = [joint["name"] for joint in joints]
    index = {None: BASE} | {name: j for j, name in enumerate(names)}
    placed = [_motion(joint["placement"]) for joint in joints]
    model, closures = pin.Model(), []
    for joint, placement in zip(joints, placed, strict=True):
        kind = _JOINTS[joint["type"]](np.array(joint["axis"]))
        at = pin.SE3(placement.rotation, placement.translation)
        model.addJoint(index[joint["parent"]] + 1, kind, at, joint["name"])
    for loop in loops:
        first, second = loop["frames"]
        ends, bodies = (index[first["joint"]], index[second["joint"]]), (len(placed), len(placed) + 1)
        closures.append(LoopClosure(loop["name"], loop["kind"], (first["name"], second["name"]), ends, bodies))
        placed += [_motion(first["placement"]), _motion(second["placement"])]
    tool, actuators = document["tool"], document["actuators"]
    home = np.array([document["home"]["joints"][name] for name in names])
    chain = ClosedChain(
        model=model,
        joint_names=tuple(names),
        parents=tuple(index[joint["parent"]] for joint in joints),
        axes=np.array([joint["axis"] for joint in joints]),
        prismatic=np.array([joint["type"] == "prismatic" for joint in joints]),
        lower=np.array([-np.inf if joint["lower"] is None else joint["lower"] for joint in joints]),
        upper=np.array([np.inf if joint["upper"] is None else joint["upper"] for joint in joints]),
        rotation=np.stack([p.rotation for p in placed]),
        translation=np.stack([p.translation for p in placed]),
        loops=tuple(closures),
        actuated=np.array([index[a["joint"]] for a in actuators]),
        base=_motion(document["base"]["placement"]),
        tool_joint=index[tool["joint"]],
        tool=_motion(tool["placement"]),
        tool_axes=tuple(AXES.index(axis) for axis in tool["axes"]),
        drawn=home,
        home=home,
        home_pose=_motion(document["home"]["tool"]),
    )
    gain, zero = (np.array([a[word] for a in actuators]) for word in ("gain", "zero"))
    return BuiltRobot(chain, Actuators(gain, zero), _motion(document["W"]), _motion(document["T"]))


def _joint(chain: ClosedChain, j: int) -> dict[str, Any]:
    turning = "continuous" if chain.model.joints[j + 1].nq == 2 else "revolute"
    limits = (float(limit) if np.isfinite(limit) else None for limit in (chain.lower[j], chain.upper[j]))
    return {
        "name": chain.joint_names[j],
        "parent": _carrier(chain, chain.parents[j]),
        "type": "prismatic" if chain.prismatic[j] else turning,
        "axis": chain.axes[j].tolist(),
        "placement": _placement(Motion(chain.rotation[j], chain.translation[j])),
        **dict(zip(("lower", "upper"), limits, strict=True)),
    }


def _loop(chain: ClosedChain, loop: LoopClosure) -> dict[str, Any]:
    frames = [
        {
            "name": frame,
            "joint": _carrier(chain, joint),
            "placement": _placement(Motion(chain.rotation[k], chain.translation[k])),
        }
        for frame, joint, k in zip(loop.frames, loop.joints, loop.bodies, strict=True)
    ]
    return {"name": loop.name, "kind": loop.kind, "frames": frames}


def _carrier(chain: ClosedChain, joint: int) -> str | None:
    """The joint's name; null for what hangs on the base."""
    return None if joint == BASE else chain.joint_names[joint]


def _placement(motion: Motion) -> dict[str, list[float]]:
    quaternion = Rotation.from_matrix(motion.rotation).as_quat(canonical=True)
    return {"xyz": np.asarray(motion.translation, dtype=float).tolist(), "quaternion": quaternion.tolist()}


def _motion(placement: Mapping[str, Any]) -> Motion:
    rotation = Rotation.from_quat(np.array(placement["quaternion"], dtype=float)).as_matrix()
    return Motion(rotation, np.array(placement["xyz"], dtype=float))
