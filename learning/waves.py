"""Which periodic errors the actuators have: screws, gears and encoders err with a period of their own joint.

Orthogonal matching pursuit over joints and periods: one wave after the other, each the one that explains most of what
the others leave, as long as chance does not explain as much (an F test, with the number of periods tried counted).
"""

from __future__ import annotations

import numpy as np
import scipy.linalg
from scipy.special import fdtrc

_STEP = 0.2  # of a cycle over the measured range: between two periods that are tried
_LOWEST, _HIGHEST = 0.5, 100.0  # cycles over the range
_POSES_A_CYCLE = 2  # at least, on average: joint values are never evenly spaced
_MOST = 40  # waves
_FINER = 21  # periods tried about one that was chosen
_CHANCE = 1e-3  # that a robot without periodic errors is said to have one
_MOST_POSES = 600  # that are looked at: more tell no other periods
_ROUNDING = 1e-9


def find_waves(x: np.ndarray, error: np.ndarray, columns: np.ndarray, gain: np.ndarray) -> np.ndarray:
    """(w, 2): joint and cycles over twice its scaled input's unit, strongest first.

    x: (n, k) inputs in -1 .. 1; error: (n, m) whitened; columns: (n, m, K) what may explain it otherwise, in units of
    its prior's sigma; gain: (n, m, k) d error / d output, in units of the outputs' size.
    """
    few = np.unique(np.linspace(0, len(x) - 1, min(len(x), _MOST_POSES)).astype(int))
    x, error, columns, gain = x[few], error[few], columns[few], gain[few]
    cycles = np.arange(_LOWEST, min(len(few) / _POSES_A_CYCLE, _HIGHEST), _STEP)
    if len(cycles) < 2:
        return np.zeros((0, 2))
    flat = columns.reshape(-1, columns.shape[-1])
    q, s, _ = scipy.linalg.svd(flat, full_matrices=False, lapack_driver="gesvd", check_finite=False)
    shrunk = (1 - 1 / np.sqrt(1 + s**2))[:, None]  # whitens by the noise and the priors together

    def whitened(v: np.ndarray) -> np.ndarray:
        return v - q @ (shrunk * (q.T @ v))

    def waves(j: int, cycles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        phase = np.pi * (x[:, [j]] + 1) * cycles  # (n, f)
        sine, cosine = (gain[:, :, [j]] * part(phase)[:, None] for part in (np.sin, np.cos))
        return whitened(sine.reshape(-1, len(cycles))), whitened(cosine.reshape(-1, len(cycles)))

    left = whitened(error.reshape(-1, 1))[:, 0]
    pairs = [waves(j, cycles) for j in range(x.shape[1])]
    sine, cosine = (np.stack([pair[i] for pair in pairs]) for i in (0, 1))  # (k, rows, f)
    ss, cc, sc = (np.einsum("krf,krf->kf", a, b) for a, b in ((sine, sine), (cosine, cosine), (sine, cosine)))
    sr, cr = (np.einsum("krf,r->kf", a, left) for a in (sine, cosine))
    floor = _ROUNDING * max(float(ss.max()), float(cc.max()), 1e-300)
    basis, chosen = np.zeros((len(left), 0)), []
    free = len(left) - float(np.sum(s**2 / (1 + s**2)))
    while len(chosen) < _MOST and free - 2 > len(left) / 4:
        explained = _explained(ss, cc, sc, sr, cr, floor)
        j, f = np.unravel_index(int(np.argmax(explained)), explained.shape)
        energy, free = float(left @ left), free - 2
        ratio = (explained[j, f] / 2) / max((energy - explained[j, f]) / free, 1e-300)
        if fdtrc(2, free, ratio) * explained.size > _CHANCE:
            break
        near = cycles[f] + _STEP * np.linspace(-0.5, 0.5, _FINER)
        fine = [v - basis @ (basis.T @ v) for v in waves(int(j), near)]
        products = [np.sum(a * b, axis=0) for a, b in ((fine[0], fine[0]), (fine[1], fine[1]), (fine[0], fine[1]))]
        best = int(np.argmax(_explained(*products, *(left @ v for v in fine), floor)))
        chosen.append((j, near[best]))
        new = np.linalg.qr(np.stack([v[:, best] for v in fine], axis=1))[0]
        basis = np.concatenate([basis, new], axis=1)
        # what is orthogonal to all waves so far: by the sums alone, the waves themselves stay as they are
        sn, cn = (np.einsum("krf,ri->kfi", a, new) for a in (sine, cosine))
        ss, cc, sc = (a - np.sum(b * c, axis=-1) for a, b, c in ((ss, sn, sn), (cc, cn, cn), (sc, sn, cn)))
        ss, cc = np.maximum(ss, 0.0), np.maximum(cc, 0.0)
        part = new.T @ left
        left = left - new @ part
        sr, cr = sr - sn @ part, cr - cn @ part
    return np.array(chosen, dtype=float).reshape(-1, 2)


def _explained(ss, cc, sc, sr, cr, floor: float) -> np.ndarray:
    """The energy of r that a sine and a cosine explain together, from their products with each other and with r."""
    determinant = (ss + floor) * (cc + floor) - sc**2
    return (sr**2 * (cc + floor) + cr**2 * (ss + floor) - 2 * sr * cr * sc) / determinant
