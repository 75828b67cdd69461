"""What the stages hand on: immutable values with named fields."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from identification.identification import Identification
from urdf.description import Mechanism, VirtualErrors

if TYPE_CHECKING:
    from pandas import DataFrame as Frame

    from urdf.closed_chain import ClosedChain
else:

    class Frame:
        """Stands for pandas.DataFrame, whose import takes half a second, until a table is read."""


class Text(str):
    """A text that is stored as a file of its own."""

    file = "text.txt"


class Html(Text):
    file = "report.html"


class Urdf(Text):
    file = "robot.urdf"


@dataclass(frozen=True)
class Model:
    """The robot as drawn: checked, and with its home configuration found."""

    mechanism: Mechanism
    urdf: Urdf
    home: np.ndarray  # (n_joints,)
    home_pose: np.ndarray  # (6,) translation [m] and rotation vector [rad] of the tool at home
    joints: tuple[str, ...]
    mobility: int
    worst_condition: float
    worst_pose: str
    n_checked: int

    def chain(self) -> ClosedChain:
        from urdf.closed_chain import load_chain
        from urdf.rigid_motion import Motion

        chain = load_chain(self.mechanism, self.urdf, Path("robot.urdf"))
        return replace(chain, home=self.home, home_pose=Motion.from_vector(self.home_pose))


@dataclass(frozen=True)
class PosePlan:
    """Which poses to measure: one row a pose, tool coordinates [m, rad] and the actuators' readings."""

    table: Frame


@dataclass(frozen=True)
class Truth:
    """What a virtual robot really is."""

    p: np.ndarray  # (n_parameters,) true changes from nominal, W and T included
    phase: np.ndarray  # (n_actuated,) of its screw or gear errors [rad]
    errors: VirtualErrors


@dataclass(frozen=True)
class Measured:
    """The measurement table, and the truth behind it where the robot is virtual."""

    source: str  # "virtual", or the name of the file
    table: Frame
    truth: Truth | None


@dataclass(frozen=True)
class Fit:
    """Parameter changes fitted on some of the measured poses, to be scored on the others."""

    test: np.ndarray  # (k,) rows of the table that the fit has not seen
    registered: np.ndarray  # (n_parameters,) W and T alone
    identified: np.ndarray  # (n_parameters,) all


@dataclass(frozen=True)
class Identified:
    """The robot as built."""

    shipped: Identification  # from all measured poses: the method that predicts, compensates and is evaluated
    registered: np.ndarray  # (n_parameters,) W and T alone, from all measured poses
    held_out: Fit
    folds: tuple[Fit, ...]  # of real data; a virtual robot is scored on fresh poses instead


@dataclass(frozen=True)
class MethodScore:
    name: str
    mean_deg: float | None
    max_deg: float | None
    sd_deg: float | None
    axis_mean_deg: dict[str, float | None]
    mean_mm: float | None
    max_mm: float | None
    sd_mm: float | None


@dataclass(frozen=True)
class Comparison:
    """The methods on the same poses that none of them has seen."""

    robot: str
    source: str
    n_poses: int  # measured
    n_scored: int
    scored_on: str  # fresh, held_out, or the file of `evaluate`
    channels: tuple[str, ...]
    methods: tuple[MethodScore, ...]
    held_out: tuple[MethodScore, ...]
    raw_nominal: MethodScore  # the nominal robot with W = T = 1


@dataclass(frozen=True)
class Report:
    html: Html
