"""The methods against measurements that no stage has seen."""

from __future__ import annotations

from pathlib import Path

from kincal.identification.measurements import Measurements
from kincal.pipeline.methods.calibrated import CalibratedRobot, naming
from kincal.pipeline.methods.predictors import uncalibrated
from kincal.pipeline.methods.refit import refitted
from kincal.pipeline.methods.scores import scores
from kincal.pipeline.results import RAW, Comparison


def evaluated(
    calibrated: CalibratedRobot,
    measured: Measurements,
    source: Path | str,
    *,
    trained_on: str,
    register: bool,
    rehome: bool,
) -> Comparison:
    """Each method's errors at measured poses; source: where they came from. Raises InputError and CalibrationError.

    register: W is first refitted alone; rehome: the actuators' zeros are. Each method is refitted by its own
    predictions of the same poses. trained_on: what the robot was calibrated with.
    """
    model, methods = calibrated.model, dict(calibrated.methods)
    if register or rehome:
        with naming(source):
            methods = {name: refitted(method, measured, register, rehome) for name, method in methods.items()}
    actual, channels = measured.as_poses(), measured.channels
    return Comparison(
        robot=calibrated.description.name,
        source=trained_on,
        n_poses=calibrated.identification.n_poses,
        n_scored=len(measured),
        scored_on=str(source),
        channels=channels,
        methods=scores(methods, measured, actual, channels),
        held_out=(),
        n_held_out=0,
        raw_nominal=scores({RAW: uncalibrated(model)}, measured, actual, channels)[0],
        closed_loop=(),
        not_reached={},
    )
