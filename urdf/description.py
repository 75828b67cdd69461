"""robot.toml -> RobotDescription: typed, validated, every field with its unit in its name or its comment."""

from __future__ import annotations

import copy
import datetime
import difflib
import json
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model, field_validator, model_validator

from kincal.urdf.column_templates import expanded
from kincal.urdf.errors import MOST_SHOWN, InputError, UnknownNameError, quoted, shortened
from kincal.urdf.input_files import MAX_KEY, MAX_TOML, parse_toml, read_text

ROBOTS = Path(__file__).parent / "robots"

_MOST_SAMPLES = 20_000  # of a virtual stream, a pose
_LONG_NAME = 200  # letters: to compare such names takes long
_LONGEST_PATH = 1000  # letters
_SHOWN = 12  # names, of many that are allowed
_LIST, _LISTED_NAME = 200, 30  # letters of a list of names that are allowed, and of a name in a list

_Model = TypeVar("_Model", bound=BaseModel)

Axis = Literal["x", "y", "z"]
Name = Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.\-]{0,63}$")]
Range = Annotated[tuple[float, float], Field(strict=False)]
Vector = Annotated[tuple[float, float, float], Field(strict=False)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
File = Annotated[Path, Field(strict=False)]
Seed = Annotated[int, Field(ge=0, lt=2**32)]
Unit = Literal["m", "mm", "cm", "in", "rad", "deg", "rev", "s", "ms", "us", "ns", "1"]
Layout = Literal["grid", "random", "d_optimal"]
_INTRINSIC = ("XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX", "XYX", "XZX", "YXY", "YZY", "ZXZ", "ZYZ")
EULER_ORDERS = (*_INTRINSIC, *map(str.lower, _INTRINSIC))  # upper case: about the turned axes; lower case: fixed axes
EULER_ANGLES = ("euler_1", "euler_2", "euler_3")  # columns, in the order of the axes

SENSORS: dict[str, tuple[Literal["deg", "mm"], float]] = {  # each channel's unit in [sensor], and its usual sigma
    "orientation": ("deg", 0.0006),  # about each axis
    "position": ("mm", 0.02),  # along each axis
    "tilt": ("deg", 0.01),
    "yaw": ("deg", 0.01),
}
if TYPE_CHECKING:
    Channel = EulerOrder = str
else:
    Channel, EulerOrder = Literal[tuple(SENSORS)], Literal[EULER_ORDERS]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)


class Loop(_Table):
    """Closes the tree: the two frames meet."""

    name: Name
    kind: Literal["point", "frame"]  # point: 3 equations; frame: 6
    frames: Annotated[tuple[str, str], Field(strict=False)]


class Workspace(_Table):
    """Of the tool about its home pose; the axes listed are its degrees of freedom.

    A tool coordinate is a translation along the base frame's axes, or an intrinsic XYZ angle of
    home orientation^T * orientation.
    """

    rotation_deg: dict[Axis, Range] = {}
    translation_mm: dict[Axis, Range] = {}
    max_condition: Annotated[float, Field(gt=1)] = 100.0
    home_mm: Vector | None = None
    home_rotation_deg: Vector | None = None  # intrinsic XYZ

    @field_validator("rotation_deg", "translation_mm")
    @classmethod
    def _ordered(cls, ranges: dict[str, tuple[float, float]]) -> dict[str, tuple[float, float]]:
        for axis, (low, high) in ranges.items():
            if not low < 0 < high:
                raise ValueError(f"{axis} = [{low}, {high}]: allowed is [low, high] with low < 0 < high")
        return dict(sorted(ranges.items()))

    @model_validator(mode="after")
    def _regular(self) -> Workspace:
        for axis, bounds in self.rotation_deg.items():
            limit = 85 if axis == "y" else 175
            if max(map(abs, bounds)) > limit:
                raise ValueError(f"rotation_deg.{axis} = {list(bounds)}: allowed is within +-{limit} (XYZ angles)")
        if not self.rotation_deg and not self.translation_mm:
            raise ValueError("no axis listed: give rotation_deg, translation_mm or both")
        return self


