"""The sea trial: the platform on a moving ship keeps its deck level, by each of the methods (Xu et al., section 4).

The ship's inertial sensors go through the attitude filter; the required attitude is what levels the deck, some time
ahead where delay and lag are known; each method turns it into commands; the actuators follow; the virtual robot as
built moves, under the load of a moving ship. The platform was calibrated on the ship standing still: the measurement
frame is the ship's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import Field

from kincal.identification.accuracy import gravity_error, orientation_error
from kincal.identification.attitude.filter import filter_attitude
from kincal.identification.attitude.presets import SensorPreset, preset
from kincal.identification.attitude.settings import AttitudeSettings, InnovationStatistics
from kincal.identification.attitude.smoother import smooth_attitude
from kincal.identification.channels import all_turns, parts
from kincal.pipeline.compensator.commands import Attempt, attempt
from kincal.pipeline.compensator.solvers import Solvers
from kincal.pipeline.methods.predictors import Method
from kincal.pipeline.results import RAW
from kincal.pipeline.sea.control import ahead, followed, kept, lag, late, levelling
from kincal.pipeline.sea.instruments import sensed
from kincal.pipeline.sea.settings import Table
from kincal.pipeline.sea.ship_motion import ShipMotion
from kincal.pipeline.virtual.errors import Circumstances
from kincal.pipeline.virtual.robot import STANDING, VirtualRobot
from kincal.pipeline.watch import advanced
from kincal.urdf.description import Positive, RobotDescription
from kincal.urdf.errors import InputError
from kincal.urdf.rigid_motion import Motion, exp, log, zyx_angles

if TYPE_CHECKING:
    from kincal.identification.error_model import ErrorModel

START_S = 120.0  # before the trial: the filter starts cold
_AT_ONCE = 20_000  # samples: memory
_OFTEN_HZ = 10.0  # at which the parts of the error are taken apart
_PAYS = 2000  # samples, for which compilation takes less time than it saves
_LEAST_REACHED = 0.5  # of the samples
_NORMAL = 3  # corrections of a deck's normal, where its heading follows the robot; each gains two digits


class Trial(Table):
    """How the platform is controlled."""

    sensor: str = "mru"  # of the ship
    deck_sensor: str = "precision"  # of the second one, which watches
    delay_ms: Annotated[float, Field(ge=0, le=1000)] = 20.0  # from the sensor to the actuators
    bandwidth_hz: Positive = 10.0  # of the actuators
    lead: bool = True  # the controller looks ahead by delay and lag, at the gyros' rates
    lever_m: Annotated[tuple[float, float, float], Field(strict=False)] = (0.0, 0.0, 6.0)  # of the platform
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0  # of the sensors


@dataclass(frozen=True)
class Sailed:
    """One method's trial, at m samples."""

    name: str
    error: np.ndarray  # (m, 3) of the deck against level, about its own axes [rad]
    calibration: np.ndarray  # (c, 3) the same with perfect sensors and actuators, in port; NaN without a command
    not_reached: int  # samples of m without a command: the last one stood


@dataclass(frozen=True)
class Watched:
    """What an inclinometer on the deck says, its record smoothed afterwards, and what it should."""

    name: str
    angles: np.ndarray  # (m, 2) roll, pitch by its filter [rad]
    actual: np.ndarray  # (m, 2)


@dataclass(frozen=True)
class SeaTrial:
    robot: str
    settings: Trial
    full: bool  # the heading is scored, too; else tilt alone
    rate_hz: float
    t: np.ndarray  # (m,) [s] from the trial's beginning
    ship: np.ndarray  # (m, 3) roll, pitch, yaw of the ship [rad]
    filtered: np.ndarray  # (m, 2) roll, pitch by the filter, at the same time [rad]
    innovations: tuple[InnovationStatistics, ...]  # of that filter, from the cold start on
    methods: tuple[Sailed, ...]
    parts: Mapping[str, np.ndarray]  # {part of the error: (c, 3) [rad]}, each alone; calibration: see `methods`
    watched: tuple[Watched, ...]


