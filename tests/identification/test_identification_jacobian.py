"""The identification Jacobian against two independent answers: finite differences with re-closure, and Pinocchio.

Pinocchio: `computeJointKinematicRegressor` (placement errors to frame motion) and its joint Jacobians; the passive
joints are eliminated here, by hand.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from kincal.urdf.rigid_motion import Motion, skew

ROBOTS = ("ups3_s", "jugglebot", "ur10", "ups3_frame", "rps3", "ups2_u")
LARGE_ROBOTS = ("gough_stewart", "linear_delta")  # finite differences of their many parameters take long
CHANNELS = (("orientation", "position"), ("tilt",), ("tilt", "yaw"))
COORDINATES = ("x", "y", "z", "rx", "ry", "rz")
LARGE = (  # W and T of any size
    Motion(Rotation.from_rotvec([1.0, -0.8, 0.5]).as_matrix(), np.array([1.0, -2.0, 0.5])),
    Motion(Rotation.from_rotvec([-0.4, 0.3, 1.2]).as_matrix(), np.array([0.1, 0.2, -0.3])),
)


def parameters(loaded, kind: str) -> np.ndarray:
    """Nominal, or a robot at random 10 tolerances off with W and T of any size."""
    if kind == "nominal":
        return np.zeros(len(loaded.model.parameters))
    return loaded.random_parameters(4, 10.0 if loaded.description.name != "jugglebot" else 2.0, *LARGE)


@pytest.mark.parametrize(
    "name, kind", [*((name, "off") for name in ROBOTS), ("ups3_s", "nominal"), ("ur10", "nominal")]
)
def test_jacobian_is_the_derivative_of_the_residuals_with_the_loops_closed_anew(name, kind, robot):
    """Central differences: every step moves one parameter, closes all loops and predicts again. Sigma 1."""
    loaded = robot(name)
    model, readings = loaded.model, loaded.readings(3, 2)
    p = parameters(loaded, kind)
    truth = p + 0.5 * loaded.random_parameters(5)  # residuals that are not zero
    measured = [loaded.measure(truth, readings, c, dict.fromkeys(c, 1.0)) for c in CHANNELS]
    nearby = model.robot(p).close(readings).q
    exact = [model.jacobian(p, m, nearby) for m in measured]

    def residuals(at: np.ndarray) -> list[np.ndarray]:
        robot = model.robot(at)
        closure = robot.close(readings, nearby)
        assert closure.closed.all()
        return [model.residual(robot, closure.q, m) for m in measured]

    step = 3e-6  # error of order step^2 against rounding of 1e-16 / step
    numerical = [np.empty_like(jacobian) for jacobian in exact]
    for k in range(len(p)):
        e = np.zeros(len(p))
        e[k] = step
        for columns, above, below in zip(numerical, residuals(p + e), residuals(p - e), strict=True):
            columns[..., k] = (above - below) / (2 * step)
    for m, jacobian, expected in zip(measured, exact, numerical, strict=True):
        here = model.linearise(p, m, nearby)
        assert np.abs(here.residual).max() > 1e-4
        np.testing.assert_allclose(jacobian, expected, rtol=1e-6, atol=1e-8 * np.abs(expected).max())
        # the streamed triangle holds the same matrix, and the residuals
        whole = np.column_stack([jacobian.reshape(-1, len(p)), here.residual.ravel()])
        gram = whole.T @ whole
        np.testing.assert_allclose(here.triangle.T @ here.triangle, gram, rtol=1e-9, atol=1e-12 * np.abs(gram).max())


def pinocchio_pose_jacobian(loaded, p: np.ndarray, reading: np.ndarray, q: np.ndarray) -> np.ndarray:
    """(6, n_parameters): d(rotation in the target frame, position) / dp of W * tool pose * T, from Pinocchio."""
    robot = loaded.model.robot(p)
    chain, n_bodies, n = robot.chain, len(robot.chain.rotation), robot.chain.n_joints
    model, constraints = chain.pinocchio_model()
    data = model.createData()
    at = np.concatenate(
        [[v] if j.nq == 1 else [np.cos(v), np.sin(v)] for j, v in zip(list(model.joints)[1:], q, strict=True)]
    )
    pin.computeJointJacobians(model, data, at)
    pin.updateFramePlacements(model, data)

    def motion_of(joint: int, placement: pin.SE3) -> tuple[pin.SE3, np.ndarray, np.ndarray]:
        """A frame on a joint: where it is, and its world-aligned twist by joints and by body placement errors."""
        where = data.oMi[joint] * placement
        to_world = np.kron(np.eye(2), where.rotation)
        by_error = np.zeros((6, 6 * n_bodies))
        by_joint = np.zeros((6, n))
        if joint:
            local = pin.computeJointKinematicRegressor(model, data, joint, pin.ReferenceFrame.LOCAL, placement)
            by_error[:, : 6 * n] = to_world @ local
            by_joint = (
                to_world
                @ placement.toActionMatrixInverse()
                @ pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL)
            )
        return where, by_joint, by_error

    by_joint, by_error = [np.zeros((0, n))], [np.zeros((0, 6 * n_bodies))]
    for loop, constraint in zip(chain.loops, constraints, strict=True):
        ends = (
            (constraint.joint1_id, constraint.joint1_placement),
            (constraint.joint2_id, constraint.joint2_placement),
        )
        joints, errors = np.zeros((6, n)), np.zeros((6, 6 * n_bodies))
        for sign, body, (joint, placement) in zip((-1, 1), loop.bodies, ends, strict=True):
            where, j, e = motion_of(joint, placement)
            e[:, 6 * body : 6 * body + 6] += np.kron(np.eye(2), where.rotation)  # the frame's own error
            joints, errors = joints + sign * j, errors + sign * e
        by_joint.append(joints[: loop.rows])
        by_error.append(errors[: loop.rows])
    phi_q, phi_x = np.concatenate(by_joint), np.concatenate(by_error)

    # the target: W * base^-1 * joint * tool * T
    tool_target = pin.SE3(chain.tool.rotation, chain.tool.translation) * pin.SE3(
        robot.target.rotation, robot.target.translation
    )
    where, tool_q, tool_x = motion_of(chain.tool_joint + 1, tool_target)
    passive, actuated = chain.passive, chain.actuated
    if len(phi_q):
        solve = np.linalg.solve(phi_q[:, passive], np.concatenate([phi_q[:, actuated], phi_x], axis=1))
        tool_a = tool_q[:, actuated] - tool_q[:, passive] @ solve[:, : len(actuated)]
        tool_x = tool_x - tool_q[:, passive] @ solve[:, len(actuated) :]
    else:
        tool_a = tool_q[:, actuated]

    # p's coordinates: positions in the parent's frame, rotation vectors r with R = nominal exp(r)
    xi = _placement_changes(loaded, p)
    for k in range(n_bodies):
        block = tool_x[:, 6 * k : 6 * k + 6]
        tool_x[:, 6 * k : 6 * k + 6] = np.concatenate(
            [block[:, :3] @ chain.rotation[k].T, block[:, 3:] @ _right_jacobian(xi[k, 3:])], axis=1
        )
    kept = [
        6 * k + i
        for k in range(n_bodies)
        for i in range(6)
        if i < 3 or not any(k in loop.bodies and loop.kind == "point" for loop in chain.loops)
    ]

    to_measurement = robot.instrument.rotation @ chain.base.rotation.T
    in_target = where.rotation.T

    def output(twist: np.ndarray) -> np.ndarray:
        """World-aligned twists as rotation in the target frame and velocity in the measurement frame."""
        return np.concatenate([in_target @ twist[3:], to_measurement @ twist[:3]])

    base_pose = chain.base.inverse() @ Motion(where.rotation, where.translation)
    vector_w, vector_t = robot.instrument.vector()[3:], robot.target.vector()[3:]
    turn_w, turn_t = _right_jacobian(vector_w), _right_jacobian(vector_t)
    instrument = np.block(
        [
            [np.zeros((3, 3)), base_pose.rotation.T @ turn_w],
            [np.eye(3), -robot.instrument.rotation @ skew(base_pose.translation) @ turn_w],
        ]
    )
    tool_rotation = base_pose.rotation @ robot.target.rotation.T
    target = np.block([[np.zeros((3, 3)), turn_t], [robot.instrument.rotation @ tool_rotation, np.zeros((3, 3))]])
    actuators = output(tool_a)
    return np.concatenate([output(tool_x)[:, kept], actuators, actuators * reading, instrument, target], axis=1)


def _placement_changes(loaded, p: np.ndarray) -> np.ndarray:
    """(n_bodies, 6): p's placement changes, sorted into place by the parameters' names."""
    names = loaded.chain.body_names
    changes = np.zeros((len(names), 6))
    for name, value in zip(loaded.model.parameters.names, p, strict=True):
        body, _, coordinate = name.rpartition(".")
        if body in names and coordinate in COORDINATES:
            changes[names.index(body), COORDINATES.index(coordinate)] = value
    return changes


def _right_jacobian(vector: np.ndarray) -> np.ndarray:
    """Pinocchio's own."""
    return pin.Jexp3(vector)


@pytest.mark.parametrize("kind", ["nominal", "off"])
@pytest.mark.parametrize("name", [*ROBOTS, *LARGE_ROBOTS])
def test_pose_jacobian_is_pinocchios(name, kind, robot):
    """Every column, at nominal and at a robot that is off, to 1e-9 of the largest entry."""
    loaded = robot(name)
    p, readings = parameters(loaded, kind), loaded.readings(5, 9)
    closure = loaded.model.robot(p).close(readings)
    assert closure.closed.all()
    ours = loaded.model.pose_jacobian(p, readings, closure.q)
    assert np.linalg.matrix_rank(ours.reshape(-1, len(p))) > 12
    for k in range(len(readings)):
        independent = pinocchio_pose_jacobian(loaded, p, readings[k], closure.q[k])
        np.testing.assert_allclose(ours[k], independent, rtol=0, atol=1e-9 * np.abs(independent).max())
