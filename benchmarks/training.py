"""Training beside scikit-learn and torch's Adam on one thread: the same 3-16-16-3 tanh network, poses and accuracy.

Pre-trained on 1331 poses of the 3-UPS/S platform as drawn, fine-tuned on 120 measured ones. Seconds are of the
processor, so that other jobs count less. The peers are stopped by the held-out error itself, once it is as good as
ours, which they could not know outside a benchmark; ours stops by its own validation rows.
"""

from __future__ import annotations

import copy
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor
from threadpoolctl import threadpool_limits

from benchmarks.setup import bench, grid
from identification.accuracy import score
from identification.error_model import BuiltRobot
from identification.estimators import register
from learning.network import Network
from learning.training import Trained
from learning.transfer import new_network, train
from pipeline.charts import Chart
from urdf.description import Pretrain, Transfer
from urdf.kinematics import inverse

LIMIT = 60.0  # seconds a peer may take for each phase
CHANNELS = ("orientation",)
SEEDS = 10
PRETRAIN, TRANSFER = Pretrain(), Transfer()


@dataclass(frozen=True)
class Task:
    """What one phase learns, and where it is scored."""

    readings: np.ndarray  # (n, 3)
    outputs: np.ndarray  # (n, 3)
    chart: Chart
    truth: BuiltRobot
    fresh: np.ndarray  # (500, 3) readings

    def error(self, predict: Callable[[np.ndarray], np.ndarray]) -> float:
        """Mean angle [deg] on the fresh poses, against the noise-free truth."""
        actual = self.truth.measured(self.truth.close(self.fresh).pose)
        mean = score(actual, self.chart.pose(predict(self.fresh), self.fresh), CHANNELS).mean_deg
        return float("inf") if mean is None else mean


def tasks(seed: int) -> tuple[Task, Task]:
    """The source task, and the target task of a virtual robot."""
    at = bench("ups3_s", CHANNELS)
    readings = at.model.actuators.readings(inverse(at.model.chain, grid(at.model, 11)).q[:, at.model.chain.actuated])
    robot = at.built(seed)[1]
    measured = at.measured(robot, at.sites(120, [seed, 1]).readings, seed)
    drawn = at.model.robot(register(at.model, measured).p)
    chart, fresh = Chart(drawn, CHANNELS), at.sites(500, [seed, 2]).readings
    source = Task(readings, chart.of_tool(drawn.close(readings).pose), chart, drawn, fresh)
    target = chart.of_measured(measured, measured.as_poses())
    return source, Task(measured.readings, target, chart, robot, fresh)


def kincal(networks: list[Network], task: Task, validation: float, iterations: int) -> tuple[list[Network], Trained]:
    n = len(networks)
    rows = [np.arange(len(task.readings))] * n
    return train(
        networks, task.readings, [task.outputs] * n, rows, validation=validation, iterations=iterations, seed=0
    )


class ScikitLearn:
    """L-BFGS in pieces of 500 iterations, each from where the last one ended."""

    name = "scikit-learn MLPRegressor, lbfgs"

    def __init__(self, scaled: Network) -> None:
        self.scaled = scaled
        self.model = MLPRegressor(
            hidden_layer_sizes=scaled.sizes[1:3],
            activation="tanh",
            solver="lbfgs",
            alpha=0.0,
            tol=1e-12,
            max_iter=500,
            max_fun=1_000_000,
            warm_start=True,
            random_state=0,
        )

    def piece(self, task: Task) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            self.model.fit(self.scaled.scaled(task.readings), task.outputs / self.scaled.output_scale)

    def __call__(self, x: np.ndarray) -> np.ndarray:
        return self.model.predict(self.scaled.scaled(x)) * self.scaled.output_scale

    def begin(self, phase: int) -> None:
        """Nothing to set: warm_start keeps the weights."""