class Tolerance(_Table):
    """One sigma of manufacture: the prior of each kind of parameter."""

    position_mm: Positive = 0.3
    rotation_deg: Positive = 0.03
    actuator_zero_mm: Positive = 0.3  # prismatic actuators
    actuator_zero_deg: Positive = 0.03  # revolute actuators
    actuator_gain: Positive = 1e-3  # relative to the nominal gain


class _Sensor(_Table):
    """One sigma of one reading, where the data has no *_std column: `tilt_deg`, .. by the table SENSORS.

    Where neither says it, identification estimates it from its residuals; a virtual robot's sensor has a common one.
    """

    if TYPE_CHECKING:

        def __init__(self, **sigmas: float | None) -> None: ...

    def stated(self, channel: str) -> float | None:
        """[deg] or [mm], as robot.toml has it."""
        return getattr(self, f"{channel}_{SENSORS[channel][0]}")

    def given(self, channel: str) -> bool:
        return self.stated(channel) is not None

    def sigma(self, channel: str) -> float:
        """[rad] or, of a length, [m]; a first guess where it is not given."""
        value, (unit, usual) = self.stated(channel), SENSORS[channel]
        return (usual if value is None else value) * (1e-3 if unit == "mm" else math.pi / 180)


if TYPE_CHECKING:
    Sensor = _Sensor
else:
    _SIGMAS = {f"{channel}_{unit}": (Positive | None, None) for channel, (unit, _) in SENSORS.items()}
    Sensor = create_model("Sensor", __base__=_Sensor, __module__=__name__, __doc__=_Sensor.__doc__, **_SIGMAS)


class Actuator(_Table):
    """joint value = zero + gain * reading."""

    gain: float = 1.0  # metres (or radians) per unit of the reading
    zero: float = 0.0  # metres (or radians)

    @field_validator("gain")
    @classmethod
    def _not_zero(cls, gain: float) -> float:
        if gain == 0:
            raise ValueError("0: allowed is any other number")
        return gain


class Split(_Table):
    test: Annotated[float, Field(gt=0, lt=1)] = 0.2  # of the measured poses; 1 / test folds for cross-validation
    poses: Annotated[int, Field(ge=1)] | None = None  # how many of the measured poses are used, drawn with the seed


class Plan(_Table):
    poses: Annotated[int, Field(ge=1, le=1_000_000)] = 150
    # grid: uniform, as in the paper; random: scrambled Sobol points; d_optimal: those that tell most of the parameters.
    # Default: grid up to three axes, else random.
    layout: Layout | None = None


class Column(_Table):
    source: str = Field(alias="from")
    unit: Unit = "1"  # 1: as the table's own convention has it (SI, radians, the actuator's unit)


class VirtualErrors(_Table):
    """How the virtual robot differs from its drawing. Switches first, sizes after."""

    geometric: bool = True  # drawn from [tolerance], on every placement and actuator
    elastic: bool = True
    screw: bool = True
    payload_kg: NotNegative = 40.0
    payload_centre_mm: Vector = (20.0, 10.0, 150.0)  # in the tool frame
    stiffness_n_per_m: Positive = 2.5e6  # of a prismatic actuator's leg
    stiffness_nm_per_rad: Positive = 1e6  # of a revolute actuator
    screw_amplitude_mm: NotNegative = 0.008
    screw_period_mm: Positive = 80.0
    screw_quadratic_per_m: float = 3e-4  # times (q - q_home)^2
    gear_amplitude_deg: NotNegative = 0.001  # the same for revolute actuators
    gear_period_deg: Positive = 12.0
    gear_quadratic_per_rad: float = 1e-5
    clearance_mm: NotNegative = 0.0  # whole play of a prismatic actuator; the payload's load pushes it to one end
    clearance_deg: NotNegative = 0.0  # of a revolute actuator
    backlash_mm: NotNegative = 0.0  # whole lost motion; the joint lags by half of it, by direction of approach
    backlash_deg: NotNegative = 0.0
    thermal_growth_mm: NotNegative = 0.0  # from the first to the last measured pose; which way is drawn
    thermal_growth_deg: NotNegative = 0.0
    cross_axis: Annotated[float, Field(gt=-0.5, lt=0.5)] = 0.0  # share of one angle that is read in another
    frame_rotation_deg: NotNegative = 1.0  # size of W's and T's rotation
    frame_translation_mm: NotNegative = 10.0


