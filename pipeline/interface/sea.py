"""The calibrated platform on a moving ship."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kincal.urdf.errors import InputError

if TYPE_CHECKING:
    from kincal.pipeline.interface.progress import StageObserver
    from kincal.pipeline.interface.robots import RobotLike
    from kincal.pipeline.report.tables import Table
    from kincal.pipeline.sea.voyage import Found


@dataclass(frozen=True)
class SeaOptions:
    """The ship, the sea and the controller of a sea trial."""

    sea_state: int = 5
    """3, 4, 5 or 6: JONSWAP waves."""
    minutes: float = 10.0
    """Length of the trial. Two more minutes before it are for the filter. Of a recorded motion: at most."""
    heading: float = 120.0
    """Where the waves travel to [deg], from the bow towards port: 0 is a following sea, 180 a head sea."""
    speed: float = 0.0
    """Speed of the ship [knots]."""
    motion: Path | None = None
    """A recorded motion instead: a log (NMEA 0183, CSV, Parquet, a bag) with roll and pitch."""
    rao: Path | None = None
    """The ship's table of responses (.csv, .parquet, or a .mat of the Marine Systems Simulator)."""
    sensor: str = "mru"
    """The ship's sensor: precision, industrial or mru."""
    deck_sensor: str = "precision"
    """The second sensor, on the deck."""
    delay_ms: float = 20.0
    """Delay from the ship's sensor to the actuators."""
    bandwidth_hz: float = 10.0
    """Bandwidth of the actuators, a first-order lag."""
    lead: bool = True
    """Look ahead by delay and lag, at the rates that the gyros measure."""
    rate_hz: float = 100.0
    """Rate of sensors and commands."""
    seed: int | None = None
    """Seed of waves and sensors. Default: the robot's."""


@dataclass(frozen=True, repr=False)
class SeaTrialResult:
    """What came of a sea trial.

    Attributes
    ----------
    trial
        The full result.

    Examples
    --------
    >>> import kincal
    >>> kincal.SeaOptions(sea_state=4).sea_state
    4
    """

    trial: Found

    def save(self, folder: str | PathLike[str]) -> Path:
        """Write index.html, results.json, series.parquet and the figures. Returns the page. Raises InputError."""
        from kincal.pipeline.sea.voyage import write

        return write(self.trial, Path(folder))

    def shown(self) -> list[tuple[str, Table]]:
        """The main tables for people, each with its title."""
        from kincal.pipeline.sea.trial_document import summary

        return summary(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """The contents of results.json."""
        return self.trial.document

    def __repr__(self) -> str:
        return f"SeaTrialResult({self.trial.document['motion']['said']!r})"


def sea_trial(
    robot: RobotLike,
    options: SeaOptions | None = None,
    *,
    store: str | PathLike[str] | None = None,
    progress: StageObserver = False,
    command: str = "kincal in Python",
) -> SeaTrialResult:
    """Let a calibrated virtual platform keep its deck level on a moving ship, by each of the methods.

    Parameters
    ----------
    robot
        A loaded robot, or what `load` takes. A trial moves the robot as it really is: it must be a virtual one.
    options
        Ship, sea and controller. Default: `SeaOptions()`.
    store
        The folder of cached results. Default: a temporary folder.
    progress
        True: lines on stderr. A function: called with each `Event`.
    command
        What the provenance says about where the results came from.

    Returns
    -------
    SeaTrialResult

    Raises
    ------
    InputError
        An option is not allowed, a file is not usable, or the robot is a real one.
    CalibrationError
        As the stages that run.

    Notes
    -----
    Xu, Tian and Zhang, J. Mar. Sci. Eng. 2024, 12, 275, section 4.

    Examples
    --------
    >>> import kincal
    >>> kincal.sea_trial("ups3_s", kincal.SeaOptions(sea_state=9))
    Traceback (most recent call last):
    kincal.urdf.errors.InputError: sea-trial: sea_state: found 9; input should be 3, 4, 5 or 6
    """
    from kincal.pipeline.interface.progress import Clock
    from kincal.pipeline.interface.sessions import opened
    from kincal.pipeline.sea.settings import Seaway
    from kincal.pipeline.sea.trial import Trial
    from kincal.pipeline.sea.voyage import sail
    from kincal.pipeline.watch import watched
    from kincal.urdf.description import validate

    if options is not None and not isinstance(options, SeaOptions):  # pyright: ignore[reportUnnecessaryIsInstance]
        raise InputError(f"options: found a {type(options).__name__}; allowed is kincal.SeaOptions(...)")
    session = opened(robot, store, progress, command)
    chosen = asdict(options or SeaOptions())
    if chosen["seed"] is None:
        chosen["seed"] = session.robot.description.seed
    names = {"heading": "heading_deg", "speed": "speed_knots"}
    sea = ("sea_state", "heading", "speed", "minutes", "rate_hz", "rao", "seed")
    seaway = validate(Seaway, {names.get(name, name): chosen[name] for name in sea}, "sea-trial")
    trial = ("sensor", "deck_sensor", "delay_ms", "bandwidth_hz", "lead", "seed")
    settings = validate(Trial, {name: chosen[name] for name in trial}, "sea-trial")
    clock = Clock(f"{session.robot.description.name} sea trial")
    with watched(clock.advance if progress is True else lambda share: None):
        try:
            return SeaTrialResult(sail(session, seaway, settings, chosen["motion"], command, clock.start))
        finally:
            clock.stop()
