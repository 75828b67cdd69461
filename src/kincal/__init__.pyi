"""The public names of kincal."""

from .pipeline.interface.calibration import Calibration, calibrate
from .pipeline.interface.campaign import Foresight, Plan, foresee, measure, plan
from .pipeline.interface.changes import CampaignChanges
from .pipeline.interface.fit import Fit, identify
from .pipeline.interface.fleets import FleetResult, fleet
from .pipeline.interface.job_progress import JobEvent
from .pipeline.interface.reproduction import Reproduction, reproduce
from .pipeline.interface.robots import load, propose
from .pipeline.interface.sea import SeaOptions, SeaTrialResult, sea_trial
from .pipeline.interface.sweeps import SweepResult, sweep
from .pipeline.results import Comparison
from .pipeline.run.runner import Event
from .urdf.description import Robot
from .urdf.errors import (
    CalibrationError,
    InputError,
    NotConvergedError,
    TableError,
    UnknownNameError,
    UnreachablePoseError,
)
from .version import __version__

__all__ = [
    "Calibration",
    "CalibrationError",
    "CampaignChanges",
    "Comparison",
    "Event",
    "Fit",
    "FleetResult",
    "Foresight",
    "InputError",
    "JobEvent",
    "NotConvergedError",
    "Plan",
    "Reproduction",
    "Robot",
    "SeaOptions",
    "SeaTrialResult",
    "SweepResult",
    "TableError",
    "UnknownNameError",
    "UnreachablePoseError",
    "__version__",
    "calibrate",
    "fleet",
    "foresee",
    "identify",
    "load",
    "measure",
    "plan",
    "propose",
    "reproduce",
    "sea_trial",
    "sweep",
]