class TorchAdam:
    """Full batches, 500 at a time; the rate is halved where the loss stays, and starts lower for the fine-tuning."""

    name = "torch Adam"

    def __init__(self, scaled: Network) -> None:
        torch.manual_seed(0)
        self.scaled = scaled
        sizes, tanh = scaled.sizes, torch.nn.Tanh()
        one, two, three = (torch.nn.Linear(a, b) for a, b in pairwise(sizes))
        self.net = torch.nn.Sequential(one, tanh, two, tanh, three).double()

    def begin(self, phase: int) -> None:
        self.adam = torch.optim.Adam(self.net.parameters(), lr=(1e-2, 1e-3)[phase])
        self.rate = torch.optim.lr_scheduler.ReduceLROnPlateau(self.adam, factor=0.5, patience=300)

    def piece(self, task: Task) -> None:
        x = torch.from_numpy(self.scaled.scaled(task.readings))
        y = torch.from_numpy(task.outputs / self.scaled.output_scale)
        for _ in range(500):
            self.adam.zero_grad()
            loss = torch.nn.functional.mse_loss(self.net(x), y)
            loss.backward()
            self.adam.step()
            self.rate.step(loss.item())

    def __call__(self, x: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return self.net(torch.from_numpy(self.scaled.scaled(x))).numpy() * self.scaled.output_scale


def until(peer: ScikitLearn | TorchAdam, task: Task, wanted: float) -> tuple[float, float]:
    """Seconds and the best error [deg] of training pieces until it is the wanted one; goes on from the best."""
    seconds, best, at_best = 0.0, np.inf, peer
    while best > wanted and seconds < LIMIT:
        began = time.process_time()
        peer.piece(task)
        seconds += time.process_time() - began
        error = task.error(peer)
        if error < best:
            best, at_best = error, copy.deepcopy(peer)
    peer.__dict__.update(at_best.__dict__)
    return seconds, best


def beside_peers() -> None:
    phases = tasks(seed=1)
    start = new_network(phases[0].readings, phases[0].outputs, PRETRAIN.hidden, 0)
    kincal([start], phases[1], 0.0, 2)  # warm
    networks, ours = [start], []
    for task, settings in zip(phases, (PRETRAIN, TRANSFER), strict=True):
        began = time.process_time()
        networks, _ = kincal(networks, task, settings.validation, settings.iterations)
        ours.append((time.process_time() - began, task.error(networks[0])))
    total = sum(seconds for seconds, _ in ours)
    print(f"{'':<34}{'pre-train, 1331 poses':>32}{'fine-tune, 120 poses':>32}{'both':>16}")
    cells = [f"{seconds:9.2f} s to {error:.6f} deg" for seconds, error in ours]
    print(f"{'kincal':<34}{cells[0]:>32}{cells[1]:>32}{total:>14.2f} s", flush=True)
    for kind in (ScikitLearn, TorchAdam):
        peer, took, cells = kind(start), 0.0, []
        for phase, (task, (_, wanted)) in enumerate(zip(phases, ours, strict=True)):
            peer.begin(phase)
            seconds, error = until(peer, task, wanted)
            took += seconds
            cells.append(f"{seconds:.2f} s to {error:.6f} deg" if error <= wanted else f"not in 60 s, best {error:.6f}")
        more = "more than " if any("not" in cell for cell in cells) else ""
        print(
            f"{kind.name:<34}{cells[0]:>32}{cells[1]:>32}{took:>14.2f} s  {more}{took / total:.0f} times as long",
            flush=True,
        )


def at_once() -> None:
    phases = tasks(seed=1)
    starts = [new_network(phases[0].readings, phases[0].outputs, PRETRAIN.hidden, k) for k in range(SEEDS)]
    began = time.process_time()
    batch, _ = kincal(starts, phases[0], PRETRAIN.validation, 40)
    middle = time.process_time()
    batch_fine, _ = kincal(batch, phases[1], TRANSFER.validation, TRANSFER.iterations)
    together = middle - began, time.process_time() - middle
    single, alone = [], [0.0, 0.0]
    for start in starts:
        began = time.process_time()
        one, _ = kincal([start], phases[0], PRETRAIN.validation, 40)
        middle = time.process_time()
        one_fine, _ = kincal(one, phases[1], TRANSFER.validation, TRANSFER.iterations)
        alone = [alone[0] + middle - began, alone[1] + time.process_time() - middle]
        single += [*one, *one_fine]
    weights = np.stack([n.weights for pair in zip(batch, batch_fine, strict=True) for n in pair])
    apart = float(np.abs(weights - np.stack([n.weights for n in single])).max())
    for what, once, row in zip(("pre-train, 40 iterations", "fine-tune"), together, alone, strict=True):
        print(
            f"{SEEDS} seeds, {what:<28} at once {once:7.2f} s   in a row {row:7.2f} s   {row / once:.2f} times as fast"
        )
    print(f"largest difference of a weight: {apart:.1e}", flush=True)


def main() -> None:
    torch.set_num_threads(1)
    with threadpool_limits(1):
        at_once()
        beside_peers()


if __name__ == "__main__":
    main()
