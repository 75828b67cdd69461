"""The robot as built: every geometric parameter, and how sure it is."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kincal.pipeline.interface.data import Data, raw_table
from kincal.pipeline.interface.progress import StageObserver, logger, stage_observer
from kincal.pipeline.interface.robots import RobotLike, robot_of
from kincal.urdf.description import Robot

if TYPE_CHECKING:
    import pandas as pd

    from kincal.identification.identification import Identification
    from kincal.pipeline.results import Measured, Model


@dataclass(frozen=True, repr=False)
class Fit:
    """The identified geometry of a robot. Numbers are in SI units and radians.

    Attributes
    ----------
    robot
        The robot that was identified.
    identification
        The full result, with its arrays.

    Examples
    --------
    >>> import kincal
    >>> fit = kincal.identify(kincal.load("ups3_s", {"plan.poses": 20}))
    >>> fit.parameters.loc["leg1_slide.zero", "unit"]
    'm'
    """

    robot: Robot
    identification: Identification

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """One row a parameter, its name the index.

        Columns: unit, nominal, identified, change, std, low and high (the 95 % interval), identifiable, tolerance,
        data_share (how much of the change the measurements determine; the rest is the tolerance's) and some more, as
        in `kincal inspect --json`. NaN: neither the measurements nor a tolerance say anything.
        """
        import pandas as pd

        table = pd.DataFrame(self.to_dict()["parameters"]).set_index("name")
        numbers = [name for name in table if name not in ("unit", "identifiable")]
        return table.astype(dict.fromkeys(numbers, float))

    @cached_property
    def covariance(self) -> pd.DataFrame:
        """(n_parameters, n_parameters) covariance of the estimates, labelled with the parameters' names.

        Directions that nothing determines are left out of it: `parameters["std"]` is NaN for those that take part.
        """
        import pandas as pd

        names = pd.Index(self.identification.names, name="name")
        return pd.DataFrame(self.identification.covariance, index=names, columns=names)

    @property
    def findings(self) -> tuple[str, ...]:
        """What an engineer should know before signing, a sentence each."""
        return self.identification.findings

    @property
    def unobservable(self) -> tuple[str, ...]:
        """The directions that the measurements cannot determine, written out in parameters' names."""
        return self.identification.unobservable

    @property
    def outliers(self) -> pd.DataFrame:
        """The poses whose residuals are too large to be chance: columns pose and reason."""
        import pandas as pd

        rows = [(outlier.pose, outlier.reason) for outlier in self.identification.outliers]
        return pd.DataFrame(rows, columns=pd.Index(["pose", "reason"]))

    def to_dict(self) -> dict[str, Any]:
        """The document of `kincal inspect --json`, without its provenance."""
        from kincal.pipeline.report.parameters import parameters_json

        document = parameters_json(self.robot.description.name, self.identification)
        return document | {"virtual": self.robot.description.measure.virtual}

    def plot(self, file: str | PathLike[str]) -> Path:
        """Draw singular values, shares of data and tolerance, and changes into an .svg, .png or .pdf file.

        Raises InputError where the file can't be written.
        """
        from kincal.pipeline.report.identification_figures import draw

        draw(self.identification, Path(file), False)
        return Path(file)

    def __repr__(self) -> str:
        made = self.identification
        channels = ", ".join(made.channels)
        return (
            f"Fit({self.robot.description.name!r}, {made.n_poses} poses ({channels}), "
            f"rank {made.rank} of {len(made.names)} parameters, {len(made.findings)} findings)"
        )


def identify(robot: RobotLike, data: Data | None = None, *, progress: StageObserver = False) -> Fit:
    """Identify the geometry of a robot from measured poses: in memory, without networks and without a store.

    Parameters
    ----------
    robot
        A loaded robot, or what `load` takes.
    data
        The measurement table: a DataFrame, or the path of a CSV or Parquet file. One row a pose: one column for each
        actuated joint, and what was measured (x, y, z [m]; qx, qy, qz, qw; roll, pitch, yaw [rad]; `*_std`).
        Default: what robot.toml names, or a virtual robot that measures itself.
    progress
        True: lines on stderr. A function: called with each `Event`.

    Returns
    -------
    Fit
        The identified parameters, their covariance, and findings.

    Raises
    ------
    InputError
        The robot, the table or a value in it is not usable; the message says what is allowed.
    CalibrationError
        The fit failed its own checks.

    Notes
    -----
    All parameters at once, by maximum a posteriori with the tolerances as priors, unless robot.toml says otherwise.
    Full-parameter model and identification after Huang et al., Mech. Mach. Theory 131 (2019) 371-384.

    Examples
    --------
    >>> import kincal
    >>> robot = kincal.load("ups3_s", {"plan.poses": 20})
    >>> fit = kincal.identify(robot, kincal.measure(robot, seed=1))
    >>> fit.parameters.columns[:5].tolist()
    ['unit', 'nominal', 'identified', 'change', 'std']
    """
    from kincal.pipeline.run.in_memory import InMemory
    from kincal.pipeline.run.threads import fixed_threads
    from kincal.pipeline.stages.identification import as_built
    from kincal.pipeline.stages.robot_data import Poses

    robot = robot_of(robot)
    description = robot.description
    observe = stage_observer(progress, description.name)
    run = InMemory(description, observe=observe)
    model = run.result("model")
    if data is not None:
        run = InMemory(description, {"model": model, "measure": measured_table(robot, model, data)}, observe)
    poses = Poses.measured_on(model, run.result("filter"), description)
    with fixed_threads(("scipy",)):
        identification = as_built(poses, description.identify).identification
    return Fit(robot, identification)


def measured_table(robot: Robot, model: Model, data: Data) -> Measured:
    """A table that was brought, as the measure stage hands it on. Raises InputError."""
    from kincal.identification.measurement_table import measured_poses
    from kincal.pipeline.results import Measured
    from kincal.pipeline.stages.campaign import check_measured
    from kincal.pipeline.stages.robot_data import DrawnRobot

    description = robot.description
    raw, source = raw_table(data, description.measure, "data", description.actuated)
    drawn = DrawnRobot.of(model, description)
    table, notes = measured_poses(raw, drawn.errors.chain.actuated_names, description.measure, source)
    check_measured(drawn, table, description.sensor, source)
    for note in notes:
        logger.warning("%s", note)
    name = source.name if isinstance(source, Path) else source
    return Measured(name, table, None, None, notes=notes)