@dataclass(frozen=True)
class Platform:
    """The robot as drawn and as built, and who commands it."""

    description: RobotDescription
    model: ErrorModel
    actual: VirtualRobot
    methods: Mapping[str, Method]  # the raw nominal robot first
    channels: tuple[str, ...]

    @property
    def turns(self) -> bool:
        """Whether the tool can turn every way."""
        return {3, 4, 5} <= set(self.model.chain.tool_axes)

    @property
    def full(self) -> bool:
        """Whether the heading is measured, and the deck can keep it."""
        return self.turns and all_turns(self.channels)

    def check(self) -> None:
        """Raises InputError for a robot that can't level a deck, or whose calibration says nothing of it."""
        name, chain = self.description.name, self.model.chain
        if not {3, 4} <= set(chain.tool_axes):
            raise InputError(
                f"{name}: its tool can't turn about x and y: [workspace] rotation_deg has not both of them"
            )
        if "tilt" not in parts(self.channels):
            measured = ", ".join(self.channels)
            raise InputError(
                f"{name}: measured are {measured}; a sea trial needs tilt or orientation to have been measured"
            )

    @cached_property
    def solvers(self) -> Solvers:
        """Of the methods."""
        return Solvers(self.description.workspace)

    @cached_property
    def home(self) -> Motion:
        """Of the deck (1,), as the identified model has it."""
        readings = self.model.actuators.readings(self.model.chain.home[None, self.model.chain.actuated])
        return self.methods["geometric"].predict(readings)

    def level_yaw(self) -> float:
        """Of the deck at home [rad]."""
        return float(zyx_angles(self.home.rotation)[0, 0])

    def commands(self, method: Method, rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Readings (n, n_actuated) for orientations (n, 3, 3), and which have any; else the last one stands.

        Of a tool with two axes to turn about, the deck's normal is what is asked for: its heading follows the robot.
        """
        parts = []
        for first in range(0, len(rotation), _AT_ONCE):
            wanted = rotation[first : first + _AT_ONCE]
            tried = self._attempt(method, wanted)
            for _ in range(0 if self.turns else _NORMAL):
                predicted = method.predict(tried.readings).rotation
                tried = self._attempt(method, _upright(predicted, wanted))
            parts.append((tried.readings, tried.good(self.model.chain, self.description.workspace)))
        readings, good = (np.concatenate(part) for part in zip(*parts, strict=True))
        if good.mean() < _LEAST_REACHED:
            raise InputError(
                f"{self.description.name}: {len(good) - good.sum()} of {len(good)} required attitudes are outside of "
                "its workspace; allowed is less than half: a calmer sea, or another platform"
            )
        last = np.maximum.accumulate(np.where(good, np.arange(len(good)), -1))
        return readings[np.where(last < 0, int(np.argmax(good)), last)], good

    def poses(self, readings: np.ndarray, force: np.ndarray) -> np.ndarray:
        """(n, 3, 3) true orientations on board, under a specific force (3,) or (n, 3) [m/s2] in the ship's axes."""
        poses, all_rows = [], self.actual.after_campaign(readings)
        force = np.broadcast_to(force, (len(readings), 3))
        for first in range(0, len(readings), _AT_ONCE):
            rows = slice(first, first + _AT_ONCE)
            now = Circumstances(all_rows.approach[rows], all_rows.warmth[rows])
            poses.append(self.actual.pose(readings[rows], now, force[rows]).rotation)
        return np.concatenate(poses)

    def _attempt(self, method: Method, rotation: np.ndarray) -> Attempt:
        desired = Motion(rotation, np.broadcast_to(self.home.translation, (len(rotation), 3)))
        solver = self.solvers.of(method, self.channels, compiled=len(rotation) >= _PAYS)
        return attempt(solver, desired, self.model.chain, self.model.actuators)


def _upright(rotation: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Orientations (n, 3, 3), by the smallest turn that brings their z axes to those of `wanted` (n, 3, 3)."""
    return exp(gravity_error(wanted.swapaxes(1, 2), rotation.swapaxes(1, 2))) @ rotation


def sea_trial(platform: Platform, motion: ShipMotion, rate_hz: float, settings: Trial) -> SeaTrial:
    """Sail. motion: at rate_hz, the first START_S of it for the filter alone. Raises InputError."""
    platform.check()
    ship, watch = preset(settings.sensor), preset(settings.deck_sensor)
    begin = round(START_S * rate_hz)
    if len(motion) < begin + rate_hz:
        raise InputError(
            f"{len(motion) / rate_hz:.4g} s of motion: the filter needs {START_S:g} s to begin with; allowed is more"
        )
    here = motion.specific_force(settings.lever_m)
    seen = sensed(here, motion.angular_rate, rate_hz, ship, [settings.seed, 30]).samples
    estimate = filter_attitude(motion.t, seen, AttitudeSettings(sensor=ship), "the ship's sensor")
    rates = seen.gyro - estimate.gyro_bias
    control = _Control.of(settings, rate_hz)
    at, yaw = slice(begin, None), platform.level_yaw()
    sea = _Sea(levelling(motion.angles[at], yaw), here[at], platform.full)
    asked = control.asked(estimate.roll_pitch_yaw, rates, yaw)[at]
    few = slice(None, None, max(1, round(rate_hz / _OFTEN_HZ)))
    sailed, decks, steps = [], {}, len(platform.methods) + 1
    for name, method in platform.methods.items():
        advanced(len(sailed) / steps)
        readings, good = platform.commands(method, asked)
        decks[name] = platform.poses(control.followed(readings), sea.force)
        ideal, reachable = platform.commands(method, sea.level[few])
        in_port = sea[few].error(platform.poses(ideal, STANDING))
        in_port[~reachable] = np.nan
        sailed.append(Sailed(name, sea.error(decks[name]), in_port, int(np.sum(~good))))
    advanced(len(sailed) / steps)
    alone = {"filter": sea[few].error(levelling(estimate.roll_pitch_yaw[at], yaw)[few])}
    known = control.asked(motion.angles, motion.angular_rate, yaw)[at]
    alone |= _moving(platform, control, sea, known, few)
    watched = (_watched(name, motion, decks[name], at, rate_hz, settings, watch) for name in (RAW, *list(decks)[-1:]))
    return SeaTrial(
        robot=platform.description.name,
        settings=settings,
        full=platform.full,
        rate_hz=rate_hz,
        t=motion.t[at] - motion.t[begin],
        ship=motion.angles[at],
        filtered=estimate.roll_pitch_yaw[at, :2],
        innovations=estimate.innovations,
        methods=tuple(sailed),
        parts=alone,
        watched=tuple(watched),
    )


def deck_error(level: np.ndarray, deck: np.ndarray, full: bool) -> np.ndarray:
    """(n, 3) of orientations on board (n, 3, 3) against those that are level, about the deck's axes [rad].

    full: the heading counts, too; else the tilt alone.
    """
    upright = level.swapaxes(1, 2) @ deck
    return (orientation_error if full else gravity_error)(np.broadcast_to(np.eye(3), upright.shape), upright)


@dataclass(frozen=True)
class _Sea:
    """What the deck should do, and what it stands."""

    level: np.ndarray  # (m, 3, 3) on board
    force: np.ndarray  # (m, 3) specific, in the ship's axes [m/s2]
    full: bool

    def __getitem__(self, rows: slice) -> _Sea:
        return _Sea(self.level[rows], self.force[rows], self.full)

    def error(self, deck: np.ndarray) -> np.ndarray:
        return deck_error(self.level, deck, self.full)


@dataclass(frozen=True)
class _Control:
    """From the ship's attitude to where the actuators are."""

    delay: int  # samples
    keep: float  # of a lag, a sample
    lead: float  # [s]

    @staticmethod
    def of(settings: Trial, rate_hz: float) -> _Control:
        delay, keep = round(settings.delay_ms * 1e-3 * rate_hz), kept(settings.bandwidth_hz, rate_hz)
        return _Control(delay, keep, delay / rate_hz + lag(keep, rate_hz) if settings.lead else 0.0)

    def asked(self, angles: np.ndarray, rates: np.ndarray, yaw: float) -> np.ndarray:
        """(n, 3, 3): what is asked of the platform, by attitudes (n, 3) [rad] and rates (n, 3) [rad/s] of the ship."""
        return late(levelling(ahead(angles, rates, self.lead) if self.lead else angles, yaw), self.delay)

    def followed(self, readings: np.ndarray) -> np.ndarray:
        return followed(readings, self.keep)


def _moving(platform: Platform, control: _Control, sea: _Sea, known: np.ndarray, few: slice) -> dict[str, np.ndarray]:
    """What delay, actuators and load do to the deck, each alone; by the identified model, whose own error is taken off.

    known: (m, 3, 3) what is asked for where the ship's attitude and rates are known exactly.
    """
    method, now = platform.methods["geometric"], sea[few]
    readings = platform.commands(method, sea.level)[0]
    still = platform.poses(readings[few], STANDING)

    def beside(deck: np.ndarray) -> np.ndarray:
        return now.error(now.level @ still.swapaxes(1, 2) @ deck)

    led = platform.commands(method, known)[0]
    return {
        "load of a moving ship": beside(platform.poses(readings[few], now.force)),
        "delay": beside(platform.poses(late(readings, control.delay)[few], STANDING)),
        "actuators": beside(platform.poses(control.followed(readings)[few], STANDING)),
        "delay and actuators, looked ahead": beside(platform.poses(control.followed(led)[few], STANDING)),
    }


def _watched(
    name: str, motion: ShipMotion, deck: np.ndarray, at: slice, rate_hz: float, settings: Trial, sensor: SensorPreset
) -> Watched:
    """The second sensor stands on the deck, where the platform does."""
    rotation = motion.rotation[at] @ deck
    turn = log(rotation[:-1].swapaxes(1, 2) @ rotation[1:]) * rate_hz
    rate = (np.concatenate([turn[:1], turn]) + np.concatenate([turn, turn[-1:]])) / 2
    lifted = motion.acceleration_at(settings.lever_m)[at] + STANDING
    force = np.einsum("nji,nj->ni", rotation, lifted)
    samples = sensed(force, rate, rate_hz, sensor, [settings.seed, 31]).samples
    attitude = smooth_attitude(motion.t[at], samples, AttitudeSettings(sensor=sensor), "the deck's sensor")
    return Watched(name, attitude.roll_pitch_yaw[:, :2], zyx_angles(rotation)[:, :0:-1])
