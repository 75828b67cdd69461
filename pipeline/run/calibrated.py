"""The calibrated robot out of the store."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from kincal.pipeline.methods.calibrated import Calibrated, CalibratedRobot, check_method
from kincal.pipeline.stages.robot_data import DrawnRobot
from kincal.urdf.description import RobotDescription


def calibrated(
    description: RobotDescription, until: Callable[..., list[Any]], method: str | None = None
) -> CalibratedRobot:
    """With what `method` needs; None: with all. Networks that nobody asks for are not trained. Raises InputError.

    until: brings stages up to date and returns their results, as `Run.until` does.
    """
    if method is not None:
        check_method(method)
    stages = {
        "model": True,
        "identify": True,
        "transfer": method is None or "transfer" in method or method == "network",
        "correct": method in (None, "geometric", "hybrid"),
    }
    wanted = [name for name, needed in stages.items() if needed]
    results = dict(zip(wanted, until(*wanted), strict=True))
    identified = results["identify"]
    fitted = Calibrated(
        DrawnRobot.of(results["model"], description).errors,
        identified.fits()[0],
        results["transfer"].fits[0] if "transfer" in results else None,
        results["correct"].fits[0] if "correct" in results else None,
        identified.shipped.channels,
    )
    return CalibratedRobot(description, identified.shipped, fitted)
