"""What the stages hand on: immutable values with named fields."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from kincal.identification.identification import Identification
from kincal.identification.innovations import StaticInnovations
from kincal.identification.streams.campaign import Campaign, DroppedPose
from kincal.pipeline.store.codec import Frame, Text
from kincal.urdf.description import Mechanism, VirtualErrors

if TYPE_CHECKING:
    from kincal.urdf.closed_chain import ClosedChain


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
        from kincal.urdf.closed_chain import load_chain
        from kincal.urdf.rigid_motion import Motion

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
    growth_sign: np.ndarray  # (n_actuated,) -1 or 1: whether it lengthens or shortens in the warmth
    errors: VirtualErrors


VIRTUAL = "VIRTUAL ROBOT: simulated errors, not a calibration of a real robot"  # in every file made of one


@dataclass(frozen=True)
class Measured:
    """The measurement table, the raw streams beside it, and the truth behind both where the robot is virtual."""

    source: str  # "virtual", or the name of the file
    table: Frame
    stream: Frame | None
    truth: Truth | None
    campaign: Campaign | None = None  # where the stream was read from a file
    notes: tuple[str, ...] = ()  # on the table: what was not used

    @property
    def warnings(self) -> tuple[str, ...]:
        """For people, a sentence each."""
        return (*self.notes, *(() if self.campaign is None else self.campaign.warnings))


@dataclass(frozen=True)
class Filtered:
    """The measurement table, one row a pose, after the streams went through the filter."""

    table: Frame
    used: int  # samples of the streams; 0 where there were none
    gated: int  # samples taken for outliers
    dropped: tuple[DroppedPose, ...] = ()  # poses that the streams don't tell
    innovations: tuple[StaticInnovations, ...] = ()
    yaw_stuck: int | None = None  # poses whose yaw never changes, where that channel was left out

    @property
    def findings(self) -> tuple[str, ...]:
        doubts = tuple(i.warning for i in self.innovations if i.warning)
        if self.yaw_stuck is None:
            return doubts
        return (f"channel 'yaw' is left out: it never changes in {self.yaw_stuck} poses", *doubts)

    @property
    def warnings(self) -> tuple[str, ...]:
        return (*self.findings, *map(str, self.dropped))


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
    left_out: tuple[int, ...] = ()  # measured poses that do not fit the others; no fit has seen them

    def fits(self) -> tuple[Fit, ...]:
        """All fits, the shipped one first: it has seen every pose."""
        shipped = Fit(np.zeros(0, dtype=np.int64), self.registered, self.shipped.change)
        return (shipped, self.held_out, *self.folds)


@dataclass(frozen=True)
class Bundle:
    """Results and settings that belong together, as one argument of a stage function, by the names of its fields."""


RAW = "nominal, raw"  # the row of the nominal robot with W = T = 1


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
class Advice:
    """Which method to take, what to expect of it, and whether more poses would pay."""

    method: str
    expected_deg: float | None  # mean error of a pose that was not measured, the instruments' noise apart
    expected_mm: float | None
    n_poses: int
    n_more: int | None  # poses in all that would pay; None: more don't
    expected_more_deg: float | None  # with them
    expected_more_mm: float | None
    text: str


@dataclass(frozen=True)
class Compensated:
    """The closed loop on a virtual robot: desired poses, and where it ends up when it is commanded to reach them."""

    n_poses: int
    reached: dict[str, int]  # poses that each method has a command for, within limits
    scores: tuple[MethodScore, ...]  # of these, against the desired ones; empty for a real robot


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
    n_held_out: int
    raw_nominal: MethodScore  # the nominal robot with W = T = 1
    closed_loop: tuple[MethodScore, ...]  # after compensation: reached against desired poses (virtual robots)
    not_reached: dict[str, int]  # poses that a method had no command for
    advice: Advice | None = None  # of `run` and `compare`

    @property
    def helps_nowhere(self) -> bool:
        """Whether the drawing is as good as each of the methods."""
        nominal, *others = self.methods
        errors = {key: getattr(nominal, key) for key in ("mean_deg", "mean_mm")}
        return all(
            getattr(score, key) >= error for key, error in errors.items() if error is not None for score in others
        )


@dataclass(frozen=True)
class Report:
    html: Html