class Stream(_Table):
    """How a virtual robot's inclinometer and heading reference stream at each pose."""

    rate_hz: Positive = 50.0
    seconds: Positive = 5.0
    outliers: Annotated[float, Field(ge=0, lt=0.5)] = 0.01  # share of the samples
    outlier_deg: NotNegative = 2.0
    dropouts: Annotated[float, Field(ge=0, lt=1)] = 0.02  # share of the samples that never come

    @model_validator(mode="after")
    def _samples(self) -> Stream:
        if self.rate_hz * self.seconds > _MOST_SAMPLES:
            raise ValueError(f"{self.rate_hz * self.seconds:.3g} samples a pose; allowed are {_MOST_SAMPLES}")
        return self


class Log(_Table):
    """How a sensor's log is read, and how its still stretches become poses where a command log says what was asked."""

    format: Literal["csv", "parquet", "nmea", "bag"] | None = None  # default: told by the file
    topic: str | None = None  # of a bag; of NMEA the sentence: PSXN, PASHR, PRDID or XDR. Default: the only fitting one
    orientation: bool | None = None  # of an Imu: false: tilt by its accelerometer; default: where it is never set
    rate_hz: Positive | None = None  # of an NMEA log without any time
    offset_seconds: float | None = None  # the log's clock minus the command log's; default: estimated
    settle_seconds: NotNegative = 1.0  # cut from the start of a still stretch
    min_seconds: Positive = 2.0  # what must be left of it
    max_seconds: Positive = 20.0  # what is used of it


