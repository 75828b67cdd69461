"""D-optimal poses beside the paper's grid and random poses: how many are needed, and whether the prediction holds.

First the poses that each layout needs for a predicted error, over the workspace's mean and at its worst pose. Then
virtual robots, their errors geometric alone, identified from 10, 20 and 50 poses: the mean error over 500 fresh poses,
averaged over 24 robots, beside the predicted one.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from kincal.identification.accuracy import Score, score
from kincal.identification.estimators import estimate_parameters
from kincal.identification.expected import all_feasible
from kincal.identification.measurements import to_measurements, to_table
from kincal.pipeline.planning.layouts import LAYOUTS, MOST, Planner, planner
from kincal.pipeline.stages.drawing import model_stage
from kincal.pipeline.virtual.robot import draw, measure
from kincal.urdf.description import Layout, VirtualErrors, load_robot
from kincal.urdf.workspace import sample

ROBOTS = 24
COUNTS = (10, 20, 50)
FRESH = 500
# robot, settings, and the errors to reach: [deg] where orientation is looked at, [mm] where position is
CASES = {
    "ups3_s, orientation": ("ups3_s", ['measure.channels=["orientation"]'], {"deg": (0.001, 0.0005, 0.0003)}),
    "ups3_s, tilt alone": ("ups3_s", ['measure.channels=["tilt"]'], {"deg": (0.001, 0.0005, 0.0003)}),
    "jugglebot, orientation and position": ("jugglebot", [], {"deg": (0.1, 0.05, 0.03), "mm": (0.5, 0.3, 0.2)}),
    "ur10, orientation and position": ("ur10", [], {"deg": (0.005, 0.003, 0.002), "mm": (0.03, 0.02, 0.01)}),
}


def main() -> None:
    for case, (name, settings, targets) in CASES.items():
        if sys.argv[1:] and not any(word in case for word in sys.argv[1:]):
            continue
        description = load_robot(name, settings).description
        plan = planner(description, model_stage(description.mechanism, Path(description.urdf)).chain())
        print(f"\n{case}\n{'poses needed for':<26}{''.join(f'{known:>12}' for known in LAYOUTS)}", flush=True)
        for unit, values in targets.items():
            for what in ("mean", "max"):
                for value in values:
                    _needed(plan, f"{what}_{unit}", value, f"{what} {value:g} {unit}")
        errors = {(known, n): _simulated(plan, known, n) for n in COUNTS for known in LAYOUTS}
        for unit in targets:
            print(f"{f'mean [{unit}]: predicted, found':<34}{''.join(f'{known:>20}' for known in LAYOUTS)}")
            for n in COUNTS:
                cells = []
                for known in LAYOUTS:
                    found = np.mean([getattr(error, f"mean_{unit}") for error in errors[known, n]])
                    cells.append(f"{getattr(plan.accuracy(known, n), f'mean_{unit}'):11.5f}{found:9.5f}")
                print(f"{n:>3} poses{'':<25}{''.join(cells)}", flush=True)


def _needed(plan: Planner, name: str, value: float, said: str) -> None:
    def met(accuracy) -> bool:
        return getattr(accuracy, name) <= value

    counts = [plan.needed(known, met, MOST) or f"> {MOST}" for known in LAYOUTS]
    print(f"{said:<26}{''.join(f'{n:>12}' for n in counts)}", flush=True)


def _simulated(plan: Planner, layout: Layout, n: int) -> list[Score]:
    """The errors of identified virtual robots on fresh poses."""
    return [_error(plan, layout, n, seed) for seed in range(ROBOTS)]


def _error(plan: Planner, layout: Layout, n: int, seed: int) -> Score:
    errors, chain = plan.model, plan.model.chain
    truth = errors.robot(draw(errors, VirtualErrors(elastic=False, screw=False), seed).p)
    readings = plan.sites(layout, n).readings
    columns = measure(truth.measured(truth.close(readings).pose), plan.channels, plan.sensor, seed)
    table = to_table(chain.actuated_names, readings, columns)
    identified = errors.robot(estimate_parameters(errors, to_measurements(table, chain.actuated_names, plan.sensor)).p)
    u = sample(plan.workspace, chain.tool_axes, FRESH, [seed, 5])
    fresh = all_feasible(errors, plan.workspace, u, "fresh").readings
    actual, predicted = (robot.measured(robot.close(fresh).pose) for robot in (truth, identified))
    return score(actual, predicted, plan.channels)


if __name__ == "__main__":
    main()
