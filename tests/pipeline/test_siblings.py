"""Virtual siblings' residuals against virtual work: potential energy by finite differences, loops closed again."""

from functools import partial

import numpy as np
import pytest

from kincal.pipeline.virtual.siblings import residuals, unexplained
from kincal.urdf.kinematics import forward, tree


def heights(steps: np.ndarray, chain, row: np.ndarray, masses) -> np.ndarray:
    """(m,) what masses have of height, summed, after steps (m, n_actuated) of the actuators from one configuration.

    masses: (joint, kg, place, up); joint None: in the tool's frame.
    """
    closure = forward(chain, row[chain.actuated] + steps, np.repeat(row[None], len(steps), axis=0))
    assert closure.closed.all()
    frames, total = tree(chain, closure.q), np.zeros(len(steps))
    for joint, mass, place, up in masses:
        if joint is None:
            at = (closure.pose.translation + closure.pose.rotation @ place) @ chain.base.rotation.T
        else:
            at = frames.rotation[joint] @ place + frames.translation[joint]
        total += mass * at @ up
    return total


def give(loaded, q: np.ndarray, seed: int, count: int, central_difference) -> list[np.ndarray]:
    """The siblings written out anew: the load on an actuator is d(energy / g) / d(its value), in closed loops.

    Drawn in the order that `residuals` draws in: its sizes are taken from there, its mechanics are not.
    """
    chain, random = loaded.chain, np.random.default_rng([seed, 12])
    joints = np.stack(tree(chain, q).translation, axis=1)
    reach, found, n = np.max(np.ptp(joints, axis=1)), [], len(chain.actuated)
    for _ in range(count):
        up = random.normal(size=3) if random.random() < 0.25 else chain.base.rotation[:, 2]
        up = up / np.linalg.norm(up)
        masses = [(None, np.exp(0.5 * random.normal()), 0.5 * reach * random.normal(size=3) / np.sqrt(3), up)]
        for joint in range(len(chain.parents)):
            mass = 0.2 * np.exp(0.5 * random.normal())
            masses.append((joint, mass, 0.3 * reach * random.normal(size=3) / np.sqrt(3), up))
        load = [central_difference(partial(heights, chain=chain, row=r, masses=masses), np.zeros(n), 1e-4) for r in q]
        own = -np.array(load) * np.exp(0.5 * random.normal(size=n))
        found.append(own / np.sqrt(np.mean(own**2)))
    return found


@pytest.mark.parametrize("name", ["ups3_s", "rps3", "linear_delta", "jugglebot"])
def test_joints_give_by_virtual_work(robot, central_difference, name):
    loaded = robot(name)
    q = loaded.configurations(4, seed=1)
    found = residuals(loaded.chain, q, 6, seed=0)
    assert found.shape == (6, 4, len(loaded.chain.actuated))
    for one, expected in zip(found, give(loaded, q, 0, 6, central_difference), strict=True):
        np.testing.assert_allclose(one, expected, rtol=0, atol=2e-6)


def test_siblings_are_of_one_size_and_unlike_each_other(robot):
    loaded = robot("ups3_s")
    q = loaded.configurations(50, seed=2)
    found = residuals(loaded.chain, q, 20, seed=0)
    np.testing.assert_allclose(np.sqrt(np.mean(found**2, axis=(1, 2))), 1.0, rtol=1e-12)
    alike = np.corrcoef(found.reshape(20, -1))[~np.eye(20, dtype=bool)]
    assert alike.max() < 0.9999
    np.testing.assert_array_equal(residuals(loaded.chain, q, 5, seed=0), found[:5])
    assert np.abs(residuals(loaded.chain, q, 5, seed=1) - found[:5]).max() > 0.1


def test_poses_that_are_one_pose(robot):
    """No place of a joint moves between them: no division by a reach of zero."""
    loaded = robot("ups3_s")
    q = np.repeat(loaded.configurations(1, seed=3), 8, axis=0)
    assert np.isfinite(residuals(loaded.chain, q, 5, seed=0)).all()


@pytest.mark.parametrize("name", ["ups3_s", "jugglebot", "linear_delta"])
def test_what_geometry_explains_is_not_left(robot, name):
    """Zeros and gains of the actuators: next to nothing."""
    loaded = robot(name)
    model, q = loaded.model, loaded.configurations(120, seed=4)
    joints = q[:, loaded.chain.actuated]
    readings, moved = model.actuators.readings(joints), joints - joints.mean(axis=0)
    for shift in (np.ones_like(joints), moved / np.sqrt(np.mean(moved**2))):
        left = unexplained(model, readings, q, shift[None])
        assert np.sqrt(np.mean(left**2)) < 0.02 * size_of(model)


def test_what_no_geometry_explains_is_left(robot):
    """A short period: nearly all of it, in the unit of the zeros' tolerance."""
    loaded = robot("ups3_s")
    q = loaded.configurations(150, seed=4)
    joints = q[:, loaded.chain.actuated]
    shift = np.sqrt(2) * np.sin(2 * np.pi * joints / 0.02)
    left = unexplained(loaded.model, loaded.model.actuators.readings(joints), q, shift[None])
    assert left.shape == (1, *shift.shape)
    assert np.sqrt(np.mean(left**2)) < size_of(loaded.model)
    assert np.corrcoef(left.ravel(), shift.ravel())[0, 1] > 0.8


def size_of(model) -> float:
    zeros = [name.endswith(".zero") for name in model.parameters.names]
    return float(np.sqrt(np.mean(model.parameters.tolerance[zeros] ** 2)))
