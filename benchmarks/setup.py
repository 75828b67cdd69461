"""A shipped robot as the stages see it: closed chain, error model, random feasible poses, and virtual measurements."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from kincal.identification.error_model import BuiltRobot, ErrorModel
from kincal.identification.expected import Sites, feasible
from kincal.identification.measurements import Measurements, default_channels, to_measurements, to_table
from kincal.identification.poses import planned
from kincal.pipeline.stages.drawing import model_stage
from kincal.pipeline.virtual.robot import VirtualRobot, draw, measure
from kincal.urdf.description import Channel, Sensor, VirtualErrors, Workspace, load_robot
from kincal.urdf.kinematics import inverse
from kincal.urdf.workspace import sample

PROCESSES = 2
_GEOMETRIC = VirtualErrors(elastic=False, screw=False)


def measured_robot(name: str, poses: int) -> tuple[ErrorModel, Measurements]:
    """A shipped robot, and what a virtual one with all its errors measures at its planned poses."""
    description = load_robot(name, [f"plan.poses={poses}"]).description
    chain = model_stage(description.mechanism, Path(description.urdf)).chain()
    errors = ErrorModel.of(chain, description.actuator, description.tolerance)
    u = planned(description.workspace, chain.tool_axes, description.plan, seed=0)
    readings = errors.actuators.readings(inverse(chain, u).q[:, chain.actuated])
    pose = VirtualRobot.of(errors, draw(errors, description.measure.errors, seed=0)).pose(readings)
    columns = measure(pose, default_channels(chain.tool_axes), description.sensor, seed=0)
    table = to_table(chain.actuated_names, readings, columns)
    return errors, to_measurements(table, chain.actuated_names, description.sensor)


@dataclass(frozen=True)
class Bench:
    """A shipped robot to draw virtual ones from: geometric errors alone, W and T off by 1 degree and 10 mm."""

    model: ErrorModel
    workspace: Workspace
    channels: tuple[Channel, ...]
    sensor: Sensor

    def sites(self, n: int, seed: list[int], axes: tuple[int, ...] | None = None) -> Sites:
        """n random poses that the robot as drawn can take; axes: those that move (default: all)."""
        chain, found, wanted = self.model.chain, [], n
        still = np.ones(6, dtype=bool)
        still[list(chain.tool_axes if axes is None else axes)] = False
        for attempt in range(20):
            u = sample(self.workspace, chain.tool_axes, max(2 * wanted, 20), [*seed, attempt])
            u[:, still] = 0.0
            found.append(feasible(self.model, self.workspace, u)[0][:wanted])
            wanted -= len(found[-1])
            if not wanted:
                break
        u, q, readings = (np.concatenate([getattr(s, name) for s in found]) for name in ("u", "q", "readings"))
        return Sites(u, q, readings)[:n]

    def built(self, seed: int) -> tuple[np.ndarray, BuiltRobot]:
        """The parameters p of a robot at random, and the robot."""
        p = draw(self.model, _GEOMETRIC, seed).p
        return p, self.model.robot(p)

    def measured(self, robot: BuiltRobot, readings: np.ndarray, seed: int) -> Measurements:
        """What its instruments read there, with their noise. Raises InputError where the robot can't be there."""
        pose = robot.measured(robot.close(readings).require(lambda row: f"virtual robot: pose {row}").pose)
        table = to_table(self.model.chain.actuated_names, readings, measure(pose, self.channels, self.sensor, seed))
        return to_measurements(table, self.model.chain.actuated_names, self.sensor)


@lru_cache
def bench(name: str, channels: tuple[Channel, ...] | None = None) -> Bench:
    """By default what robot.toml measures, else all that can move: table rows at the sigma of [sensor], no streams."""
    description = load_robot(name).description
    chain = model_stage(description.mechanism, Path(description.urdf)).chain()
    channels = channels or description.measure.channels or default_channels(chain.tool_axes)
    errors = ErrorModel.of(chain, description.actuator, description.tolerance)
    return Bench(errors, description.workspace, channels, description.sensor)


def spread(work: Callable[[Any], Any], jobs: Iterable[Any]) -> Iterator[Any]:
    """work(job) of every job, in order, on PROCESSES processes of one thread each."""
    for library in ("OMP", "OPENBLAS", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")
    with get_context("spawn").Pool(PROCESSES) as pool:
        yield from pool.imap(work, jobs)


def grid(errors: ErrorModel, side: int) -> np.ndarray:
    """Tool coordinates on the paper's uniform grid of the source task, side^3 poses."""
    from kincal.urdf.workspace import grid as uniform

    workspace = load_robot("ups3_s").description.workspace
    return uniform(workspace, errors.chain.tool_axes, [side] * 3)
