"""Loop closure of the paper's 1331 poses, against scipy's root finder over Pinocchio's constraints, pose by pose."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.optimize import root

from benchmarks.setup import grid, measured_robot
from benchmarks.timing import median_seconds, row
from kincal.urdf.kinematics import forward, inverse


def main() -> None:
    errors, _ = measured_robot("ups3_s", 10)
    chain = errors.chain
    u = grid(errors, 11)
    joints = inverse(chain, u).q[:, chain.actuated]
    ours = forward(chain, joints)
    row("loop closure of 1331 poses (ups3_s)", median_seconds(lambda: forward(chain, joints)))
    row("inverse kinematics of 1331 poses (ups3_s)", median_seconds(lambda: inverse(chain, u)))
    some = joints[::10]
    peer = close_with_scipy(chain, some)
    apart = np.abs(peer - ours.q[::10]).max()
    seconds = median_seconds(lambda: close_with_scipy(chain, some), runs=1) * len(joints) / len(some)
    row(
        "  peer: scipy.optimize.root over Pinocchio, 1331 poses",
        seconds,
        f"from {len(some)}; solutions differ by {apart:.0e}",
    )


def close_with_scipy(chain, joints: np.ndarray) -> np.ndarray:
    """(n, n_joints): every pose by scipy's hybrid method with Pinocchio's exact Jacobians."""
    model, constraints = chain.pinocchio_model()
    data = model.createData()
    ends = [(c.joint1_id, c.joint1_placement, c.joint2_id, c.joint2_placement) for c in constraints]
    passive, found = chain.passive, np.tile(chain.home, (len(joints), 1))

    def equations(free: np.ndarray, q: np.ndarray):
        q[passive] = free
        pin.computeJointJacobians(model, data, q)
        value, jacobian = [], []
        for j1, m1, j2, m2 in ends:
            sides = []
            for j, m in ((j1, m1), (j2, m2)):
                placed = data.oMi[j] * m
                local = pin.getJointJacobian(model, data, j, pin.LOCAL)
                sides.append((placed.translation, placed.rotation @ (m.inverse().action @ local)[:3]))
            value.append(sides[1][0] - sides[0][0])
            jacobian.append((sides[1][1] - sides[0][1])[:, passive])
        return np.concatenate(value), np.concatenate(jacobian)

    for q, actuated in zip(found, joints, strict=True):
        q[chain.actuated] = actuated
        q[passive] = root(equations, q[passive], args=(q,), jac=True, tol=1e-13).x
    return found


if __name__ == "__main__":
    main()
