"""Training beside scikit-learn and torch's Adam on one thread: the same 3-16-16-3 tanh network, poses and accuracy.

Pre-trained on 1331 poses of the 3-UPS/S platform as drawn, fine-tuned on 120 measured ones. Seconds are of the
processor, so that other jobs count less. The peers are stopped by the held-out error itself, once it is as good as
ours, which they could not know outside a benchmark; ours stops by its own validation rows.
"""

from __future__ import annotations

import copy
import statistics
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import torch
from sklearn.exceptions import ConvergenceWarning
from sklearn.neural_network import MLPRegressor
from threadpoolctl import threadpool_limits

from benchmarks.setup import bench, grid
from kincal.identification.accuracy import score
from kincal.identification.error_model import BuiltRobot
from kincal.identification.estimators import register
from kincal.learning.members import Trained
from kincal.learning.network import Network
from kincal.learning.transfer import new_network, train
from kincal.pipeline.methods.charts import Chart
from kincal.urdf.description import Pretrain, Transfer
from kincal.urdf.kinematics import inverse
from kincal.urdf.rigid_motion import Motion

LIMIT = 60.0  # seconds a peer may take for each phase
PIECES = (500, 20)  # a peer's iterations until the first look at its held-out error; a tenth more for each later one
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
        mean = score(self._actual, self.chart.pose(predict(self.fresh), self.fresh), CHANNELS).mean_deg
        return float("inf") if mean is None else mean

    @cached_property
    def _actual(self) -> Motion:
        return self.truth.measured(self.truth.close(self.fresh).pose)


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
    """L-BFGS in pieces, each from where the last one ended.

    It stops where the loss, or 1 if that is more, falls by less than a fixed 2e-9 of it: far too early for errors of
    1e-3. So outputs and last layer are made ten times as large wherever it comes to rest, as long as that helps.
    """

    name = "scikit-learn MLPRegressor, lbfgs"

    def __init__(self, scaled: Network) -> None:
        self.scaled, self.enlarged = scaled, 1.0
        self.model = MLPRegressor(
            hidden_layer_sizes=scaled.sizes[1:3],
            activation="tanh",
            solver="lbfgs",
            alpha=0.0,
            tol=1e-12,
            max_fun=1_000_000,
            warm_start=True,
            random_state=0,
        )

    def piece(self, task: Task) -> bool:
        """Whether it has come to rest."""
        self.model.set_params(max_iter=self.steps)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            self.model.fit(self.scaled.scaled(task.readings), self.enlarged * task.outputs / self.scaled.output_scale)
        if self.model.n_iter_ > 0.1 * self.steps:
            return False
        if self.enlarged >= 1e4:
            return True
        self.enlarged *= 10
        self.model.coefs_[-1] *= 10
        self.model.intercepts_[-1] *= 10
        return False

    def __call__(self, x: np.ndarray) -> np.ndarray:
        return np.asarray(self.model.predict(self.scaled.scaled(x))) * self.scaled.output_scale / self.enlarged

    def begin(self, phase: int) -> None:
        self.steps = PIECES[phase]


class TorchAdam:
    """Full batches; the rate is halved where the loss stays, and starts lower for the fine-tuning."""

    name = "torch Adam"

    def __init__(self, scaled: Network) -> None:
        torch.manual_seed(0)
        self.scaled = scaled
        sizes, tanh = scaled.sizes, torch.nn.Tanh()
        one, two, three = (torch.nn.Linear(a, b) for a, b in pairwise(sizes))
        self.net = torch.nn.Sequential(one, tanh, two, tanh, three).double()

    def begin(self, phase: int) -> None:
        self.steps = PIECES[phase]
        self.adam = torch.optim.Adam(self.net.parameters(), lr=(1e-2, 1e-3)[phase])
        self.rate = torch.optim.lr_scheduler.ReduceLROnPlateau(self.adam, factor=0.5, patience=300)

    def piece(self, task: Task) -> bool:
        x = torch.from_numpy(self.scaled.scaled(task.readings))
        y = torch.from_numpy(task.outputs / self.scaled.output_scale)
        for _ in range(self.steps):
            self.adam.zero_grad()
            loss = torch.nn.functional.mse_loss(self.net(x), y)
            loss.backward()
            self.adam.step()
            self.rate.step(loss.item())
        return False

    def __call__(self, x: np.ndarray) -> np.ndarray:
        with torch.no_grad():
            return self.net(torch.from_numpy(self.scaled.scaled(x))).numpy() * self.scaled.output_scale


