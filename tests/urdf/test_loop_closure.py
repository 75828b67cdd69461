"""Loop closure, forward and inverse kinematics of any robot: against each other, finite differences and Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kincal.urdf.kinematics import (
    actuator_jacobian,
    forward,
    inverse,
    loop_error,
    loop_jacobian,
    passive_rates,
    tool_coordinates,
    tool_jacobian,
    tool_point_jacobian,
    tool_pose,
    tree,
)
from kincal.urdf.rigid_motion import exp
from kincal.urdf.workspace import bounds

ROBOTS = ("ups3_s", "jugglebot", "ur10", "ups3_frame", "linear_delta", "rps3")
unit = st.lists(st.floats(0, 1), min_size=6, max_size=6)
seeds = st.integers(0, 2**20)


def perturbed(chain, seed: int, size: float = 1e-2):
    """The chain with every placement moved at random by about `size` [m, rad]."""
    random = np.random.default_rng(seed)
    turned = chain.rotation @ exp(size * random.normal(size=(len(chain.rotation), 3)))
    return chain.with_geometry(turned, chain.translation + size * random.normal(size=chain.translation.shape))


def pinocchio_configuration(model, q: np.ndarray) -> np.ndarray:
    """Joint values as Pinocchio's configuration, where a continuous joint is a point on the unit circle."""
    found = []
    for joint, value in zip(list(model.joints)[1:], q, strict=True):
        found += [value] if joint.nq == 1 else [np.cos(value), np.sin(value)]
    return np.array(found)


@pytest.mark.parametrize("name", ROBOTS)
@given(values=unit)
def test_inverse_then_forward_returns_to_the_tool_coordinates(name, values, robot):
    """Any pose of the workspace, its corners included."""
    loaded = robot(name)
    chain, axes = loaded.chain, list(loaded.chain.tool_axes)
    low, high = bounds(loaded.description.workspace).T
    u = np.zeros((1, 6))
    u[0, axes] = low + np.array(values[: len(axes)]) * (high - low)
    joints = inverse(chain, u)
    tool = forward(chain, joints.q[:, chain.actuated])
    assert joints.closed.all()
    assert tool.closed.all()
    np.testing.assert_allclose(tool_coordinates(chain, tool.pose)[:, axes], u[:, axes], rtol=0, atol=1e-10)
    for q in (joints.q, tool.q):
        assert np.abs(loop_error(chain, tree(chain, q))).max(initial=0) < 1e-11


@pytest.mark.parametrize("name", ROBOTS)
@given(seed=seeds)
def test_jacobians_are_the_derivatives_of_loop_error_and_tool_coordinates(name, seed, robot, central_difference):
    """Central differences, also at configurations whose loops are open and with geometry that is off."""
    loaded = robot(name)
    chain = perturbed(loaded.chain, seed)
    q = loaded.chain.home + 0.1 * np.random.default_rng(seed).normal(size=chain.n_joints)
    frames = tree(chain, q[None])

    loops = central_difference(lambda at: loop_error(chain, tree(chain, at)), q)
    np.testing.assert_allclose(loop_jacobian(chain, frames)[0], loops, rtol=0, atol=1e-9)

    tool = central_difference(lambda at: tool_coordinates(chain, tool_pose(chain, tree(chain, at))), q)
    np.testing.assert_allclose(tool_jacobian(chain, frames)[0], tool, rtol=0, atol=1e-8)

    point = np.array([0.1, -0.2, 0.3])

    def world_point(at: np.ndarray) -> np.ndarray:
        placed = chain.tool.rotation @ point + chain.tool.translation
        return tree(chain, at).point(chain.tool_joint, placed)

    np.testing.assert_allclose(
        tool_point_jacobian(chain, q[None], point)[0], central_difference(world_point, q), rtol=0, atol=1e-9
    )


