"""A network for what a model leaves, trained through the model and together with its parameters.

Errors of measured poses e = r + J z + G delta(x) are linear in the model's parameters z, which have their priors, and
in the network's readout; so both are found at once and neither takes what is the other's. Evidence gates it: the
network must pay in cross-validation, and is shrunk by as much as it overdoes; outside the hull of the training inputs
it fades.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri, fdtri, stdtrit

from kincal.learning.correction import HELD, Correction, Hull, Spread
from kincal.learning.evidence import Posterior, Rows, Unseen, cross_validated, inflation, posterior
from kincal.learning.units import GROUPS, STRUCTURES, Inherited, Units, range_of
from kincal.learning.units.group import Evidence

_LEAST_TOLD = 1e-3  # of a prior's sigma: what poses tell less of is left to it
_CHANCE = 0.01  # that a network which does not pay is believed
_PROBABLE = 5.0  # logarithm of the data's probability with the network over that without: it is believed sooner
_PARTS, _REPEATS = (0.4, 0.55, 0.7, 0.85), 4  # of the learning curve
_LEAST_POSES = 8  # of it
_TRIMMED = 0.03  # of the poses, on either side: outliers
_INSTRUMENTS = 0.1  # share of the noise, where nobody gave their sigmas


@dataclass(frozen=True)
class Task:
    """What there is to learn from: n measured poses, m whitened rows each, linearised at a robot as identified."""

    x: np.ndarray  # (n, k) readings
    error: np.ndarray  # (n, m) of the robot as drawn and uncorrected, by the linearisation
    by_model: np.ndarray  # (n, m, P) d error / d z, z in units of its prior's sigma
    by_output: np.ndarray  # (n, m, k) d error / d delta
    sigmas_known: bool = True  # else the rows were whitened by what the model alone leaves

    def along(self, basis: np.ndarray) -> Task:
        """The task with the model's parameters along basis (P, r) alone."""
        return replace(self, by_model=self.by_model @ basis)


def fit_correction(
    task: Task, folds: Sequence[np.ndarray], inherited: Inherited | None, *, own: int, shared: int, seed: int
) -> tuple[Correction, np.ndarray]:
    """The correction, and the model's parameters (P,) beside it, in their priors' sigmas.

    folds: poses held out in turn. Of the structures the one with the least error in cross-validation is taken.
    """
    basis = _determined(task)
    seen = task.along(basis)
    units = Units(*range_of(task.x), () if inherited is None else (inherited,))
    model = _rows(seen, units.only(()), np.ones(task.x.shape[1]))
    modelled, alone = cross_validated(model, folds)
    # the least outputs that explain what the model leaves set their scale
    needed = np.linalg.pinv(task.by_output) @ model.left(modelled.mean)[..., None]
    scale = np.maximum(np.sqrt(np.mean(needed[..., 0] ** 2, axis=0)), 1e-12)
    explained, gain = _rows(seen, units, scale).columns, task.by_output * scale
    shown = Evidence(units.scaled(task.x), task.error, explained, gain, inherited, own, shared, seed)
    made = (kind.of(shown) for kind in GROUPS)
    everything = replace(units, groups=tuple(group for group in made if group is not None))
    losses, tried = {"": alone.loss}, []
    for name, kinds in STRUCTURES.items():
        units = everything.only(kinds)
        if len(units.groups) == len(kinds):  # else it is another structure again
            found, unseen = cross_validated(_rows(seen, units, scale), folds)
            losses[name] = unseen.loss
            tried.append((unseen.loss, len(tried), name, units, found, unseen))
    _, _, name, units, found, unseen = min(tried)
    evidence = _evidence(alone, unseen)
    more_probable = found.log_evidence - modelled.log_evidence
    likely = evidence > stdtrit(len(task.x) - 1, 1 - _CHANCE) and more_probable > 1
    sure = likely or (more_probable > _PROBABLE and evidence > 1)
    change = unseen.error - alone.error
    shrinkage = float(np.clip(-np.sum(alone.error * change) / max(np.sum(change**2), 1e-300), 0.0, 1.0))
    correction = Correction(
        units=units,
        readout=found.mean[basis.shape[1] :],
        scale=scale,
        hull=Hull.of(units.scaled(task.x)),
        structure=name,
        shrinkage=shrinkage if sure and np.mean(unseen.square) < np.mean(alone.square) else 0.0,
        evidence=evidence,
        losses=losses,
        alone=_spread(modelled, alone, seen, scale, basis),
        refined=_spread(found, unseen, seen, scale, basis),
    )
    return correction, basis @ found.mean[: basis.shape[1]]


