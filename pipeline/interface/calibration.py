"""A calibrated robot: the results of all stages, cached in a store, and what they predict, command and export."""

from __future__ import annotations

import json
import os
import weakref
from collections.abc import Mapping
from dataclasses import asdict
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kincal.pipeline.interface.campaign import Foresight
from kincal.pipeline.interface.data import Data, Readings, raw_readings, raw_table, score_frame
from kincal.pipeline.interface.fit import Fit, measured_table
from kincal.pipeline.interface.progress import StageObserver, logger
from kincal.pipeline.interface.robots import RobotLike, robot_of
from kincal.pipeline.interface.sessions import COMMAND, opened
from kincal.urdf.description import Robot, listed
from kincal.urdf.errors import InputError

if TYPE_CHECKING:
    import pandas as pd

    from kincal.pipeline.compensator.solvers import Solvers
    from kincal.pipeline.export.formats import Export
    from kincal.pipeline.interface.campaign import Foresight
    from kincal.pipeline.interface.changes import CampaignChanges
    from kincal.pipeline.interface.fit import Fit
    from kincal.pipeline.methods.calibrated import CalibratedRobot
    from kincal.pipeline.report.verdict import Verdict
    from kincal.pipeline.results import Comparison
    from kincal.pipeline.run.runner import Run

# settings of a table that was read already
_CANONICAL = ("measure.columns={}", "measure.rotation_vector=false", "measure.skip=[]")


