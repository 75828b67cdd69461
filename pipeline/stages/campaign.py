"""Which poses to measure, what was measured there, and what a filter makes of streams."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from kincal.pipeline.results import Filtered, Measured, Model, PosePlan
from kincal.pipeline.stages.robot_data import DrawnRobot
from kincal.urdf.description import Actuator, Filter, Instruments, Measure, Plan, Sensor

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd


def plan_stage(
    model: Model, plan: Plan, actuator: dict[str, Actuator], instruments: Instruments | None, seed: int
) -> PosePlan:
    """Which poses to measure: the paper's uniform grid, random poses, or D-optimal ones."""
    import pandas as pd

    from kincal.identification.poses import planned
    from kincal.urdf.actuators import Actuators
    from kincal.urdf.kinematics import inverse
    from kincal.urdf.workspace import AXES, check_limits

    chain = model.chain()
    if instruments is None:
        u = planned(model.mechanism.workspace, chain.tool_axes, plan, seed)
    else:
        from kincal.identification.d_optimal import d_optimal
        from kincal.identification.error_model import ErrorModel
        from kincal.identification.expected import of_one_row

        errors = ErrorModel.of(chain, actuator, instruments.tolerance)
        channels, sensor = of_one_row(instruments, chain.tool_axes)
        sites = d_optimal(errors, model.mechanism.workspace, channels, sensor, plan.poses, seed)
        u = sites.in_travel_order(chain).u
    closure = inverse(chain, u).require(lambda row: f"plan: pose {row}")
    check_limits(chain, closure.q, lambda row: f"plan: pose {row}")
    readings = Actuators.nominal(chain, actuator).readings(closure.q[:, chain.actuated])
    columns = {name: readings[:, k] for k, name in enumerate(chain.actuated_names)}
    columns |= {f"planned_{AXES[a]}": u[:, a] for a in chain.tool_axes}
    return PosePlan(pd.DataFrame({"pose": range(len(u)), **columns}))


def measure_stage(robot: DrawnRobot, plan: PosePlan, measure: Measure, sensor: Sensor, seed: int) -> Measured:
    """The measurement table and streams: read from files, or measured by a virtual robot on itself."""
    from kincal.identification.measurements import to_table
    from kincal.pipeline.virtual.robot import VirtualRobot, default_channels, draw, stream_of
    from kincal.pipeline.virtual.robot import measure as sense

    nominal = robot.errors
    chain = nominal.chain
    if not measure.virtual:
        return _from_files(robot, measure, sensor)
    seed = seed if measure.seed is None else measure.seed
    truth = draw(nominal, measure.errors, seed)
    readings = plan.table[list(chain.actuated_names)].to_numpy()
    virtual = VirtualRobot.of(nominal, truth)
    pose, cross_axis = virtual.pose(readings, virtual.campaign(readings)), measure.errors.cross_axis
    channels = measure.channels or default_channels(chain.tool_axes)
    # a stream is an inclinometer's: a heading without tilt comes as one reading a pose
    streamed = tuple(c for c in channels if c in ("tilt", "yaw")) if measure.stream and "tilt" in channels else ()
    columns = sense(pose, tuple(c for c in channels if c not in streamed), sensor, seed, cross_axis)
    stream = None
    if measure.stream and streamed:
        stream = stream_of(pose, streamed, sensor, measure.stream, seed, cross_axis)
    return Measured("virtual", to_table(chain.actuated_names, readings, columns), stream, truth)


def filter_stage(measured: Measured, filter: Filter, sensor: Sensor) -> Filtered:
    """Raw streams -> one row a pose, by the extended Kalman filter; a table without streams goes through as it is.

    Poses that a stream does not tell are left out.
    """
    if measured.stream is None:
        return Filtered(measured.table, 0, 0)
    from kincal.identification.inclinometer import filter_stream

    table = measured.table
    attitudes = filter_stream(measured.stream, table["pose"].to_numpy(), sensor, filter, f"stream ({measured.source})")
    used, gated = (int(attitudes.rows[name].to_numpy().sum()) for name in ("used", "gated"))
    rows = attitudes.rows.drop(columns=["used", "gated"])
    table = table.merge(rows, on="pose", validate="1:1")
    return Filtered(table, used, gated, attitudes.dropped, attitudes.innovations, attitudes.yaw_stuck)


def _from_files(robot: DrawnRobot, measure: Measure, sensor: Sensor) -> Measured:
    """Static poses as a table; joint values and a stream that names poses; or a log and the commands of its time."""
    from kincal.identification.joint_limits import check_readings
    from kincal.identification.measurement_table import noted_table
    from kincal.identification.skipped_poses import kept, skip_note
    from kincal.identification.streams.angle_units import check_units
    from kincal.identification.streams.campaign import Campaign
    from kincal.identification.streams.reading import read_stream
    from kincal.identification.streams.static_poses import static_poses

    nominal, tolerance, chain = robot.errors, robot.tolerance, robot.errors.chain
    if measure.commands is not None:
        poses = static_poses(measure, chain.actuated_names)
        numbers, dropped = poses.table["pose"].to_numpy(), (d.pose for d in poses.campaign.dropped)
        rows = kept(numbers, measure.skip, measure.commands, dropped)
        table = poses.table[rows].reset_index(drop=True)
        check_readings(table, chain, nominal.actuators, tolerance, measure.commands)
        check_units(poses.stream, table, nominal, measure, poses.campaign.health.format)
        notes = (skip_note(measure.skip, measure.commands),) if measure.skip else ()
        return Measured(poses.campaign.health.file, table, poses.stream, None, poses.campaign, notes)
    assert measure.table is not None
    settings = measure if measure.streams is None else measure.of_columns(("pose", *chain.actuated_names))
    table, notes = noted_table(measure.table, chain.actuated_names, settings, measured=measure.streams is None)
    if measure.streams is None:
        check_measured(robot, table, sensor, measure.table)
        return Measured(measure.table.name, table, None, None, notes=notes)
    check_readings(table, chain, nominal.actuators, tolerance, measure.table)
    stream, health = read_stream(measure.streams, measure)
    check_units(stream, table, nominal, measure, health.format)
    return Measured(health.file, table, stream, None, Campaign(health, None, len(table), len(table), ()), notes)


def check_measured(robot: DrawnRobot, table: pd.DataFrame, sensor: Sensor, file: Path | str) -> None:
    """Refuse joint values beyond the limits, with the likely cause. Raises InputError.

    table: canonical, with what was measured.
    """
    from kincal.identification.joint_limits import beyond_limits
    from kincal.identification.likely_causes import likely_causes
    from kincal.identification.measurements import to_measurements

    model = robot.errors
    beyond = beyond_limits(table, model.chain, model.actuators, robot.tolerance, file)
    if beyond is None:
        return
    causes = likely_causes(model, to_measurements(table, model.chain.actuated_names, sensor), math.inf)
    raise beyond.error("" if causes is None else str(causes))
