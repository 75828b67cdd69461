"""How the networks meet the robot: source tasks, fine-tuning, and the correction of the actuators."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.error_model import ErrorModel
from identification.estimators import left_out
from identification.measurements import Measurements
from identification.poses import folds
from learning.network import Network
from learning.residual import fit_correction
from learning.transfer import allowed_hidden, new_network, train
from pipeline.charts import Chart
from pipeline.results import Fit, Learned, Pretrained
from urdf.description import Pretrain, Split, Transfer
from urdf.errors import InputError


def pretrained(
    model: ErrorModel,
    readings: np.ndarray,
    fits: Sequence[Fit],
    channels: tuple[str, ...],
    n_poses: int,
    settings: Pretrain,
    seed: int,
) -> Pretrained:
    """Each fit's networks of the source task, at readings (n, n_actuated): the nominal model's, the identified one's.

    All start from the same random network. The identified model's prior goes on from the nominal one's, so that it
    costs a tenth; where the task of two fits is the same to the last bit (it needs W and T for tilt alone) it is
    learned once.
    """
    as_drawn = [Chart(model.robot(fit.registered), channels) for fit in fits]
    as_built = [Chart(model.robot(fit.identified), channels) for fit in fits]
    tasks = [chart.of_tool(chart.robot.close(readings).require(_where).pose) for chart in as_drawn]
    largest = allowed_hidden(readings.shape[1], as_drawn[0].n_out, n_poses)
    if settings.hidden > largest:
        raise InputError(
            f"pretrain.hidden = {settings.hidden}: too large a network for {n_poses} poses; allowed is {largest}"
        )
    start = new_network(readings, tasks[0], settings.hidden, seed)
    unique: dict[bytes, Network] = {}
    curve = np.zeros((0, 2))
    for task in tasks:
        if task.tobytes() not in unique:
            networks, trained = _train(start, readings, task, settings.validation, settings.iterations, seed)
            unique[task.tobytes()], curve = networks[0], trained.curve
    nominal = [unique[task.tobytes()] for task in tasks]
    identified = []
    for network, chart in zip(nominal, as_built, strict=True):
        task = chart.of_tool(chart.robot.close(readings).require(_where).pose)
        identified += _train(network, readings, task, settings.validation, settings.continued, seed)[0]
    return Pretrained(start, tuple(nominal), tuple(identified), curve)


def _where(row: int) -> str:
    return f"prior: pose {row}"


def _train(network: Network, readings: np.ndarray, task: np.ndarray, validation: float, iterations: int, seed: int):
    rows = [np.arange(len(readings))]
    return train([network], readings, [task], rows, validation=validation, iterations=iterations, seed=seed)


def learned(
    model: ErrorModel,
    measured: Measurements,
    fit: Fit,
    networks: tuple[Network, Network, Network],
    settings: Transfer,
    split: Split,
    seed: int,
) -> Learned:
    """All that is learned from the poses that `fit` has seen; networks: random, nominal prior, identified prior."""
    own = np.setdiff1d(np.arange(len(measured)), fit.test)
    poses = measured[own]
    as_drawn = Chart(model.robot(fit.registered), measured.channels)
    as_built = Chart(model.robot(fit.identified), measured.channels)
    pose = poses.as_poses()
    drawn, built = as_drawn.of_measured(poses, pose), as_built.of_measured(poses, pose)
    (network, transfer, transfer_identified), trained = train(
        networks,
        poses.readings,
        [drawn, drawn, built],
        [np.arange(len(own))] * 3,
        validation=settings.validation,
        iterations=settings.iterations,
        seed=seed,
    )
    q = model.robot(fit.identified).close(poses.readings).q  # identification has closed these loops
    rows = model.residual(model.robot(fit.identified), q, poses)
    jacobian, n = model.jacobian(fit.identified, poses, q), len(model.actuators.gain)
    gain = jacobian[:, :, -12 - 2 * n : -12 - n]
    parts = folds(len(poses), split, seed)
    unseen = np.stack([left_out(model, fit.identified, jacobian, rows, part) for part in parts])
    correction = fit_correction(
        poses.readings,
        rows,
        gain,
        parts,
        unseen,
        own=settings.own_hidden,
        shared=settings.shared_hidden,
        iterations=settings.correction_iterations,
        seed=seed,
    )
    return Learned(network, transfer, transfer_identified, correction, trained.curve)