class Measure(_Table):
    source: Literal["virtual", "files"] | None = None  # default: files where a table is named
    table: File | None = None  # static poses; with `streams`, the joint values of each pose alone
    streams: File | None = None  # raw sensor streams, for the filter
    commands: File | None = None  # t and joint values as commanded, in place of `table`: poses are found in `streams`
    log: Log = Log()  # how `streams` is read
    joints: File | None = None  # the joint values of each pose, where `table` has none
    body: Annotated[str, Field(min_length=1, max_length=200)] | None = None  # rigid body or marker of an export
    columns: dict[str, Column] = {}
    skip: Annotated[tuple[int, ...], Field(strict=False)] = ()  # numbers of poses that are left out
    # orientations in another notation than qx, qy, qz, qw or rx, ry, rz of intrinsic XYZ
    euler: EulerOrder | None = None  # of euler_1, euler_2, euler_3, or of rx, ry, rz, each about its axis
    rotation_vector: bool = False  # rx, ry, rz are one
    # how a text table is written; what is not set is recognised
    separator: Annotated[str, Field(min_length=1, max_length=1)] | None = None
    decimal: Literal[".", ","] | None = None
    encoding: Annotated[str, Field(min_length=1, max_length=40)] | None = None
    header_row: Annotated[int, Field(ge=1, le=200)] | None = None  # the line that names the columns, from 1
    comment: Annotated[str, Field(min_length=1, max_length=1)] | None = None  # begins a line that is no data
    channels: tuple[Channel, ...] | None = Field(default=None, strict=False)  # virtual; default: all that can move
    seed: Seed | None = None  # virtual: of this unit's errors and its noise; default: the seed at the top
    stream: Stream | None = None  # virtual: tilt and yaw come as streams; without it, as one reading a pose
    errors: VirtualErrors = VirtualErrors()

    @model_validator(mode="before")
    @classmethod
    def _template(cls, content: Any) -> Any:
        return expanded(content) if isinstance(content, Mapping) else content

    @field_validator("columns", mode="before")
    @classmethod
    def _short_form(cls, columns: Any) -> Any:
        if isinstance(columns, Mapping):
            return {k: {"from": v} if isinstance(v, str) else v for k, v in columns.items()}
        return columns

    @field_validator("euler", mode="before")
    @classmethod
    def _order(cls, order: Any) -> Any:
        if order is not None and order not in EULER_ORDERS:
            intrinsic = ", ".join(_INTRINSIC)
            raise ValueError(
                f"found {shortened(order)}; allowed are {intrinsic} (about the turned axes), and the same in lower "
                "case (about fixed axes)"
            )
        return order

    @model_validator(mode="after")
    def _one_notation(self) -> Measure:
        if self.euler is not None and self.rotation_vector:
            raise ValueError(f'euler = "{self.euler}" and rotation_vector = true: set only one of them')
        mapped = [name for name in EULER_ANGLES if name in self.columns]
        if mapped and self.euler is None:
            raise ValueError(f'columns.{mapped[0]} needs the order of the axes: set measure.euler, such as "ZYX"')
        twice = [name for name in ("rx", "ry", "rz") if name in self.columns]
        if mapped and twice:
            raise ValueError(f"columns: {mapped[0]} and {twice[0]} both give the orientation; name only one of them")
        return self

    @model_validator(mode="after")
    def _consistent(self) -> Measure:
        if self.commands is not None and self.table is not None:
            raise ValueError("commands and table both give the joint values; set only one of them")
        if self.commands is not None and self.streams is None:
            raise ValueError("commands need the stream that was logged beside them: set measure.streams")
        measured = next((key for key in ("table", "commands") if getattr(self, key) is not None), None)
        if self.source == "virtual" and measured is not None:
            raise ValueError(
                f'source = "virtual" and {measured} = "{shortened(getattr(self, measured).name)}": a virtual robot '
                f"simulates its measurements. Delete source to use yours, or delete {measured} to simulate"
            )
        if self.source == "files" and self.table is None and self.commands is None:
            raise ValueError('source = "files" needs a table: set measure.table to a CSV or Parquet file')
        if self.streams is not None and self.table is None and self.commands is None:
            raise ValueError(
                "streams need a table with each pose's joint values, or a command log: "
                "set measure.table or measure.commands"
            )
        if self.joints is not None and (self.table is None or self.streams is not None):
            raise ValueError("joints go with a table of measured poses: set measure.table, without measure.streams")
        if self.channels is not None and not self.channels:
            raise ValueError(f"channels = []: allowed are one or more of {', '.join(SENSORS)}")
        if self.channels and "orientation" in self.channels and {"tilt", "yaw"} & set(self.channels):
            raise ValueError("channels: orientation includes tilt and yaw; list only one of them")
        return self

    def of_columns(self, names: Iterable[str]) -> Measure:
        """These settings with the column map of `names` alone."""
        return self.model_copy(update={"columns": {k: v for k, v in self.columns.items() if k in set(names)}})

    def of_other_table(self) -> Measure:
        """These settings for a table that is not `table`: its poses have other numbers."""
        return self.model_copy(update={"skip": ()})

    @property
    def virtual(self) -> bool:
        return self.source == "virtual" or (self.source is None and self.table is None and self.commands is None)


class Filter(_Table):
    """The extended Kalman filter over one pose's stretch of a stream."""

    gate_probability: Annotated[float, Field(gt=0, lt=0.1)] = 1e-4  # of a good sample to be taken for an outlier
    window: Annotated[int, Field(ge=3)] = 25  # samples whose median says what an outlier is at the start
    drift_deg_per_sqrt_s: NotNegative = 1e-5
    min_samples: Annotated[int, Field(ge=3)] = 5  # good ones a pose


