"""A calibrated robot: what was identified and learned from all measured poses, and the tables that it reads."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import pandas as pd

from kincal.identification.error_model import ErrorModel
from kincal.identification.identification import Identification
from kincal.identification.joint_limits import check_readings
from kincal.identification.measurement_table import canonical_table
from kincal.identification.measurements import Measurements, to_measurements
from kincal.pipeline.learned import Corrected, Hybrids, Learned, Transferred
from kincal.pipeline.methods.covariance import pose_covariance
from kincal.pipeline.methods.predictors import METHODS, HybridMethod, Method, ModelMethod, build
from kincal.pipeline.results import Fit, Identified
from kincal.urdf.description import Measure, RobotDescription, nearest
from kincal.urdf.errors import InputError, UnknownNameError

SURE = ("geometric", "hybrid")  # the methods that come with a covariance


@dataclass(frozen=True)
class Calibrated:
    """What was identified and learned from some measured poses."""

    model: ErrorModel
    fit: Fit
    learned: Learned | None  # None: nobody asked for the networks
    corrected: Corrected | None
    channels: tuple[str, ...]

    @cached_property
    def methods(self) -> Mapping[str, Method]:
        """In the table's order; without those that nobody asked for."""
        return build(self.model, self.fit, self.learned, self.corrected, self.channels)

    def covariance(self, method: str, readings: np.ndarray) -> np.ndarray | None:
        """(n, 6, 6) of predicted poses, as `pose_covariance` has it; None for methods without one."""
        chosen = self.methods.get(method)
        if self.corrected is None or method not in SURE:
            return None
        assert isinstance(chosen, ModelMethod | HybridMethod)
        return pose_covariance(self.model, self.fit, self.corrected, chosen, readings)


def calibrations(
    model: ErrorModel, identified: Identified, transferred: Transferred, hybrids: Hybrids
) -> tuple[Calibrated, ...]:
    """One a fit, in the order of `Identified.fits`: from all measured poses first."""
    parts = zip(identified.fits(), transferred.fits, hybrids.fits, strict=True)
    return tuple(Calibrated(model, *part, identified.shipped.channels) for part in parts)


@dataclass(frozen=True)
class CalibratedRobot:
    """A robot with what was identified and learned from all of its measured poses, and the tables that it reads."""

    description: RobotDescription
    identification: Identification
    calibrated: Calibrated

    @property
    def model(self) -> ErrorModel:
        return self.calibrated.model

    @property
    def channels(self) -> tuple[str, ...]:
        return self.calibrated.channels

    @property
    def methods(self) -> Mapping[str, Method]:
        return self.calibrated.methods

    def table(self, raw: pd.DataFrame, source: Path | str, settings: Measure, measured: bool) -> pd.DataFrame:
        """A table other than the measured one -> the canonical one, its readings checked. Raises InputError."""
        chain = self.model.chain
        table = canonical_table(raw, chain.actuated_names, settings.of_other_table(), source, measured)
        check_readings(table, chain, self.model.actuators, self.description.tolerance, source)
        return table

    def readings(self, raw: pd.DataFrame, source: Path | str) -> tuple[np.ndarray, np.ndarray]:
        """The poses' numbers (n,) and the actuators' readings (n, n_actuated) of a table. Raises InputError."""
        names = self.model.chain.actuated_names
        table = self.table(raw, source, self.description.measure.of_columns(("pose", *names)), measured=False)
        return table["pose"].to_numpy(), table[list(names)].to_numpy(float)

    def measurements(self, raw: pd.DataFrame, source: Path | str, settings: Measure) -> Measurements:
        """A table of measured poses. Raises InputError."""
        table = self.table(raw, source, settings, measured=True)
        return to_measurements(table, self.model.chain.actuated_names, self.description.sensor)


def check_method(method: str) -> None:
    """Raises InputError where there is no such method."""
    if method not in METHODS:
        raise UnknownNameError(f"--method {method}: no such method; {nearest(method, METHODS)}", method, METHODS)


@contextmanager
def naming(source: Path | str) -> Iterator[None]:
    """An InputError about the rows of a table names the table."""
    try:
        yield
    except InputError as error:
        raise error if str(source) in str(error) else InputError(f"{source}: {error}") from None