class Calibration:
    """A robot with all stages of the pipeline behind it. A stage runs when its result is first asked for.

    `calibrate` makes one.

    Examples
    --------
    >>> import kincal
    >>> calibration = kincal.Calibration.open("ups3_s")
    >>> calibration.status()["stage"].tolist()[:3]
    ['model', 'plan', 'measure']
    """

    def __init__(self, session: Run) -> None:
        self._session = session
        self._results: dict[str, Any] = {}  # {stage: its result}, of those that were asked for
        self._calibrated: dict[str | None, CalibratedRobot] = {}
        self._solvers: Solvers | None = None  # of the methods that were commanded

    @classmethod
    def open(
        cls,
        robot: RobotLike,
        data: Data | None = None,
        *,
        store: str | PathLike[str] | None = None,
        progress: StageObserver = False,
        command: str = COMMAND,
        force_from: str | None = None,
    ) -> Calibration:
        """As `calibrate`, but no stage runs yet.

        Parameters
        ----------
        robot, data, store, progress
            As in `calibrate`.
        command
            What the provenance of results says about where they came from.
        force_from
            This stage and all after it run again, cached or not.

        Returns
        -------
        Calibration

        Raises
        ------
        InputError
            The robot or the table is not usable, or there is no such stage.
        """
        if data is None or isinstance(data, str | PathLike):
            settings = {} if data is None else {"measure.table": Path(data)}
            return cls(opened(robot_of(robot, settings), store, progress, command, force_from))
        return cls(_measured_by(data, opened(robot, store, progress, command, force_from)))

    @property
    def robot(self) -> Robot:
        """The robot, with the settings that these results were made with."""
        return self._session.robot

    @property
    def store(self) -> Path:
        """The folder of cached results."""
        return self._session.store.root

    @property
    def fit(self) -> Fit:
        """The identified geometry."""
        from kincal.pipeline.interface.fit import Fit

        return Fit(self.robot, self._until("identify")[0].shipped)

    @property
    def foresight(self) -> Foresight:
        """What the planned poses will show, before anybody measures."""
        from kincal.pipeline.interface.campaign import Foresight
        from kincal.pipeline.planning.foresight import foresee

        model, plan = self._until("model", "plan")
        return Foresight(self.robot, foresee(self.robot.description, model, plan))

    @property
    def folder(self) -> Path:
        """The robot's folder in the store: its report, and notes of what it used last."""
        return self._session.store.root / "robots" / self._session.robot_id

    @property
    def comparison(self) -> Comparison:
        """The methods side by side, with everything that `kincal compare --json` has."""
        return self._until("evaluate")[0]

    @property
    def advice(self) -> str:
        """Which method to use, and what error to expect."""
        advice = self.comparison.advice
        return "" if advice is None else advice.text

    @property
    def virtual(self) -> bool:
        """Whether the robot is simulated: no measurement of a real robot went into any result."""
        return self.robot.description.measure.virtual

    @property
    def verdict(self) -> Verdict | None:
        """Whether the recommended method meets `[limits]` at held-out poses as measured; None: no limits are set.

        Raises InputError for a limit on a quantity that was not measured.
        """
        return self.verdict_of(self.comparison)

    def verdict_of(self, compared: Comparison) -> Verdict | None:
        """Judge another comparison, as `evaluation` returns it, by the same limits. Raises InputError as `verdict`."""
        from kincal.pipeline.report.verdict import verdict

        limits = self.robot.description.limits
        advice = self.comparison.advice if limits.given else None
        return None if advice is None else verdict(limits, compared, advice.method)

    def changes_since(self, before: Calibration) -> CampaignChanges:
        """Compare the geometry with that of an earlier campaign of the same robot, in sigmas.

        Parameters
        ----------
        before
            A calibration of the same robot.toml from other measurements.

        Returns
        -------
        CampaignChanges
            `changed`, `table`, and `lines` for people.

        Raises
        ------
        InputError
            The two robots have different drawings.
        CalibrationError
            As the stages that run.
        """
        from kincal.pipeline.interface.changes import changes_between

        found = changes_between(before.fit, self.fit)
        if found is None:
            names = f"{before.robot.description.name} and {self.robot.description.name}"
            raise InputError(f"{names}: two designs; allowed are two campaigns of one robot.toml")
        return found

    def compare(self) -> pd.DataFrame:
        """Compare the six methods on poses that none of them has seen.

        Returns
        -------
        pandas.DataFrame
            One row a method, its name the index. Columns as in `kincal sweep`: mean_deg, max_deg, sd_deg, x_deg, y_deg,
            z_deg, mean_mm, max_mm, sd_mm, closed_loop_* (a virtual robot after compensation) and held_out_*. NaN: not
            measured.

        Raises
        ------
        InputError, CalibrationError
            As the stages that run.
        """
        return score_frame(self.comparison)

    def predict(self, readings: Readings, *, method: str = "hybrid") -> pd.DataFrame:
        """Predict poses in the measurement frame.

        Parameters
        ----------
        readings
            Actuator readings: an array (n, n_actuated) in the order of `actuated` in robot.toml, a DataFrame with one
            column for each joint, or the path of such a table. In the units of the measurement table.
        method
            One of those that `compare` lists.

        Returns
        -------
        pandas.DataFrame
            One row a reading: pose; qx, qy, qz, qw, or roll and pitch, yaw [rad]; x, y, z [m]: what was measured. With
            `geometric` and `hybrid` also `*_std`, one standard deviation, and `*_95`, the radius of the 95 % region
            [rad, m], both without the noise of an instrument. `share` (hybrid): how much of the correction counts.

        Raises
        ------
        InputError
            A column is missing, a value is no number or beyond the joint limits, or there is no such method.
        CalibrationError
            As the stages that run.
        """
        from kincal.pipeline.methods.calibrated import naming
        from kincal.pipeline.methods.prediction import predicted_table

        calibrated = self._with(method)
        description = self.robot.description
        names = calibrated.model.chain.actuated_names
        settings = description.measure.of_columns(("pose", *names))
        raw, source = raw_readings(readings, names, settings)
        numbers, values = calibrated.readings(raw, source)
        with naming(source):
            return predicted_table(calibrated.calibrated, method, numbers, values)

    def compensate(self, desired: Data, *, method: str = "hybrid", strict: bool = False) -> pd.DataFrame:
        """Find the actuator readings that bring the tool to desired poses.

        Parameters
        ----------
        desired
            Desired poses in the measurement frame: a DataFrame with the columns of a measurement table without joints
            (x, y, z [m]; qx, qy, qz, qw; roll, pitch, yaw [rad]), or the path of such a table.
        method
            One of those that `compare` lists.
        strict
            Raise an InputError for the first pose that cannot be reached, instead of saying so in its row.

        Returns
        -------
        pandas.DataFrame
            One row a pose: pose, one column for each joint, `reached`, and `obstacle`: why the pose cannot be reached.
            The readings of a pose that cannot be reached are NaN.

        Raises
        ------
        InputError
            A column is missing, a value is no number, or there is no such method.
        CalibrationError
            As the stages that run.
        """
        import numpy as np
        import pandas as pd

        from kincal.pipeline.compensator.desired import commands_of
        from kincal.pipeline.compensator.solvers import Solvers

        calibrated = self._with(method)
        raw, source = raw_table(desired, self.robot.description.measure, "desired")
        self._solvers = self._solvers or Solvers(self.robot.description.workspace)
        commands = commands_of(calibrated, self._solvers, method, raw, source)
        if strict:
            commands.check()
        if commands.outside.any():
            logger.warning(
                "poses %s are outside [workspace]: nobody has measured how accurate the robot is there",
                listed(commands.poses[commands.outside]),
            )
        reached = np.array([not obstacle for obstacle in commands.obstacles])
        readings = np.where(reached[:, None], commands.readings, np.nan)
        columns = dict(zip(calibrated.model.chain.actuated_names, readings.T, strict=True))
        obstacles = [f"pose {n}{o}" if o else "" for n, o in zip(commands.poses, commands.obstacles, strict=True)]
        return pd.DataFrame({"pose": commands.poses, **columns, "reached": reached, "obstacle": obstacles})

    def evaluate(
        self, data: Data, *, register: bool = False, rehome: bool = False, columns: str | PathLike[str] | None = None
    ) -> pd.DataFrame:
        """Measure the methods' errors on data that no stage has seen.

        Parameters
        ----------
        data
            A measurement table of another day: a DataFrame, or the path of a CSV or Parquet file.
        register
            First fit the instrument's frame W anew: it was set up again.
        rehome
            First fit the actuators' zeros anew: the robot was homed again.
        columns
            A TOML file with a column map for this table, as `[measure.columns]` has it.

        Returns
        -------
        pandas.DataFrame
            As `compare`.

        Raises
        ------
        InputError
            The table is not usable, or has too few poses for a fit.
        CalibrationError
            The fit of W or the zeros did not converge; or as the stages that run.
        """
        return score_frame(self.evaluation(data, register=register, rehome=rehome, columns=columns))

    def evaluation(
        self, data: Data, *, register: bool = False, rehome: bool = False, columns: str | PathLike[str] | None = None
    ) -> Comparison:
        """As `evaluate`, with everything that `kincal evaluate --json` has.

        Parameters
        ----------
        data, register, rehome, columns
            As in `evaluate`.

        Returns
        -------
        Comparison

        Raises
        ------
        InputError, CalibrationError
            As `evaluate`.
        """
        from kincal.identification.measurements import to_measurements
        from kincal.pipeline.methods.evaluation import evaluated
        from kincal.urdf.description import read_columns

        calibrated, settings = self._with(None), self.robot.description.measure
        if columns is not None:
            settings = settings.model_copy(update={"columns": read_columns(Path(columns))})
        raw, source = raw_table(data, settings, "data", self.robot.description.actuated)
        measured = calibrated.measurements(raw, source, settings)
        trained_on = self._until("measure")[0].source
        comparison = evaluated(calibrated, measured, source, trained_on=trained_on, register=register, rehome=rehome)
        names = calibrated.model.chain.actuated_names
        used = to_measurements(self._until("filter")[0].table, names, self.robot.description.sensor)
        if known := measured.shared_with(used):
            text = "%s: %d of %d poses were used for the calibration: their errors are too small"
            logger.warning(text, source, known, len(measured))
        return comparison

    def export(
        self,
        output: str | PathLike[str] | None = None,
        *,
        format: str = "urdf",
        method: str | None = None,
        force: bool = False,
    ) -> Export:
        """Write the calibrated robot for other programs. It is read back and checked before it is handed out.

        Parameters
        ----------
        output
            A folder (urdf, c) or a file (json). Default: NAME_calibrated or NAME_compensator in the current folder;
            json: the document is returned alone.
        format
            urdf: robot.urdf, robot.toml and parameters.csv. json: one document. c: the compensator for a controller.
        method
            Of the compensator: hybrid (default) or geometric.
        force
            Write also where something stands that an export has not made.

        Returns
        -------
        Export
            `path`: where it was written. `document`: of json. `lines`: how well it agrees with the identified model.

        Raises
        ------
        InputError
            There is no such format; the output is not free or can't be written; the robot has no URDF.
        CalibrationError
            The export does not predict what the identified model predicts: nothing is written.
        """
        from kincal.pipeline.export.formats import export

        return export(self._session, format, None if output is None else Path(output), force, method)

    def report(self, output: str | PathLike[str] | None = None) -> Path:
        """Write the report: one HTML page with comparison, parameters, residuals and provenance.

        Parameters
        ----------
        output
            The file to write. Default: report.html in the robot's folder of the store.

        Returns
        -------
        pathlib.Path
            The file.

        Raises
        ------
        InputError
            The file can't be written.
        CalibrationError
            As the stages that run.
        """
        from kincal.pipeline.run.provenance import published
        from kincal.pipeline.store.files import refusing, replace_file

        (report,) = self._until("report")
        if output is None:
            return self._session.publish(report)
        file = Path(output)
        with refusing(f"report {file}"):
            replace_file(file, published(report.html, self._session.entries))
        return file

    def until(self, stage: str, *more: str) -> None:
        """Bring stages and all that they rest on up to date.

        Parameters
        ----------
        stage, more
            Their names: `status` lists them.

        Raises
        ------
        InputError, CalibrationError
            There is no such stage; or as the stages that run.
        """
        from kincal.pipeline.run.stage import needed

        force_from, last = self._session.force_from, (stage, *more)[-1]
        if force_from is not None and force_from not in (before.name for before in needed(last)):
            raise InputError(f"--force-from {force_from}: --until {last} does not need that stage")
        self._until(stage, *more)

    def document(self, stage: str = "evaluate") -> dict[str, Any]:
        """The document of `kincal run --until STAGE --json`: the comparison where the stage is `evaluate`.

        Raises InputError and CalibrationError as `until`.
        """
        self.until(stage)
        name = self.robot.description.name
        document: dict[str, Any] = {"robot": name, "virtual": self.virtual, "stage": stage}
        if stage == "evaluate":
            document = self.comparison_document(self.comparison)
        return document | {"provenance": self.provenance(stage)}

    def comparison_document(self, compared: Comparison) -> dict[str, Any]:
        """A comparison with the verdict on it, as JSON."""
        judged = self.verdict_of(compared)
        verdict = None if judged is None else asdict(judged) | {"passed": judged.passed}
        return asdict(compared) | {"virtual": self.virtual, "verdict": verdict}

    def provenance(self, *stages: str, files: Mapping[str, Path] | None = None) -> dict[str, Any]:
        """What the results of stages that are up to date were made of: command, seed, versions, digests.

        files: whatever else went into a result, by name.
        """
        from kincal.pipeline.run.changes import file_digest
        from kincal.pipeline.run.provenance import provenance

        document = provenance(self._session.entries, stages, self._session.command)
        document["files"] |= {name: file_digest(file) for name, file in (files or {}).items()}
        return document

    def status(self) -> pd.DataFrame:
        """Each stage, whether it is fresh, stale or missing, and why. Nothing runs."""
        import pandas as pd

        return pd.DataFrame(self.stages(), columns=pd.Index(["stage", "state", "why"]))

    def stages(self) -> list[tuple[str, str, str]]:
        """As `status`, in plain values."""
        return list(self._session.status())

    def _with(self, method: str | None) -> CalibratedRobot:
        """With what `method` needs; None: all."""
        from kincal.pipeline.run.calibrated import calibrated

        if method not in self._calibrated:
            self._calibrated[method] = calibrated(self.robot.description, self._until, method)
        return self._calibrated[method]

    def _until(self, *stages: str) -> list[Any]:
        """The results of stages; each is brought up to date once, whatever becomes of the files meanwhile."""
        missing = [stage for stage in stages if stage not in self._results]
        if missing:
            self._results |= zip(missing, self._session.until(*missing), strict=True)
        return [self._results[stage] for stage in stages]

    def __repr__(self) -> str:
        return f"Calibration({self.robot!r}, store={str(self.store)!r})"