def _determined(task: Task) -> np.ndarray:
    """(P, r) orthonormal: the model's directions that the poses determine; on the others the priors stay."""
    flat = task.by_model.reshape(-1, task.by_model.shape[2])
    values, vectors = np.linalg.eigh(flat.T @ flat)
    return vectors[:, values > _LEAST_TOLD**2]


def _evidence(alone: Unseen, unseen: Unseen) -> float:
    """Mean fall of the logarithm of a pose's error, in its standard errors: no single pose decides."""
    fall = np.log1p(alone.square) - np.log1p(unseen.square)
    return float(np.mean(fall) / max(np.std(fall, ddof=1) / np.sqrt(len(fall)), 1e-300))


def learning_curve(task: Task, correction: Correction, seed: int) -> np.ndarray:
    """(sizes, 3): number of poses, and what unseen poses err by in sigmas, the instruments' noise taken off.

    Of the model alone and of the model with the correction, trained on parts of the poses and tried on the others.
    """
    basis, (n, m) = correction.refined.basis, task.error.shape
    seen = task.along(basis)
    model, refined = (_rows(seen, units, correction.scale) for units in (correction.units.only(()), correction.units))
    near = [posterior(rows.sums(slice(None)), rows.group) for rows in (model, refined)]
    noise = 1.0 if task.sigmas_known else min(near[1].noise, 1.0)
    random, rows_of_curve = np.random.default_rng([seed, 14]), []
    sizes = [round(part * n) for part in _PARTS if part * n >= _LEAST_POSES]
    for size in sizes:
        squares: list[list[float]] = [[], []]
        for _ in range(_REPEATS):
            order = random.permutation(n)
            train, rest = np.sort(order[:size]), np.sort(order[size:])
            for own, rows, all_seen in zip(squares, (model, refined), near, strict=True):
                fitted = posterior(rows.sums(train), rows.group, all_seen)
                square = np.sum(rows.left(fitted.mean, rest) ** 2, axis=1)
                own.append(_trimmed_mean(square))
        rows_of_curve.append((size, *(np.sqrt(max(np.mean(own) - noise * m, 0.0)) for own in squares)))
    return np.array(rows_of_curve, dtype=float).reshape(-1, 3)


def _trimmed_mean(square: np.ndarray) -> float:
    cut = int(_TRIMMED * len(square))
    return float(np.mean(np.sort(square)[cut : len(square) - cut]))


def refit(correction: Correction, task: Task) -> tuple[Correction, np.ndarray]:
    """The same correction at another linearisation of its task."""
    basis = correction.refined.basis
    rows = _rows(task.along(basis), correction.units, correction.scale)
    mean = posterior(rows.sums(slice(None)), rows.group).mean
    return replace(correction, readout=mean[basis.shape[1] :]), basis @ mean[: basis.shape[1]]


def _rows(task: Task, units: Units, scale: np.ndarray) -> Rows:
    joints, names = units.layout
    columns = (task.by_output * scale)[:, :, joints] * units.values(task.x)[:, None]
    groups = {name: g for g, name in enumerate(dict.fromkeys(names), 1)}
    group = np.concatenate([np.zeros(task.by_model.shape[2], dtype=int), [groups[name] for name in names]]).astype(int)
    return Rows(task.error, np.concatenate([task.by_model, columns], axis=2), group, task.sigmas_known)


def _spread(fitted: Posterior, unseen: Unseen, task: Task, scale: np.ndarray, basis: np.ndarray) -> Spread:
    """What the rows' noise has beyond the instruments' own, and chance, is taken for the actuators'.

    Where nobody knows the instruments, nearly all of it is: a region too wide does less harm.
    """
    outputs = task.by_output * scale
    mean_trace = float(np.mean(np.sum(outputs**2, axis=(1, 2)))) / task.error.shape[1]
    noise = 1.0 if task.sigmas_known else _INSTRUMENTS * fitted.noise
    beyond = max(fitted.noise * (1 - np.sqrt(2 / fitted.freedom)) - noise, 0.0)
    unexplained = np.sqrt(beyond / max(mean_trace, 1e-300))
    rest = unexplained**2 * outputs @ outputs.swapaxes(1, 2)
    m = task.error.shape[1]
    unsure = m * fdtri(m, fitted.freedom, HELD) / chdtri(m, 1 - HELD)  # the noise is an estimate, too
    factor = float(unsure) * inflation(unseen.error, unseen.spread + rest, noise)
    return Spread(basis, fitted.covariance, float(unexplained), factor)
