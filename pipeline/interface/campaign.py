"""Before and during a measurement campaign: which poses to measure, what they will show, and virtual measurements."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from kincal.pipeline.interface.arguments import number, one_of, path, whole_number
from kincal.pipeline.interface.progress import StageObserver, stage_observer
from kincal.pipeline.interface.robots import RobotLike, robot_of
from kincal.pipeline.interface.sessions import opened
from kincal.urdf.description import Robot

if TYPE_CHECKING:
    import pandas as pd

    from kincal.pipeline.planning.foresight import Foresight as Foreseen
    from kincal.pipeline.planning.layouts import PlanReport
    from kincal.pipeline.report.tables import Table


@dataclass(frozen=True, repr=False)
class Plan:
    """Poses to measure, and what they are worth beside other layouts of as many.

    Attributes
    ----------
    report
        The full result.

    Examples
    --------
    >>> import kincal
    >>> plan = kincal.plan("ups3_s", poses=12, layout="grid")
    >>> len(plan), plan.poses.columns[0]
    (12, 'pose')
    """

    report: PlanReport

    @property
    def poses(self) -> pd.DataFrame:
        """One row a pose, in the order to visit them: pose, the actuators' readings, tool coordinates [mm, deg].

        It becomes a measurement table once the measured columns stand beside these.
        """
        return self.report.table

    @property
    def layouts(self) -> pd.DataFrame:
        """One row a layout of as many poses: observability indexes O1 to O5 and the predicted errors [deg, mm]."""
        import pandas as pd

        table = pd.DataFrame(self.to_dict()["layouts"]).set_index("layout")
        counts = ("n_poses", "excited", "excitable")
        return table.astype({name: float for name in table if name not in counts})

    @property
    def needed(self) -> dict[str, int | None]:
        """{layout: poses for the wanted accuracy}; None: more than kincal looks at. Empty: none was wanted."""
        return {str(layout): n for layout, n in self.report.needed.items()}

    def shown(self) -> tuple[Table, Table | None]:
        """For people: the layouts side by side, and how many poses each needs for the wanted accuracy."""
        from kincal.pipeline.planning.layouts import layout_table, needed_table

        return layout_table(self.report.scores), None if self.report.wanted is None else needed_table(self.report)

    def save(self, file: str | PathLike[str], *, force: bool = False) -> Path:
        """Write the poses to a .csv or .parquet file. Raises InputError, also where the file exists without `force`."""
        from kincal.pipeline.planning.layouts import check_output, write_table

        output = Path(file)
        check_output(output, force)
        write_table(self.poses, output)
        return output

    def to_dict(self) -> dict[str, Any]:
        """The document of `kincal plan --json`."""
        from kincal.pipeline.planning.layouts import plan_json

        return plan_json(self.report)

    def __len__(self) -> int:
        return len(self.report.table)

    def __repr__(self) -> str:
        return f"Plan({self.report.robot!r}, {len(self)} poses, {self.report.layout})"


@dataclass(frozen=True, repr=False)
class Foresight:
    """What planned poses will show and what they never will, before anybody measures.

    Attributes
    ----------
    robot
        The robot as drawn.
    foreseen
        The full result: `accuracy` of the identified model as predicted, `observability` indexes, and an
        `identification` without readings.

    Examples
    --------
    >>> import kincal
    >>> foresight = kincal.foresee(kincal.load("ups3_s", {"plan.poses": 20}))
    >>> foresight.parameters.loc["leg1_slide.zero", "unit"]
    'm'
    """

    robot: Robot
    foreseen: Foreseen

    @property
    def parameters(self) -> pd.DataFrame:
        """One row a parameter, its name the index: unit, nominal, std, identifiable, tolerance, data_share."""
        import pandas as pd

        table = pd.DataFrame(self.to_dict()["parameters"]).set_index("name")
        return table.astype({name: float for name in table if name not in ("unit", "identifiable")})

    @property
    def unobservable(self) -> tuple[str, ...]:
        """The directions that such measurements cannot determine, written out in parameters' names."""
        return self.foreseen.identification.unobservable

    def plot(self, file: str | PathLike[str]) -> Path:
        """Draw singular values and shares into an .svg, .png or .pdf file. Raises InputError."""
        from kincal.pipeline.report.identification_figures import draw

        draw(self.foreseen.identification, Path(file), True)
        return Path(file)

    def to_dict(self) -> dict[str, Any]:
        """The document of `kincal inspect --before --json`, without its provenance."""
        from kincal.pipeline.report.parameters import foreseen_json

        return foreseen_json(self.robot.description.name, self.foreseen.identification, self.foreseen.json())

    def __repr__(self) -> str:
        made = self.foreseen.identification
        return f"Foresight({self.robot.description.name!r}, {made.n_poses} poses, rank {made.rank})"