def until(peer: ScikitLearn | TorchAdam, task: Task, wanted: float) -> tuple[float, float, bool]:
    """Seconds and the best error [deg] of training pieces until it is the wanted one; goes on from the best.

    And whether it came to rest without.
    """
    seconds, best, at_best, resting = 0.0, np.inf, peer, False
    while best > wanted and seconds < LIMIT and not resting:
        began = time.process_time()
        resting = peer.piece(task)
        seconds += time.process_time() - began
        peer.steps = int(1.1 * peer.steps)  # looks cost time, too
        error = task.error(peer)
        if error < best:
            best, at_best = error, copy.deepcopy(peer)
    peer.__dict__.update(at_best.__dict__)
    return seconds, best, resting and best > wanted


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
    print(f"{'':<34}{'pre-train, 1331 poses':>36}{'fine-tune, 120 poses':>36}{'both':>16}")
    cells = [f"{seconds:9.2f} s to {error:.6f} deg" for seconds, error in ours]
    print(f"{'kincal':<34}{cells[0]:>36}{cells[1]:>36}{total:>14.2f} s", flush=True)
    for kind in (ScikitLearn, TorchAdam):
        peer, took, cells = kind(start), 0.0, []
        for phase, (task, (_, wanted)) in enumerate(zip(phases, ours, strict=True)):
            peer.begin(phase)
            seconds, error, resting = until(peer, task, wanted)
            took += seconds
            missed = f"at rest after {seconds:.1f} s" if resting else f"not reached in {LIMIT:.0f} s"
            cells.append(f"{seconds:.2f} s to {error:.6f} deg" if error <= wanted else f"{missed}, best {error:.6f}")
        more = "more than " if any("best" in cell for cell in cells) else ""
        print(
            f"{kind.name:<34}{cells[0]:>36}{cells[1]:>36}{took:>14.2f} s  {more}{took / total:.0f} times as long",
            flush=True,
        )


def at_once(repeats: int = 3) -> None:
    """Medians; both ways in turn, so that what else the machine does meets both."""
    phases = tasks(seed=1)
    starts = [new_network(phases[0].readings, phases[0].outputs, PRETRAIN.hidden, k) for k in range(SEEDS)]
    both, _ = kincal(starts, phases[0], PRETRAIN.validation, 20)
    for what, task, settings, limit, given in (
        ("pre-train, 20 iterations", phases[0], PRETRAIN, 20, starts),
        ("fine-tune", phases[1], TRANSFER, TRANSFER.iterations, both),
    ):
        once, row, apart = [], [], 0.0
        for _ in range(repeats):
            began = time.process_time()
            together, _ = kincal(given, task, settings.validation, limit)
            middle = time.process_time()
            single = [kincal([network], task, settings.validation, limit)[0][0] for network in given]
            row.append(time.process_time() - middle)
            once.append(middle - began)
            apart = max(float(np.abs(a.weights - b.weights).max()) for a, b in zip(together, single, strict=True))
        quick, slow = statistics.median(once), statistics.median(row)
        print(
            f"{SEEDS} seeds, {what:<26} at once {quick:7.2f} s   in a row {slow:7.2f} s   {slow / quick:.2f} times as "
            f"fast; largest difference of a weight {apart:.1e}",
            flush=True,
        )


def main() -> None:
    torch.set_num_threads(1)
    with threadpool_limits(1):
        at_once()
        beside_peers()


if __name__ == "__main__":
    main()