class Identify(_Table):
    """How the parameters are estimated."""

    estimator: Literal["map", "least_squares", "ridge", "liu", "truncated_svd"] = "map"
    loss: Literal["gaussian", "huber", "cauchy"] = "gaussian"
    # the scale of the priors (map), ridge's k, Liu's d, how many directions truncated_svd keeps: a number, or how it
    # is chosen. Default: 1 for map, generalised cross-validation for the others
    shrinkage: NotNegative | Literal["gcv", "kfold"] | None = None
    max_iterations: Annotated[int, Field(ge=1, le=10_000)] = 1000
    reject_outliers: bool = True  # leave out poses that do not fit the others, at most a third of them; they are named

    @model_validator(mode="after")
    def _scale(self) -> Identify:
        value = self.shrinkage
        if self.estimator == "map" and value == 0:
            raise ValueError("shrinkage = 0: the scale of map's priors must be greater than 0")
        if self.estimator == "liu" and isinstance(value, float | int) and value > 1:
            raise ValueError(f"shrinkage = {value:g}: Liu's d must be 1 (least squares) or less")
        return self


class Prior(_Table):
    poses: Annotated[int, Field(ge=8, le=100_000)] = 1331  # of the source task: the paper's 11 x 11 x 11


class Pretrain(_Table):
    hidden: Annotated[int, Field(ge=1, le=64)] = 16  # units in each of the two hidden layers
    iterations: Annotated[int, Field(ge=1, le=5000)] = 60  # of Levenberg-Marquardt
    continued: Annotated[int, Field(ge=1, le=5000)] = 5  # more of them on the identified model's poses
    validation: Annotated[float, Field(ge=0, lt=0.5)] = 0.1


class Transfer(_Table):
    iterations: Annotated[int, Field(ge=1, le=5000)] = 200
    validation: Annotated[float, Field(ge=0, lt=0.5)] = 0.15


class Siblings(_Table):
    """Virtual siblings of the robot, whose residuals its own network inherits the shape of."""

    count: Annotated[int, Field(ge=1, le=1000)] = 64
    poses: Annotated[int, Field(ge=8, le=10_000)] = 600
    hidden: Annotated[int, Field(ge=1, le=64)] = 24  # units in each of the two hidden layers
    iterations: Annotated[int, Field(ge=1, le=100_000)] = 3000  # of Adam
    seed: Seed = 0  # of its own: robots of one design share their siblings


class Correct(_Table):
    """The residual network of the actuators."""

    own_units: Annotated[int, Field(ge=1, le=100)] = 10  # radial units of each joint
    shared_units: Annotated[int, Field(ge=1, le=500)] = 24  # units from all joints to all


class Evaluate(_Table):
    closed_loop: bool = True  # of a virtual robot: also where it is after compensation
    fresh_poses: Annotated[int, Field(ge=500, le=100_000)] = 500  # random poses of a virtual robot, noise-free


class Mechanism(_Table):
    """What the URDF does not say: frames, actuators, loops and the workspace."""

    base_frame: str
    tool_frame: str
    actuated: Annotated[tuple[str, ...], Field(strict=False, min_length=1)]
    workspace: Workspace
    loop: Annotated[tuple[Loop, ...], Field(strict=False)] = ()

    @model_validator(mode="after")
    def _names(self) -> Mechanism:
        for table, names in (("actuated", self.actuated), ("loop", [loop.name for loop in self.loop])):
            repeated = {n for n in names if list(names).count(n) > 1}
            if repeated:
                raise ValueError(f"{table}: {quoted(sorted(repeated)[0])} appears twice")
        return self


class Instruments(_Table):
    """What D-optimal poses rest on beside the mechanism: what is measured how well, and what is known before."""

    channels: tuple[Channel, ...] | None  # None: all that can move
    sensor: Sensor
    stream: Stream | None
    tolerance: Tolerance


class Limits(_Table):
    """Errors that the recommended method may have at held-out poses, the instruments' noise included."""

    mean_mm: Positive | None = None
    max_mm: Positive | None = None
    mean_deg: Positive | None = None
    max_deg: Positive | None = None

    @property
    def given(self) -> dict[str, float]:
        """{name: limit} of those that are set."""
        return {name: value for name, value in self if value is not None}


