"""Symbolic elimination against numpy's; symbolic frames and Jacobians against those of whole batches."""

import casadi as ca
import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from kincal.identification.elimination import eliminate
from kincal.identification.symbolic_chain import joint_frames, loop_equations, loop_rates, tool_placement, tool_rates
from kincal.urdf.kinematics import loop_error, loop_jacobian, tool_coordinates, tool_jacobian, tool_pose, tree
from kincal.urdf.rigid_motion import xyz_rates


@given(st.integers(1, 7), st.integers(1, 3), st.floats(0.2, 1.0), st.integers(0, 10**6))
def test_sparse_systems(n, columns, dense, seed):
    """Where the samples are what is solved, pivots are as good as numpy's own."""
    random = np.random.default_rng(seed)
    numbers = random.normal(size=(n, n)) * (random.random((n, n)) < dense)
    assume(np.linalg.matrix_rank(numbers) == n and np.linalg.cond(numbers) < 1e6)
    right = random.normal(size=(n, columns))
    matrix = ca.sparsify(ca.SX(ca.sparsify(ca.DM(numbers))))
    x, determinant = eliminate(matrix, ca.SX(right), numbers[None])
    found = ca.Function("solved", [], [x, determinant])()
    np.testing.assert_allclose(found["o0"].full(), np.linalg.solve(numbers, right), rtol=1e-8, atol=1e-9)
    assert float(found["o1"]) == pytest.approx(np.linalg.det(numbers), rel=1e-8)


def test_a_pivot_that_vanishes_somewhere_is_not_taken():
    """The corner is free of fill-in, but 0 at one of the samples."""
    symbols = ca.SX.sym("a", 2, 2)
    samples = np.array([[[1.0, 1.0], [1.0, 3.0]], [[0.0, 1.0], [1.0, 3.0]]])
    x, determinant = eliminate(symbols, ca.SX([1.0, 2.0]), samples)
    solved = ca.Function("solved", [symbols], [x, determinant])
    for numbers in samples:
        found, value = solved(numbers)
        np.testing.assert_allclose(found.full()[:, 0], np.linalg.solve(numbers, [1.0, 2.0]), rtol=1e-14)
        assert float(value) == pytest.approx(np.linalg.det(numbers), rel=1e-14)


@pytest.mark.parametrize("name", ["ups3_s", "ups3_frame", "linear_delta", "ur10"])
def test_the_symbolic_chain_is_the_numeric_one(robot, name):
    """Loop errors, tool poses and both Jacobians, off the closed configurations too."""
    chain = robot(name).chain
    q = ca.SX.sym("q", chain.n_joints)
    placed = [(ca.DM(r), ca.DM(t)) for r, t in zip(chain.rotation, chain.translation, strict=True)]
    frames = joint_frames(chain, q, placed)
    tool = tool_placement(chain, frames)
    outputs = [
        loop_equations(chain, frames, placed),
        loop_rates(chain, frames, placed),
        *tool,
        tool_rates(chain, frames),
    ]
    function = ca.Function("walked", [q], [ca.densify(o) for o in outputs])
    configurations = robot(name).configurations(5, seed=1)
    configurations = configurations + 0.1 * np.random.default_rng(2).normal(size=configurations.shape)
    numeric = tree(chain, configurations)
    pose, angles = tool_pose(chain, numeric), tool_jacobian(chain, numeric)
    for row, values in enumerate(configurations):
        error, rates, rotation, position, moved = (o.full() for o in function(values))
        np.testing.assert_allclose(error[:, 0], loop_error(chain, numeric)[row], atol=1e-14)
        np.testing.assert_allclose(rates, loop_jacobian(chain, numeric)[row], atol=1e-13)
        np.testing.assert_allclose(rotation, pose.rotation[row], atol=1e-14)
        np.testing.assert_allclose(position[:, 0], pose.translation[row], atol=1e-14)
        np.testing.assert_allclose(moved[:3], angles[row, :3], atol=1e-13)
        turned = chain.home_pose.rotation.T @ moved[3:]
        at = tool_coordinates(chain, pose)[row, 3:]
        np.testing.assert_allclose(xyz_rates(at) @ turned, angles[row, 3:], atol=1e-11)