def plan(
    robot: RobotLike,
    *,
    poses: int | None = None,
    layout: Literal["d_optimal", "grid", "random"] | None = None,
    accuracy_deg: float | None = None,
    accuracy_mm: float | None = None,
    output: str | PathLike[str] | None = None,
    force: bool = False,
    store: str | PathLike[str] | None = None,
    progress: StageObserver = False,
) -> Plan:
    """Choose poses to measure.

    Parameters
    ----------
    robot
        A loaded robot, or what `load` takes. Its sensors, tolerances and workspace decide what a pose is worth.
    poses
        How many. Default: as many as the wanted accuracy needs, else `plan.poses` of robot.toml.
    layout
        Default: `plan.layout` of robot.toml, else `d_optimal`.
    accuracy_deg, accuracy_mm
        A mean error of the identified model to reach [deg] and [mm], as predicted.
    output
        Also write the poses to this .csv or .parquet file.
    force
        Write it also where a file of this name stands.
    store
        A folder of cached results, where the checked drawing may be. Default: none.
    progress
        True: lines on stderr. A function: called with each `Event`.

    Returns
    -------
    Plan
        The poses as a table, and the layouts side by side.

    Raises
    ------
    InputError
        Too few poses, an accuracy that cannot be reached, or an unusable robot.

    Notes
    -----
    D-optimal poses maximise the determinant of the information; observability indexes as in Sun and Hollerbach, 2008.

    Examples
    --------
    >>> import kincal
    >>> kincal.plan("ups3_s", poses=12, layout="grid").poses["pose"].tolist()[:3]
    [0, 1, 2]
    """
    from kincal.pipeline.planning.layouts import LAYOUTS, Wanted, check_output, plan_report
    from kincal.pipeline.run.in_memory import InMemory

    if output is not None:
        check_output(path("output", output), force)
    robot = robot_of(robot)
    poses = None if poses is None else whole_number("poses", poses)
    if layout is not None:
        one_of("layout", layout, LAYOUTS)
    accuracy_deg = None if accuracy_deg is None else number("accuracy_deg", accuracy_deg)
    accuracy_mm = None if accuracy_mm is None else number("accuracy_mm", accuracy_mm)
    wanted = None if accuracy_deg is None and accuracy_mm is None else Wanted(accuracy_deg, accuracy_mm)
    if store is None:
        observe = stage_observer(progress, robot.description.name)
        model = InMemory(robot.description, observe=observe).result("model")
    else:
        (model,) = opened(robot, store, progress).until("model")
    result = Plan(plan_report(robot.description, model.chain(), layout, poses, wanted))
    if output is not None:
        result.save(output, force=force)
    return result


def foresee(robot: RobotLike) -> Foresight:
    """Predict what the planned poses will show, before anybody measures.

    Parameters
    ----------
    robot
        A loaded robot, or what `load` takes.

    Returns
    -------
    Foresight
        Which parameters will be identifiable, and how sure the others.

    Raises
    ------
    InputError
        The robot or its plan is not usable.

    Examples
    --------
    >>> import kincal
    >>> foresight = kincal.foresee(kincal.load("ups3_s", {"plan.poses": 20}))
    >>> foresight.foreseen.accuracy.mean_deg < 0.1
    True
    """
    from kincal.pipeline.planning.foresight import foresee as foreseen
    from kincal.pipeline.run.in_memory import InMemory

    robot = robot_of(robot)
    run = InMemory(robot.description)
    return Foresight(robot, foreseen(robot.description, run.result("model"), run.result("plan")))


def measure(robot: RobotLike, *, seed: int | None = None, progress: StageObserver = False) -> pd.DataFrame:
    """Let a virtual robot measure itself at the planned poses.

    Parameters
    ----------
    robot
        A loaded robot, or what `load` takes. `measure.errors` of robot.toml says which errors it has.
    seed
        Draws the robot's errors and the noise. Default: that of robot.toml.
    progress
        True: lines on stderr. A function: called with each `Event`.

    Returns
    -------
    pandas.DataFrame
        A measurement table as `identify` and `calibrate` take it, one row a pose; a stream has gone through the filter.
        `attrs["virtual"]` is True: the errors are simulated.

    Raises
    ------
    InputError
        The robot is not usable.

    Examples
    --------
    >>> import kincal
    >>> kincal.measure("ups3_s", seed=1).columns[:4].tolist()
    ['pose', 'leg1_slide', 'leg2_slide', 'leg3_slide']
    """
    from kincal.pipeline.run.in_memory import InMemory

    robot = virtual_robot(robot, seed)
    observe = stage_observer(progress, robot.description.name)
    table = InMemory(robot.description, observe=observe).result("filter").table
    table.attrs["virtual"] = True
    return table


def virtual_robot(robot: RobotLike, seed: int | None = None) -> Robot:
    """The same robot, measuring itself whatever its robot.toml names. Raises InputError."""
    chosen = {} if seed is None else {"measure.seed": seed}
    return robot_of(robot, {"measure.source": "virtual", **chosen})
