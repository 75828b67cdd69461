"""D-optimal poses: the set whose measurements shrink the parameters' joint uncertainty the most.

Maximises log det(I + sum J_i' J_i) over n of the candidates; J_i: (rows a pose, n_parameters) whitened, parameters in
units of their prior's sigma. It is the Bayesian information: directions that no pose shows change nothing. A start by
greedy selection (and some at random), then Fedorov's exchange (1972) in Cook and Nachtsheim's order (1980): each pose
in turn gives way to the candidate that raises the determinant most, until none does. A pose brings a block of rows, so
the determinants are those of blocks (matrix determinant lemma), and the covariance follows by Woodbury's identity.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from kincal.identification.error_model import ErrorModel
from kincal.identification.expected import Sites, feasible, information
from kincal.identification.registration import MIN_POSES
from kincal.identification.singular_values import svd
from kincal.urdf.description import Sensor, Workspace
from kincal.urdf.errors import InputError
from kincal.urdf.workspace import bounds, grid, sample

MAX_POSES = 1000
_CANDIDATES = (1000, 5000)  # between these, ten for each pose that is asked for
_FACES = 1.5  # evenly spread points are stretched by it and clipped: a third of each coordinate lies on a face
_SEEN = 1e-4  # of all candidates together: what is below adds less than 1e-8 to the log determinant
_GAIN = 1e-7  # of the log determinant; less is no gain
_PASSES = 50
_FEW = 30  # up to here random starts are tried beside the greedy one
_RESTARTS = 4


@dataclass(frozen=True)
class Selection:
    """Which candidates to measure, and what the exchange came to."""

    rows: np.ndarray  # (n,) of the candidates, ascending
    log_det: float  # of I + sum J'J
    history: tuple[float, ...]  # the log determinant after the start and after every pass of exchanges


def candidates(model: ErrorModel, workspace: Workspace, n: int, seed: int) -> Sites:
    """Feasible poses to choose n from: home, the corners, and evenly spread points inside, on faces and on edges.

    Raises InputError where fewer than three are feasible.
    """
    axes = model.chain.tool_axes
    low, high = bounds(workspace).T
    middle = np.zeros(6)
    middle[list(axes)] = (low + high) / 2
    total = int(np.clip(10 * n, *_CANDIDATES))
    even = middle + _FACES * (sample(workspace, axes, total, [seed, 11], even=True) - middle)
    even[:, list(axes)] = np.clip(even[:, list(axes)], low, high)
    corners = grid(workspace, axes, [2] * len(axes))
    u = np.concatenate([np.zeros((1, 6)), corners, even])
    u = u[np.sort(np.unique(u.round(9), axis=0, return_index=True)[1])][:total]  # clipping makes corners again
    sites, _ = feasible(model, workspace, u)
    if len(sites) < MIN_POSES:
        raise InputError(
            f"plan: {len(sites)} of {len(u)} candidate poses are within the joints' limits and regular; "
            f"at least {MIN_POSES} are needed: check [workspace] and the limits"
        )
    return sites


def d_optimal(
    model: ErrorModel, workspace: Workspace, channels: tuple[str, ...], sensor: Sensor, n: int, seed: int
) -> Sites:
    """n D-optimal poses for instruments of `channels` with one row's sigmas in `sensor`.

    Raises InputError for fewer than three poses or more than 1000.
    """
    check_count(n)
    sites = candidates(model, workspace, n, seed)
    return sites[select(information(model, sites, channels, sensor), n, seed).rows]


def check_count(n: int) -> None:
    if not MIN_POSES <= n <= MAX_POSES:
        raise InputError(f"plan: {n} poses; allowed are {MIN_POSES} (fewer can't register W and T) to {MAX_POSES}")


def select(jacobian: np.ndarray, n: int, seed: int = 0, restarts: int | None = None) -> Selection:
    """n of the candidates' blocks (N, rows, n_parameters), already in units of the priors' sigmas.

    No candidate is taken twice before every one is taken once. restarts: random starts beside the greedy one.
    """
    blocks = _reduced(jacobian)
    fewest, rest = divmod(n, len(blocks))
    base = np.full(len(blocks), fewest)
    restarts = (_RESTARTS if rest <= _FEW else 0) if restarts is None else restarts
    random = np.random.default_rng([seed, 12])
    starts = [_greedy(blocks, base, rest)]
    starts += [random.choice(len(blocks), rest, replace=False) for _ in range(restarts)]
    chosen, history = max((_exchanged(blocks, base, start) for start in starts), key=lambda candidate: candidate[1][-1])
    return Selection(np.repeat(np.arange(len(blocks)), _counts(base, chosen)), history[-1], tuple(history))


def log_det(jacobian: np.ndarray) -> float:
    """log det(I + sum J'J) of a design's blocks (n, rows, n_parameters), from singular values."""
    singular = np.linalg.svd(jacobian.reshape(-1, jacobian.shape[-1]), compute_uv=False)
    return float(np.sum(np.log1p(singular**2)))


def _reduced(jacobian: np.ndarray) -> np.ndarray:
    """The blocks in a basis of what the candidates see at all: the determinant stays, the columns become few."""
    triangle = np.asarray(np.linalg.qr(jacobian.reshape(-1, jacobian.shape[-1]), mode="r"))
    _, singular, vt = svd(triangle)
    return jacobian @ vt[singular > _SEEN].T


@dataclass
class Design:
    """A design with its covariance C = (I + sum J'J)^-1, and J_i C J_i' of every candidate."""

    blocks: np.ndarray  # (N, rows, k)
    covariance: np.ndarray  # (k, k)
    spread: np.ndarray  # (N, rows, rows)
    log_det: float

    @staticmethod
    def of(blocks: np.ndarray, counts: np.ndarray) -> Design:
        """From scratch. blocks: (N, rows, k) of the candidates; counts: (N,) how often each is in the design."""
        rows = (np.sqrt(counts)[:, None, None] * blocks)[counts > 0].reshape(-1, blocks.shape[2])
        factor = np.linalg.qr(np.concatenate([np.eye(blocks.shape[2]), rows]), mode="r")
        half = scipy.linalg.solve_triangular(factor, np.eye(len(factor)))
        whitened = blocks @ half
        return Design(
            blocks,
            half @ half.T,
            whitened @ whitened.swapaxes(1, 2),
            2 * float(np.sum(np.log(np.abs(np.diag(factor))))),
        )

    def gains(self) -> np.ndarray:
        """(N,) how much the log determinant rises when a candidate is added."""
        return _log_dets(self._eye + self.spread)

    def gains_instead(self, row: int) -> np.ndarray:
        """(N,) the same when it takes the place of `row`, which is in the design."""
        left = self._eye - self.spread[row]
        beside = self._beside(row)
        without = self.spread + beside @ np.linalg.inv(left) @ beside.swapaxes(1, 2)
        return _log_dets(left) + _log_dets(self._eye + without)

    def change(self, row: int, sign: int) -> None:
        """Add (+1) or take away (-1) a candidate: Woodbury's identity."""
        inner = self._eye + sign * self.spread[row]
        inverse = np.linalg.inv(inner)
        beside, columns = self._beside(row), self.covariance @ self.blocks[row].T
        self.log_det += float(_log_dets(inner))
        self.spread = self.spread - sign * beside @ inverse @ beside.swapaxes(1, 2)
        self.covariance = self.covariance - sign * columns @ inverse @ columns.T

    def _beside(self, row: int) -> np.ndarray:
        """(N, rows, rows): J_i C J_row'."""
        n, rows, k = self.blocks.shape
        return (self.blocks.reshape(-1, k) @ (self.covariance @ self.blocks[row].T)).reshape(n, rows, rows)

    @property
    def _eye(self) -> np.ndarray:
        return np.eye(self.spread.shape[1])


def _log_dets(matrices: np.ndarray) -> np.ndarray:
    sign, value = np.linalg.slogdet(matrices)
    return np.where(sign > 0, value, -np.inf)


def _counts(base: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """(N,) how often each candidate is in a design: `base`, and the rows `chosen` on top."""
    return base + np.bincount(chosen, minlength=len(base))


def _greedy(blocks: np.ndarray, base: np.ndarray, n: int) -> np.ndarray:
    """One pose after the other, each the one that adds most."""
    design = Design.of(blocks, base)
    chosen: list[int] = []
    for _ in range(n):
        gains = design.gains()
        gains[chosen] = -np.inf
        chosen.append(int(np.argmax(gains)))
        design.change(chosen[-1], +1)
    return np.array(chosen, dtype=int)


def _exchanged(blocks: np.ndarray, base: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, list[float]]:
    """Passes of exchanges until none gains; the log determinant of every pass is calculated from scratch."""
    chosen = start.copy()
    design = Design.of(blocks, _counts(base, chosen))
    history = [design.log_det]
    for _ in range(_PASSES):
        for k in range(len(chosen)):
            gains = design.gains_instead(chosen[k])
            gains[chosen] = -np.inf
            best = int(np.argmax(gains))
            if gains[best] > _GAIN:
                design.change(best, +1)
                design.change(chosen[k], -1)
                chosen[k] = best
        design = Design.of(blocks, _counts(base, chosen))
        if design.log_det <= history[-1] + _GAIN:
            break
        history.append(design.log_det)
    return chosen, history
