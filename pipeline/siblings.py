"""Virtual siblings of a robot: the same drawing, other loads, stiffnesses and plays.

Every moving body has a mass at a random place, the tool a payload besides; the actuators give under their weight, by
virtual work, and some have a play that the load's direction takes up. Sizes are drawn around one: how large the real
robot's residuals are, its own poses say.
"""

from __future__ import annotations

import numpy as np

from urdf.closed_chain import ClosedChain
from urdf.kinematics import passive_rates, point_jacobian, tool_point_jacobian, tree

_BODY = 0.2  # of the payload's mass, an ordinary moving body's
_SPREAD = 0.5  # of the logarithm of masses and stiffnesses
_PLAY = 0.3  # share of the siblings whose actuators have a play
_TURN = 0.1  # of the load's size: over it the play changes sides
_ASKEW = 0.25  # share of the siblings whose base is mounted anyhow, not upright


def residuals(chain: ClosedChain, q: np.ndarray, count: int, seed: int) -> np.ndarray:
    """(count, n, n_actuated): by how much each sibling's joints give at closed configurations q (n, n_joints)."""
    random = np.random.default_rng([seed, 12])
    rates, frames = passive_rates(chain, q), tree(chain, q)
    reach = float(np.max(np.ptp(np.stack(frames.translation, axis=1), axis=1), initial=0.0)) or 1.0
    found = np.empty((count, len(q), rates.shape[2]))
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
        if random.random() < _PLAY:
            size = np.sqrt(np.mean(load**2, axis=0))
            give = give + random.normal(size=load.shape[1]) * size * np.tanh(load / np.maximum(_TURN * size, 1e-12))
        found[sibling] = give / max(float(np.sqrt(np.mean(give**2))), 1e-12)
    return found


def _place(random: np.random.Generator, reach: float) -> np.ndarray:
    return reach * random.normal(size=3) / np.sqrt(3)


def _raised(up: np.ndarray, jacobian: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """(n, n_actuated): how fast a point rises with the actuators; jacobian: (n, 3, n_joints)."""
    return np.einsum("i,nij,njk->nk", up, jacobian, rates)
