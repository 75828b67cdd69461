"""W and T from a closed-form start: motions of any size between the base and the instrument, the tool and its target.

Measured = W * tool pose * T. Rotations: the linear system R_m X = Y R (X = T^T, Y = W) by its smallest singular vector
(Shah 2013, J. Mechanisms Robotics 5, 031007); tilt gives one row of it. Where the poses don't excite it (one axis, or
pure translation) alternating orthogonal Procrustes from the 24 rotations of a cube stands in. Translations are linear
once the rotations are known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from kincal.identification.channels import all_turns, named
from kincal.identification.channels.channel import UP
from kincal.identification.channels.tilt import vertical_in_target
from kincal.identification.measurements import Measurements
from kincal.urdf.errors import InputError
from kincal.urdf.rigid_motion import Motion

MIN_POSES = 3
_MOST = 2000  # poses a start is computed from
_ALTERNATIONS = 50
_ALONE = 3.0  # the smallest singular value stands alone when the next is this many times larger
_NULL = 1e-12  # of the sum of squared rotations less their mean: below, an offset along it shows nothing
_CUBE = Rotation.create_group("O").as_matrix()


@dataclass(frozen=True)
class _Candidate:
    cost: float
    instrument: np.ndarray  # (3, 3)
    target: np.ndarray  # (3, 3)


def starts(tool: Motion, measured: Measurements, quick: bool = False) -> list[tuple[Motion, Motion]]:
    """Starts for (W, T), best guess first, from tool poses in the base frame (n) and what was measured there.

    quick: where the tool's own turns would give a closed form, and what was measured does not, there is no start.
    Raises InputError where there are fewer than 3 poses, or no start.
    """
    if len(measured) < MIN_POSES:
        raise InputError(f"measurements: {len(measured)} poses can't register W and T; at least {MIN_POSES} are needed")
    rows = np.linspace(0, len(measured) - 1, min(len(measured), _MOST)).astype(int)
    tool, measured = tool[rows], measured[rows]
    rotation, tilt, position = _orientation(measured), measured.values.get("tilt"), measured.values.get("position")
    if rotation is not None:
        candidates = _kronecker(rotation, tool.rotation)
        if quick and candidates is None and _kronecker(tool.rotation, tool.rotation) is not None:
            raise InputError("measurements: the orientations are no turns of this tool")
        pairs = [candidates or _alternate(rotation, tool.rotation)]
        if candidates is None and position is not None:  # a tool that does not turn: its path tells W
            pairs += [
                (w, _procrustes(np.einsum("nji,kj,nkl->il", tool.rotation, w, rotation)))
                for w, _ in _alternate_positions(position, tool)
            ]
    elif tilt is not None:
        up = vertical_in_target(tilt)
        pairs = [
            (turn @ instrument, target)
            for instrument, target in [_kronecker_tilt(up, tool.rotation) or _alternate_tilt(up, tool.rotation)]
            for turn in (_about_gravity(8) if position is not None else [np.eye(3)])
        ]
    elif position is not None:
        pairs = _alternate_positions(position, tool)
    else:  # a heading alone: nothing to hold on to
        pairs = [(np.eye(3), np.eye(3))]
    candidates = [_with_translations(pair, tool, measured) for pair in pairs]
    return [(w, t) for _, w, t in sorted(candidates, key=lambda f: f[0])][:4]


def instrument_starts(target: Motion, measured: Measurements) -> list[Motion]:
    """Starts for W alone, from target poses in the base frame (n) and what was measured there."""
    rotation, tilt, position = _orientation(measured), measured.values.get("tilt"), measured.values.get("position")
    if rotation is not None:
        turns = [_procrustes(np.einsum("nij,nkj->ik", rotation, target.rotation))]
    elif tilt is not None:
        upright = _from_vertical(np.einsum("nij,nj->i", target.rotation, vertical_in_target(tilt)))
        turns = [turn @ upright for turn in _about_gravity(8 if position is not None else 1)]
    elif position is not None:
        turns = [_procrustes(_centred(position).T @ _centred(target.translation))]
    else:
        turns = [np.eye(3)]
    if position is None:
        return [Motion(w, np.zeros(3)) for w in turns]
    return [Motion(w, (position - target.translation @ w.T).mean(axis=0)) for w in turns]


def _centred(points: np.ndarray) -> np.ndarray:
    return points - points.mean(axis=0)


def _orientation(measured: Measurements) -> np.ndarray | None:
    return measured.as_poses().rotation if all_turns(measured.channels) else None


def _procrustes(matrix: np.ndarray) -> np.ndarray:
    """The rotations nearest to matrices (..., 3, 3)."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    return u @ vt