@pytest.mark.parametrize("name", ROBOTS)
@given(seed=seeds)
def test_forward_kinematics_of_the_tree_is_pinocchios(name, seed, robot):
    """pin.forwardKinematics and its constraint models, with geometry that is off and loops that are open."""
    loaded = robot(name)
    chain = perturbed(loaded.chain, seed)
    q = loaded.chain.home + 0.3 * np.random.default_rng(seed).normal(size=chain.n_joints)
    frames = tree(chain, q[None])
    model, constraints = chain.pinocchio_model()
    data = model.createData()
    pin.forwardKinematics(model, data, pinocchio_configuration(model, q))
    for j in range(chain.n_joints):
        np.testing.assert_allclose(frames.rotation[j][0], data.oMi[j + 1].rotation, rtol=0, atol=1e-13)
        np.testing.assert_allclose(frames.translation[j][0], data.oMi[j + 1].translation, rtol=0, atol=1e-13)

    assert len(constraints) == len(chain.loops)
    error, row = loop_error(chain, frames)[0], 0
    for loop, constraint in zip(chain.loops, constraints, strict=True):
        first = data.oMi[constraint.joint1_id] * constraint.joint1_placement
        second = data.oMi[constraint.joint2_id] * constraint.joint2_placement
        np.testing.assert_allclose(error[row : row + 3], second.translation - first.translation, rtol=0, atol=1e-13)
        if loop.kind == "frame":
            vector = pin.log3(first.rotation.T @ second.rotation)
            expected = vector * np.sinc(np.linalg.norm(vector) / np.pi)
            np.testing.assert_allclose(error[row + 3 : row + 6], expected, rtol=0, atol=1e-12)
        row += loop.rows


@pytest.mark.parametrize("name", ROBOTS)
def test_pinocchio_finds_the_loops_closed(name, robot):
    """Pinocchio's own constraint errors vanish at our closed configurations."""
    loaded = robot(name)
    model, constraints = loaded.chain.pinocchio_model()
    data = model.createData()
    for q in loaded.configurations(5, 3):
        pin.forwardKinematics(model, data, pinocchio_configuration(model, q))
        for constraint in constraints:
            first = data.oMi[constraint.joint1_id] * constraint.joint1_placement
            apart = first.actInv(data.oMi[constraint.joint2_id] * constraint.joint2_placement)
            rows = 3 if isinstance(constraint, pin.PointAnchorConstraintModel) else 6
            assert np.abs(pin.log6(apart).vector[:rows]).max() < 1e-11
    tool = loaded.description.tool_frame
    pin.updateFramePlacements(model, data)
    base = data.oMf[model.getFrameId(loaded.description.base_frame)]
    expected = base.actInv(data.oMf[model.getFrameId(tool)])
    ours = tool_pose(loaded.chain, tree(loaded.chain, q[None]))
    np.testing.assert_allclose(ours.rotation[0], expected.rotation, rtol=0, atol=1e-12)
    np.testing.assert_allclose(ours.translation[0], expected.translation, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_passive_rates_are_the_derivatives_of_the_closed_configuration(name, robot, central_difference):
    """Central differences of forward kinematics, the loops closed anew at every step."""
    loaded = robot(name)
    chain = loaded.chain
    q = loaded.configurations(3, 5)
    rates = passive_rates(chain, q)
    for k in range(len(q)):

        def closed(actuated: np.ndarray, near=q[k]) -> np.ndarray:
            return forward(chain, actuated, np.tile(near, (len(actuated), 1))).q

        numerical = central_difference(closed, q[k, chain.actuated])
        np.testing.assert_allclose(rates[k], numerical, rtol=0, atol=1e-8 * np.abs(numerical).max())


@pytest.mark.parametrize("name", ROBOTS)
def test_actuator_jacobian_is_the_derivative_of_inverse_kinematics(name, robot, central_difference):
    """Central differences of inverse kinematics, the loops closed anew at every step."""
    loaded = robot(name)
    chain, axes = loaded.chain, list(loaded.chain.tool_axes)
    for u in 0.8 * loaded.coordinates(3, 6):

        def joints(values: np.ndarray, u=u) -> np.ndarray:
            at = np.tile(u, (len(values), 1))
            at[:, axes] = values
            return inverse(chain, at).q[:, chain.actuated]

        exact = actuator_jacobian(chain, inverse(chain, u[None]).q)[0]
        numerical = central_difference(joints, u[axes])
        np.testing.assert_allclose(exact, numerical, rtol=0, atol=1e-8 * np.abs(numerical).max())


@pytest.mark.parametrize("name", ROBOTS)
def test_a_start_far_from_home_and_the_whole_batch_give_the_same_configuration(name, robot):
    """One pose alone, in a batch, and from a neighbour: batches have no second code path."""
    loaded = robot(name)
    chain, q = loaded.chain, loaded.configurations(6, 8)
    together = forward(chain, q[:, chain.actuated])
    alone = np.concatenate([forward(chain, row[None, chain.actuated]).q for row in q])
    started = forward(chain, q[:, chain.actuated], np.roll(q, 1, axis=0))
    np.testing.assert_allclose(together.q, alone, rtol=0, atol=1e-12)
    assert together.closed.all()
    np.testing.assert_allclose(started.pose.rotation, together.pose.rotation, rtol=0, atol=1e-10)