def export_formats() -> dict[str, str]:
    """Name each export format, and what it writes: {format: text}."""
    from kincal.pipeline.export.formats import FORMATS

    return {name: format.help for name, format in FORMATS.items()}


def calibrate(
    robot: RobotLike,
    data: Data | None = None,
    *,
    store: str | PathLike[str] | None = None,
    progress: StageObserver = False,
) -> Calibration:
    """Calibrate a robot: identify its geometry, train the networks, compare the six methods.

    Parameters
    ----------
    robot
        A loaded robot, or what `load` takes.
    data
        The measurement table: a DataFrame, or the path of a CSV or Parquet file. One row a pose: one column for each
        actuated joint, and what was measured (x, y, z [m]; qx, qy, qz, qw; roll, pitch, yaw [rad]; `*_std`).
        Default: what robot.toml names, or a virtual robot that measures itself.
    store
        The folder of cached results, as `--store` of the command line; what is there is not computed again. Default: a
        temporary folder that is removed together with the answer.
    progress
        True: lines on stderr. A function: called with each `Event`. Warnings go to the logger `kincal.pipeline`.

    Returns
    -------
    Calibration
        It predicts, compensates, evaluates, exports and reports.

    Raises
    ------
    InputError
        The robot, the table or a value in it is not usable; the message says what is allowed.
    CalibrationError
        A stage failed its own checks; what the stages before it made is in the store.

    Examples
    --------
    >>> import kincal
    >>> quick = {"plan.poses": 20, "prior.poses": 64, "siblings.count": 2, "siblings.iterations": 20}
    >>> robot = kincal.load("ups3_s", quick)
    >>> calibration = kincal.calibrate(robot, kincal.measure(robot, seed=1))
    >>> calibration.compare().index.tolist()
    ['nominal', 'geometric', 'network', 'transfer', 'transfer_identified', 'hybrid']
    """
    calibration = Calibration.open(robot, data, store=store, progress=progress)
    calibration.until("evaluate")
    return calibration


def _measured_by(data: Data, session: Run) -> Run:
    """The same session with a table that came as a value. Raises InputError.

    The table is kept in the store, so that a cached result can be traced to it and found again.
    """
    (model,) = session.until("model")
    table = measured_table(session.robot, model, data).table
    content: bytes = table.to_parquet(index=False)
    file, held = session.store.add_table(content)
    weakref.finalize(session, os.close, held)
    settings = (f"measure.table={json.dumps(str(file))}", 'measure.source="files"', *_CANONICAL)
    session.robot = robot_of(session.robot, settings)
    return session