def _kronecker(measured: np.ndarray, tool: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """W and T from R_m T^T - W R = 0, linear in both: (9 n, 18)."""
    n = len(tool)
    eye = np.eye(3)
    for_w = -np.einsum("ik,nlj->nijkl", eye, tool).reshape(9 * n, 9)
    for_x = np.einsum("nik,lj->nijkl", measured, eye).reshape(9 * n, 9)
    smallest = _smallest(np.concatenate([for_w, for_x], axis=1))
    if smallest is None:
        return None
    w, x = smallest[:9].reshape(3, 3), smallest[9:].reshape(3, 3)
    sign = np.sign(np.linalg.det(w)) or 1.0
    return _procrustes(sign * w), _procrustes(sign * x).T


def _smallest(matrix: np.ndarray) -> np.ndarray | None:
    """The right singular vector of the smallest singular value; None where that one does not stand alone."""
    _, singular, vt = np.linalg.svd(np.linalg.qr(matrix, mode="r"))
    alone = len(singular) == len(vt) and singular[-2] > max(_ALONE * singular[-1], 1e-9 * singular[0])
    return vt[-1] if alone else None


def _alternate(measured: np.ndarray, tool: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    best = _Candidate(np.inf, np.eye(3), np.eye(3))
    for target in _CUBE:
        for _ in range(_ALTERNATIONS):
            w = _procrustes(np.einsum("nij,kj,nlk->il", measured, target, tool))
            target = _procrustes(np.einsum("nji,kj,nkl->il", tool, w, measured))
        cost = float(np.sum((w @ tool @ target - measured) ** 2))
        best = min(best, _Candidate(cost, w, target), key=lambda c: c.cost)
    return best.instrument, best.target


def _from_vertical(vertical: np.ndarray) -> np.ndarray:
    """A rotation W with W^T e_z along `vertical` (in the base frame), turned as little as possible."""
    return Rotation.align_vectors(UP[None], vertical[None])[0].as_matrix()


def _kronecker_tilt(up: np.ndarray, tool: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    """W (but for its turn about gravity) and T from T g_m - R^T v = 0, linear in T and v = W^T e_z: (3 n, 12)."""
    n = len(tool)
    for_t = np.einsum("ik,nl->nikl", np.eye(3), up).reshape(3 * n, 9)
    for_v = -tool.swapaxes(1, 2).reshape(3 * n, 3)
    smallest = _smallest(np.concatenate([for_t, for_v], axis=1))
    if smallest is None:
        return None
    sign = np.sign(np.linalg.det(smallest[:9].reshape(3, 3))) or 1.0
    vertical = sign * smallest[9:]
    length = np.linalg.norm(vertical)
    return _from_vertical(vertical / length if length > 0 else UP), _procrustes(sign * smallest[:9].reshape(3, 3))


def _alternate_tilt(up: np.ndarray, tool: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    best = (np.inf, UP, np.eye(3))
    for target in _CUBE:
        for _ in range(_ALTERNATIONS):
            vertical = np.einsum("nij,jk,nk->i", tool, target, up)
            vertical /= max(np.linalg.norm(vertical), 1e-300)
            target = _procrustes(np.einsum("nji,j,nk->ik", tool, vertical, up))
        cost = float(np.sum((up @ target.T - np.einsum("nji,j->ni", tool, vertical)) ** 2))
        best = min(best, (cost, vertical, target), key=lambda c: c[0])
    return _from_vertical(best[1]), best[2]


def _alternate_positions(measured: np.ndarray, tool: Motion) -> list[tuple[np.ndarray, np.ndarray]]:
    """W's rotation from positions alone: the two best of 24 starts, translations and rotation in turn."""
    moments, w = _Moments.of(measured, tool), _CUBE
    for _ in range(_ALTERNATIONS):
        w = _procrustes(moments.correlation(moments.offset(w)))
    costs = [_translations(one, tool, measured)[2] for one in w]
    return [(w[k], np.eye(3)) for k in np.argsort(costs, kind="stable")[:2]]


@dataclass(frozen=True)
class _Moments:
    """All that translations and rotation of the alternation need of the poses, summed once."""

    turned: np.ndarray  # (3, 3) mean of the tool's rotations R
    mixed: np.ndarray  # (3, 3, 3) [i, j, k]: sum of (R - mean)_ji y_k
    moved: np.ndarray  # (3,) [i]: sum of (R - mean)_ji x_j
    inverse: np.ndarray  # (3, 3) pseudo-inverse of sum of (R - mean)' (R - mean)
    null: np.ndarray  # (3, k) offsets along which all R are the same
    path: np.ndarray  # (3, 3) sum of the centred measured (row) and tool positions (column)
    centre: tuple[np.ndarray, np.ndarray]  # (3,) means of measured and tool positions

    @classmethod
    def of(cls, measured: np.ndarray, tool: Motion) -> _Moments:
        turned = tool.rotation.mean(axis=0)
        apart = tool.rotation - turned
        values, vectors = np.linalg.eigh(np.einsum("nji,njk->ik", apart, apart))
        known = values > _NULL * len(measured)
        return cls(
            turned,
            np.einsum("nji,nk->ijk", apart, measured),
            np.einsum("nji,nj->i", apart, tool.translation),
            (vectors[:, known] / values[known]) @ vectors[:, known].T,
            vectors[:, ~known],
            _centred(measured).T @ _centred(tool.translation),
            (measured.mean(axis=0), tool.translation.mean(axis=0)),
        )

    def offset(self, w: np.ndarray) -> np.ndarray:
        """(m, 3) T's translations of least squares, and of least norm together with W's, for rotations w (m, 3, 3)."""
        offset = (np.einsum("ijk,mkj->mi", self.mixed, w) - self.moved) @ self.inverse
        measured, tool = self.centre
        shift = np.einsum("mkj,k->mj", w, measured) - tool - offset @ self.turned.T
        # along a null direction v the sum stays the same with v in the offset and -R v in W's translation
        return offset + 0.5 * (shift @ self.turned @ self.null) @ self.null.T

    def correlation(self, offset: np.ndarray) -> np.ndarray:
        """(m, 3, 3) of centred measured positions (row) and predicted ones (column)."""
        return self.path + np.einsum("ijk,mi->mkj", self.mixed, offset)


def _about_gravity(n: int) -> list[np.ndarray]:
    return [Rotation.from_euler("z", 2 * np.pi * k / n).as_matrix() for k in range(n)]


def _translations(w: np.ndarray, tool: Motion, position: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """T's and W's translations by linear least squares (of least norm), and the sum of squares left."""
    n = len(position)
    system = np.concatenate([tool.rotation.reshape(3 * n, 3), np.tile(np.eye(3), (n, 1))], axis=1)
    right = (position @ w - tool.translation).ravel()
    solution = np.linalg.lstsq(system, right, rcond=1e-9)[0]
    return solution[:3], w @ solution[3:], float(np.sum((system @ solution - right) ** 2))


def _with_translations(pair, tool: Motion, measured: Measurements) -> tuple[float, Motion, Motion]:
    """Both motions, and a cost by which starts are ordered: the weighted squares of all channels."""
    w, t = pair
    offset, shift = np.zeros(3), np.zeros(3)
    if "position" in measured.values:
        offset, shift, _ = _translations(w, tool, measured.values["position"])
    predicted = Motion(w, shift) @ tool @ Motion(t, offset)
    cost = 0.0
    for channel in named(measured.channels):
        error = channel.start_error(predicted, measured.values[channel.name])
        if error is not None:
            cost += float(np.sum(error**2) / np.mean(measured.std[channel.name]) ** 2)
    return cost, Motion(w, shift), Motion(t, offset)