class Record(_Table):
    """Whose calibration this is: printed on top of the report, nothing depends on it."""

    serial: str = ""  # of the unit
    operator: str = ""
    date: datetime.date | None = None  # of the measurements


class RobotDescription(Mechanism):
    name: Name
    urdf: File
    measure: Measure
    seed: Seed = 0
    tolerance: Tolerance = Tolerance()
    sensor: Sensor = Sensor()
    split: Split = Split()
    actuator: dict[str, Actuator] = {}
    plan: Plan = Plan()
    filter: Filter = Filter()
    identify: Identify = Identify()
    prior: Prior = Prior()
    pretrain: Pretrain = Pretrain()
    transfer: Transfer = Transfer()
    siblings: Siblings = Siblings()
    correct: Correct = Correct()
    evaluate: Evaluate = Evaluate()
    limits: Limits = Limits()
    record: Record = Record()

    @model_validator(mode="after")
    def _actuators(self) -> RobotDescription:
        for joint in self.actuator:
            if joint not in self.actuated:
                unknown = f"actuator.{shortened(joint, _LISTED_NAME)}: no actuated joint"
                raise ValueError(f"{unknown}; {nearest(joint, self.actuated)}")
        return self

    @property
    def instruments(self) -> Instruments | None:
        """None where the layout of the plan does not depend on them."""
        return self.planned_instruments if self.plan.layout == "d_optimal" else None

    @property
    def planned_instruments(self) -> Instruments:
        measure = self.measure
        return Instruments(
            channels=measure.channels, sensor=self.sensor, stream=measure.stream, tolerance=self.tolerance
        )

    @property
    def mechanism(self) -> Mechanism:
        return Mechanism(**{name: getattr(self, name) for name in Mechanism.model_fields})


@dataclass(frozen=True)
class Robot:
    """A description and the file it came from."""

    file: Path
    description: RobotDescription
    fleet: Path | None = None  # the fleet file that makes it a unit of this design
    reference: str = ""  # what opens it again from any folder: a path to its robot.toml, or FLEET.toml:UNIT
    overrides: tuple[str, ...] = ()  # with these settings, as of --set

    def __repr__(self) -> str:
        settings = "".join(f", {text}" for text in self.overrides)
        return f"Robot({self.description.name!r}, {self.reference or self.file}{settings})"

    @property
    def stands_in(self) -> Path:
        """The file whose removal takes this robot away."""
        return (self.fleet or self.file).resolve()


@dataclass(frozen=True)
class Setting:
    """One value that goes over robot.toml's."""

    keys: tuple[str, ...]
    value: Any
    said: str  # where the user said it


# Fields that hold a path: relative to robot.toml there, to the current folder in --set.
PATHS = (("urdf",), *(("measure", key) for key in ("table", "joints", "streams", "commands")))


_DRAWINGS = (".urdf", ".xml", ".mjcf", ".xacro", ".sdf")
_MEASURED, _SOURCE = (("measure", "table"), ("measure", "commands")), ("measure", "source")


def load_robot(robot: str, overrides: Sequence[str] = ()) -> Robot:
    """Read a robot by name (a folder under urdf/robots) or by the path to its robot.toml or folder.

    overrides: `table.key=value`, each value in TOML syntax (a bare word is a string).
    Raises InputError, naming the file, the field, what was found and what is allowed.
    """
    file = find_robot(robot)
    return Robot(file, described(file, map(parse_override, overrides)))


def described(file: Path, settings: Iterable[Setting]) -> RobotDescription:
    """A robot.toml with settings over it. Raises InputError, as load_robot does."""
    content = read_toml(file)
    _resolve_paths(content, file)
    origin: dict[tuple[str, ...], str] = {}
    settings = tuple(settings)
    _one_source(content, settings)
    for setting in settings:
        _put(content, setting)
        origin[setting.keys] = setting.said
    return validate(RobotDescription, content, str(file), origin)


