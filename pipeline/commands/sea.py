"""The commands of `kincal` at sea."""

from __future__ import annotations

from pathlib import Path

from rich.text import Text

from kincal.pipeline.commands.console import err, out, print_json, short, show_table
from kincal.pipeline.commands.options import COMMON, Common, Json, Robot, command_line, opened


def sea_trial(
    robot: Robot,
    *,
    sea_state: int = 5,
    minutes: float = 10.0,
    heading: float = 120.0,
    speed: float = 0.0,
    motion: Path | None = None,
    rao: Path | None = None,
    sensor: str = "mru",
    deck_sensor: str = "precision",
    delay_ms: float = 20.0,
    bandwidth_hz: float = 10.0,
    lead: bool = True,
    rate_hz: float = 100.0,
    seed: int | None = None,
    output: Path | None = None,
    json: Json = False,
    common: Common = COMMON,
) -> None:
    """The platform on a moving ship keeps its deck level, by each of the methods: the paper's section 4.

    Parameters
    ----------
    sea_state
        3, 4, 5 or 6: JONSWAP waves.
    minutes
        Of the trial; two more before it are for the filter. Of a recorded motion: at most.
    heading
        Where waves travel to [deg], from the bow towards port: 0 is a following, 180 a head sea.
    speed
        Of the ship [knots].
    motion
        A recorded motion instead: a log (NMEA 0183, CSV, Parquet, a bag) with roll and pitch.
    rao
        The ship's table of responses (.csv, .parquet, or a .mat of the Marine Systems Simulator).
    sensor
        Of the ship: precision, industrial or mru.
    deck_sensor
        Of the second one, on the deck.
    delay_ms
        From the ship's sensor to the actuators.
    bandwidth_hz
        Of the actuators, a first-order lag.
    lead
        Look ahead by delay and lag, at the gyros' rates.
    rate_hz
        Of sensors and commands.
    seed
        Of waves and sensors (default: the robot's).
    output
        The folder of index.html, results.json, series.parquet and the figures (default: NAME_sea_trial).
    json
        The contents of results.json on stdout.
    """
    from kincal.pipeline.sea.settings import Seaway
    from kincal.pipeline.sea.trial import Trial
    from kincal.pipeline.sea.trial_document import summary
    from kincal.pipeline.sea.voyage import sail, write
    from kincal.urdf.description import validate

    session = opened(robot, common)
    name, drawn = session.robot.description.name, session.robot.description.seed if seed is None else seed
    sea = validate(
        Seaway,
        {
            "sea_state": sea_state,
            "heading_deg": heading,
            "speed_knots": speed,
            "minutes": minutes,
            "rate_hz": rate_hz,
            "rao": rao,
            "seed": drawn,
        },
        "sea-trial",
    )
    settings = validate(
        Trial,
        {
            "sensor": sensor,
            "deck_sensor": deck_sensor,
            "delay_ms": delay_ms,
            "bandwidth_hz": bandwidth_hz,
            "lead": lead,
            "seed": drawn,
        },
        "sea-trial",
    )
    found = sail(session, sea, settings, motion, command_line())
    page = write(found, output or Path(f"{name}_sea_trial"))
    for innovation in found.document["filter"]["innovations"]:
        if innovation["warning"]:
            err.print(Text(f"warning: {innovation['warning']}", style="yellow"), soft_wrap=True)
    if json:
        print_json(found.document)
        return
    out.print(Text(found.document["motion"]["said"]), soft_wrap=True)
    for title, table in summary(found.document):
        out.print(Text(title, style="bold"))
        show_table(table)
    out.print(Text(f"page: {short(page)}"), soft_wrap=True)
