"""How the paper's networks meet the robot: source tasks, pre-training and fine-tuning."""

from __future__ import annotations

import numpy as np

from kincal.identification.error_model import ErrorModel
from kincal.identification.measurements import Measurements
from kincal.learning.network import Network
from kincal.learning.transfer import allowed_hidden, new_network, train
from kincal.pipeline.learned import Learned, Pretrained, SourceTask
from kincal.pipeline.methods.charts import Chart
from kincal.pipeline.results import Fit, Identified
from kincal.pipeline.watch import advanced
from kincal.urdf.description import Pretrain, Transfer
from kincal.urdf.errors import InputError


def source_task(model: ErrorModel, readings: np.ndarray, identified: Identified, settings: Pretrain) -> SourceTask:
    """The nominal model's outputs at readings (n, n_actuated), in each fit's chart.

    Where those of two fits are the same to the last bit (W and T matter for tilt alone), and of two robots of one
    design, they are learned once. Raises InputError for a network that is too large for the measured poses.
    """
    shipped, outputs, of_fit = identified.shipped, {}, []
    for fit in identified.fits():
        chart = Chart(model.robot(fit.registered), shipped.channels)
        y = _modelled(chart, readings)
        of_fit.append(list(outputs).index(y.tobytes()) if y.tobytes() in outputs else len(outputs))
        outputs.setdefault(y.tobytes(), y)
    task = SourceTask(readings, tuple(outputs.values()), tuple(of_fit))
    n, hidden = shipped.n_poses, settings.hidden
    largest = allowed_hidden(readings.shape[1], task.outputs[0].shape[1], n)
    if hidden > largest:
        raise InputError(f"pretrain.hidden = {hidden}: too large a network for {n} poses; allowed is {largest}")
    return task


def pretrained(task: SourceTask, settings: Pretrain, seed: int) -> Pretrained:
    """A network for each source task, all from the same random one."""
    start = new_network(task.readings, task.outputs[0], settings.hidden, seed)
    networks, trained = train(
        [start] * len(task.outputs),
        task.readings,
        task.outputs,
        [np.arange(len(task.readings))] * len(task.outputs),
        validation=settings.validation,
        iterations=settings.iterations,
        seed=seed,
        progress=lambda done, _: advanced(done / settings.iterations),
    )
    return Pretrained(start, tuple(networks), trained.curve[:, [0, len(task.outputs)]])


def learned(
    model: ErrorModel,
    measured: Measurements,
    identified: Identified,
    task: SourceTask,
    pretrained: Pretrained,
    pretrain: Pretrain,
    settings: Transfer,
    seed: int,
) -> tuple[Learned, ...]:
    """The three networks of every fit, each on the poses that the fit has seen; all are trained in one batch."""
    fits, channels = identified.fits(), measured.channels
    nominal = [pretrained.nominal[k] for k in task.of_fit]
    built = _continued(model, fits, channels, task, nominal, pretrain, seed)
    pose = measured.as_poses()
    outputs, rows = [], []
    for fit in fits:
        as_drawn, as_built = (Chart(model.robot(p), channels) for p in (fit.registered, fit.identified))
        drawn = as_drawn.of_measured(measured, pose)
        outputs += [drawn, drawn, as_built.of_measured(measured, pose)]
        rows += [np.setdiff1d(np.arange(len(measured)), fit.test)] * 3
    networks, trained = train(
        [
            network
            for as_drawn_network, other in zip(nominal, built, strict=True)
            for network in (pretrained.start, as_drawn_network, other)
        ],
        measured.readings,
        outputs,
        rows,
        validation=settings.validation,
        iterations=settings.iterations,
        seed=seed,
        progress=lambda done, _: advanced(done / settings.iterations),
    )
    curves = trained.curve.reshape(-1, 2, len(fits), 3)  # training and validation losses
    return tuple(
        Learned(*networks[3 * k : 3 * k + 3], curve=curves[:, :, k].reshape(-1, 6).copy()) for k in range(len(fits))
    )


def _continued(
    model: ErrorModel,
    fits: tuple[Fit, ...],
    channels: tuple[str, ...],
    task: SourceTask,
    nominal: list[Network],
    settings: Pretrain,
    seed: int,
) -> list[Network]:
    """The identified models' priors: the nominal one's training goes on, which costs a tenth of a new one."""
    outputs = [_modelled(Chart(model.robot(fit.identified), channels), task.readings) for fit in fits]
    rows = [np.arange(len(task.readings))] * len(fits)
    return train(
        nominal,
        task.readings,
        outputs,
        rows,
        validation=settings.validation,
        iterations=settings.continued,
        seed=seed,
    )[0]


def _modelled(chart: Chart, readings: np.ndarray) -> np.ndarray:
    return chart.of_tool(chart.robot.close(readings).require(lambda row: f"prior: pose {row}").pose)
