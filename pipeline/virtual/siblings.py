"""Virtual siblings of a robot: the same drawing, other loads and stiffnesses; and what geometry leaves of them.

Every moving body has a mass at a random place, the tool a payload besides; the actuators give under their weight, by
virtual work. Sizes are drawn around one: how large the real robot's residuals are, its own poses say. Most of it looks
like another geometry and would be identified as such. Errors of one joint alone (screws, gears) have units of their
own; plays, which change sides with the load, cost more accuracy elsewhere than they gave and are left out.
"""

from __future__ import annotations

import numpy as np
import scipy.linalg

from kincal.identification.error_model import ErrorModel
from kincal.identification.expected import expected, prior_sigma
from kincal.identification.measurements import default_channels
from kincal.urdf.closed_chain import ClosedChain
from kincal.urdf.description import Sensor
from kincal.urdf.kinematics import passive_rates, point_jacobian, tool_point_jacobian, tree

_BODY = 0.2  # of the payload's mass, an ordinary moving body's
_SPREAD = 0.5  # of the logarithm of masses and stiffnesses
_LEFT = 0.01  # of the shifts' size, counts as nothing when geometry is fitted to them
_ASKEW = 0.25  # share of the siblings whose base is mounted anyhow, not upright


def residuals(chain: ClosedChain, q: np.ndarray, count: int, seed: int) -> np.ndarray:
    """(count, n, n_actuated): by how much each sibling's joints give at closed configurations q (n, n_joints)."""
    random = np.random.default_rng([seed, 12])
    rates, frames = passive_rates(chain, q), tree(chain, q)
    reach = float(np.max(np.ptp(np.stack(frames.translation, axis=1), axis=1), initial=0.0)) or 1.0
    shifts = np.empty((count, len(q), rates.shape[2]))
    for sibling in range(count):
        up = random.normal(size=3) if random.random() < _ASKEW else chain.base.rotation[:, 2]
        up = up / np.linalg.norm(up)
        load = np.exp(_SPREAD * random.normal()) * _raised(
            up, tool_point_jacobian(chain, q, _place(random, 0.5 * reach)), rates
        )
        for joint in range(len(chain.parents)):
            mass = _BODY * np.exp(_SPREAD * random.normal())
            load = load + mass * _raised(up, point_jacobian(chain, frames, joint, _place(random, 0.3 * reach)), rates)
        give = -load * np.exp(_SPREAD * random.normal(size=load.shape[1]))
        shifts[sibling] = give / max(float(np.sqrt(np.mean(give**2))), 1e-12)
    return shifts


def unexplained(model: ErrorModel, readings: np.ndarray, q: np.ndarray, give: np.ndarray) -> np.ndarray:
    """What an identification leaves of shifts `give` (count, n, n_actuated) of the joints, at closed configurations.

    readings: (n, n_actuated); q: (n, n_joints). The geometry has its tolerances, the actuators shifts of the size of
    their zeros' tolerance.
    """
    channels, zero = default_channels(model.chain.tool_axes), np.zeros(len(model.parameters))
    seen = expected(model, zero, readings, q, channels, Sensor())
    jacobian = model.jacobian(zero, seen, q)
    # the geometry's effect as a shift of the joints
    as_shift = np.linalg.pinv(jacobian[:, :, model.zeros]) @ (jacobian * prior_sigma(model.parameters))
    columns = as_shift.reshape(-1, as_shift.shape[2])
    size = model.parameters.tolerance[model.zeros]
    shifts = (give * size).reshape(len(give), -1).T
    noise = _LEFT * np.sqrt(np.mean(size**2))
    basis, r = np.linalg.qr(np.concatenate([columns / noise, np.eye(columns.shape[1])]))
    geometry = scipy.linalg.solve_triangular(r, basis[: len(columns)].T @ shifts / noise)
    left = shifts - columns @ geometry
    return left.T.reshape(give.shape)


def _place(random: np.random.Generator, reach: float) -> np.ndarray:
    return reach * random.normal(size=3) / np.sqrt(3)


def _raised(up: np.ndarray, jacobian: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """(n, n_actuated): how fast a point rises with the actuators; jacobian: (n, 3, n_joints)."""
    return np.einsum("i,nij,njk->nk", up, jacobian, rates)