def _one_source(content: dict[str, Any], settings: tuple[Setting, ...]) -> None:
    """A setting that names measurements, or a virtual robot, goes over what robot.toml says of the other."""
    keys, measure = {setting.keys for setting in settings}, content.get("measure")
    if not isinstance(measure, dict):
        return
    if keys & set(_MEASURED) and _SOURCE not in keys:
        measure.pop("source", None)
    elif any(setting.keys == _SOURCE and setting.value == "virtual" for setting in settings):
        for _, key in (*_MEASURED, ("measure", "streams"), ("measure", "joints")):
            measure.pop(key, None)


def read_columns(file: Path) -> dict[str, Column]:
    """A column map from a TOML file of its own, as [measure.columns] has it."""
    content = read_toml(file)
    measure = content.get("measure")
    content = measure if isinstance(measure, dict) else content
    return validate(Measure, {"table": "-", "columns": content.get("columns", content)}, str(file)).columns


def validate(
    model: type[_Model], content: Mapping[str, Any], where: str, origin: Mapping[tuple[str, ...], str] | None = None
) -> _Model:
    """`content` as a `model`; the first error as one InputError that names `where` and the field."""
    try:
        return model.model_validate(dict(content))
    except ValidationError as error:
        # An unknown key explains a missing one (a misspelling): it comes first.
        first = min(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
        loc = tuple(str(part) for part in first["loc"])
        for keys, text in (origin or {}).items():
            shared = min(len(loc), len(keys)) if first["type"] == "extra_forbidden" else len(keys)
            if shared and loc[:shared] == keys[:shared]:
                where = text
            elif first["type"] == "value_error" and loc == keys[: len(loc)]:  # of the whole table
                where = f"{where} with {text}"
        field = ".".join(shortened(part, _LISTED_NAME) for part in loc)
        raise InputError(f"{where}: {field + ': ' if field else ''}{_explain(first, model)}") from None


def _explain(error: Any, model: type[BaseModel]) -> str:
    if error["type"] == "extra_forbidden":
        keys = _legal_keys(model, error["loc"][:-1])
        return f"unknown key; {nearest(str(error['loc'][-1]), keys)}"
    if error["type"] == "missing":
        return "required, but missing"
    message = error["msg"].removeprefix("Value error, ")
    if error["type"] == "value_error":
        return message
    return f"found {quoted(error['input'])}; {message[0].lower()}{message[1:]}"


def _legal_keys(model: Any, loc: Iterable[Any]) -> list[str]:
    """The keys of the table at `loc`, found by walking the model's annotations."""
    for part in loc:
        fields = getattr(model, "model_fields", {})
        annotation = fields[part].annotation if part in fields else model
        model = next((t for t in _walk(annotation) if isinstance(t, type) and issubclass(t, BaseModel)), model)
    return [f.alias or name for name, f in model.model_fields.items()]


def _walk(annotation: Any) -> Iterable[Any]:
    yield annotation
    for argument in get_args(annotation):
        yield from _walk(argument)


def nearest(name: str, legal: Iterable[str]) -> str:
    """What to say of a name that does not exist: the nearest one, or all that do."""
    legal = list(legal)
    likely = [other for other in legal if len(other) < _LONG_NAME] if len(name) < _LONG_NAME else []
    close = difflib.get_close_matches(name, likely, n=1, cutoff=0.5)
    return f"did you mean {quoted(close[0])}?" if close else f"allowed: {listed(legal, _LIST)}"


def listed(names: Iterable[Any], letters: int = MOST_SHOWN) -> str:
    """The first of them, at least one and about `letters` in all; whoever reads it wants no page."""
    shown: list[str] = []
    for name in islice(names, _SHOWN + 1):
        shown.append(shortened(name, _LISTED_NAME))
        if len(shown) > _SHOWN or (len(shown) > 1 and len(", ".join(shown)) > letters):
            return ", ".join([*shown[:-1], "..."])
    return ", ".join(shown)


def find_robot(robot: str) -> Path:
    """The robot.toml of a shipped robot's name, or of a path. Raises InputError."""
    path = Path(robot)
    if os.path.isfile(path / "robot.toml"):  # unlike Path.is_file, quiet where a folder may not be looked into
        return (path / "robot.toml").absolute()
    if os.path.isfile(path):
        if path.suffix in _DRAWINGS:
            raise InputError(f"{robot}: a drawing, not a robot.toml. Run `kincal init {robot}` first: it proposes one")
        return path.absolute()
    shipped = ROBOTS / robot / "robot.toml"
    if "/" not in robot and os.path.isfile(shipped):
        return shipped
    names = sorted(p.parent.name for p in ROBOTS.glob("*/robot.toml"))
    raise UnknownNameError(
        f"robot {robot!r}: neither a file nor a shipped robot; {nearest(robot, names)}", robot, names
    )


def read_toml(file: Path) -> dict[str, Any]:
    """Raises InputError."""
    return toml_of(toml_text(file), str(file))


def toml_text(file: Path) -> str:
    """Raises InputError."""
    return read_text(file, MAX_TOML)


def toml_of(text: str, where: str) -> dict[str, Any]:
    """Raises InputError."""
    try:
        return copy.deepcopy(_parsed(text))
    except ValueError as error:  # also an integer of thousands of digits
        raise InputError(f"{where}: not valid TOML: {error}") from None
    except RecursionError:  # not too deep to parse, but to copy
        raise InputError(f"{where}: not valid TOML: nested too deeply") from None


@lru_cache(maxsize=8)
def _parsed(text: str) -> dict[str, Any]:
    """The units of a fleet share their drawing."""
    return parse_toml(text)


def _resolve_paths(content: dict[str, Any], file: Path) -> None:
    for *tables, key in PATHS:
        table: Any = content
        for name in tables:
            table = table.get(name) if isinstance(table, dict) else None
        if isinstance(table, dict) and isinstance(table.get(key), str):
            if len(table[key]) > _LONGEST_PATH:
                name, allowed = ".".join((*tables, key)), f"a path of {_LONGEST_PATH} letters or fewer"
                raise InputError(f"{file}: {name}: found {quoted(table[key])}; allowed is {allowed}")
            table[key] = str(file.parent / table[key])


def parse_override(text: str) -> Setting:
    """--set table.key=value; paths are relative to the current folder. Raises InputError."""
    key, equals, written = text.partition("=")
    if not equals or not key.strip():
        raise InputError(f"--set {text}: allowed is table.key=value")
    keys = tuple(part.strip() for part in key.split("."))
    if not text.isascii() and any(0xD800 <= ord(c) < 0xE000 for c in text):
        raise InputError(f"--set {text}: not UTF-8 text")
    if len(keys) > MAX_KEY:
        raise InputError(f"--set {text}: a key of {len(keys)} parts; allowed are {MAX_KEY}")
    try:
        value = parse_toml(f"value = {written}")["value"]
    except ValueError:  # a bare word, or what no field allows
        value = written.strip()
    return Setting(keys, relative_to(Path.cwd(), keys, value), f"--set {text}")


def as_absolute(text: str) -> str:
    """The same override for a process in another folder."""
    setting = parse_override(text)
    return f"{'.'.join(setting.keys)}={json.dumps(setting.value)}" if setting.keys in PATHS else text


def relative_to(folder: Path, keys: tuple[str, ...], value: Any) -> Any:
    """A setting's value; where it is a path, below this folder."""
    return str(folder / value) if keys in PATHS and isinstance(value, str) else value


def _put(content: dict[str, Any], setting: Setting) -> None:
    for key in setting.keys[:-1]:
        content = content.setdefault(key, {})
        if not isinstance(content, dict):
            raise InputError(f"{setting.said}: {key} is not a table")
    content[setting.keys[-1]] = setting.value
