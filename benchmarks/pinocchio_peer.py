"""The peer of identification: what one would write today with Pinocchio and scipy.

For every parameter vector Pinocchio's model gets its joint placements; every pose's loops are closed by Newton with the
constraint models' own errors and Jacobians; `scipy.optimize.least_squares` differentiates by finite differences.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.optimize import OptimizeResult, least_squares

from kincal.identification.error_model import ErrorModel
from kincal.identification.estimators import Estimate
from kincal.identification.measurements import Measurements

_FLAT_SCALE = 1e-2  # of W and T [m, rad], as kincal has it
_CLOSED = 1e-13  # [m, rad]


def residuals(errors: ErrorModel, measured: Measurements, p: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Whitened residuals of all poses, then of the priors; start: (n, n_joints) configurations near by."""
    robot = errors.robot(p)
    chain = robot.chain
    model, constraints = chain.pinocchio_model()
    assert model.nq == model.nv == chain.n_joints
    data, own = model.createData(), [c.createData() for c in constraints]
    passive, tool_joint = chain.passive, chain.tool_joint + 1
    base, tool = (pin.SE3(m.rotation, m.translation) for m in (chain.base.inverse(), chain.tool))
    instrument, target = (pin.SE3(m.rotation, m.translation) for m in (robot.instrument, robot.target))
    joints, found = robot.actuators.joints(measured.readings), []
    for k, q in enumerate(start.copy()):
        q[chain.actuated] = joints[k]
        for _ in range(20):
            pin.computeJointJacobians(model, data, q)
            error = _errors(model, data, constraints, own)
            if not error.size or np.abs(error).max() < _CLOSED:
                break
            jacobian = np.concatenate([c.jacobian(model, data, d) for c, d in zip(constraints, own, strict=True)])
            q[passive] -= np.linalg.solve(jacobian[:, passive], error)
        else:
            raise ArithmeticError(f"pose {k}: its loops can't be closed")
        pose = instrument * base * data.oMi[tool_joint] * tool * target
        found += [row / sigma for row, sigma in _channels(pose, measured, k)]
    return np.concatenate([*found, p / errors.parameters.tolerance])


def _errors(model, data, constraints: list, own: list) -> np.ndarray:
    errors = [np.zeros(0)]
    for constraint, of in zip(constraints, own, strict=True):
        constraint.calc(model, data, of)
        errors.append(of.constraint_position_error)
    return np.concatenate(errors)


def _channels(pose: pin.SE3, measured: Measurements, k: int):
    """Predicted less measured, and the sigma."""
    if "orientation" in measured.values:
        yield pin.log3(measured.values["orientation"][k].T @ pose.rotation), measured.std["orientation"][k]
    if "position" in measured.values:
        yield pose.translation - measured.values["position"][k], measured.std["position"][k]


def solve(errors: ErrorModel, measured: Measurements, registered: Estimate) -> OptimizeResult:
    """From the registered robot, as kincal starts."""
    scale = np.where(errors.parameters.flat, _FLAT_SCALE, errors.parameters.tolerance)
    return least_squares(lambda p: residuals(errors, measured, p, registered.q), registered.p, x_scale=scale)
