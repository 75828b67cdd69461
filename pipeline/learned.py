"""What the stages of learning hand on; apart from other results, so that identification does not depend on networks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kincal.learning.correction import Correction
from kincal.learning.network import Network
from kincal.learning.units import Inherited
from kincal.pipeline.results import Bundle, Identified


@dataclass(frozen=True)
class SourceTask:
    """The poses that networks are pre-trained on, and what the nominal model says there in each fit's chart."""

    readings: np.ndarray  # (n, n_actuated)
    outputs: tuple[np.ndarray, ...]  # (n, n_out); each once: the chart depends on the fit for tilt alone
    of_fit: tuple[int, ...]  # which of them, one a fit


@dataclass(frozen=True)
class Pretrained:
    """Networks before they have seen a measured pose."""

    start: Network  # random
    nominal: tuple[Network, ...]  # one each of SourceTask.outputs
    curve: np.ndarray  # (iterations, 2) training and validation loss


@dataclass(frozen=True)
class Learned:
    """What the paper's networks learned from one fit's measured poses."""

    network: Network  # from a random start: the paper's BP network
    transfer: Network  # from the nominal model's prior: the paper's transfer network
    transfer_identified: Network  # from the identified model's prior
    curve: np.ndarray  # (iterations, 6) training, then validation losses of the three networks


@dataclass(frozen=True)
class Transferred:
    fits: tuple[Learned, ...]  # in the order of Identified.fits


@dataclass(frozen=True)
class SiblingResiduals:
    """What residuals of such a robot look like."""

    inherited: Inherited
    curve: np.ndarray  # (iterations, 2) training loss, and NaN


@dataclass(frozen=True)
class Corrected:
    """What geometry can't explain of one fit's measured poses."""

    refined: np.ndarray  # (n_parameters,) changes of the geometry, identified together with the correction
    correction: Correction  # of the actuators
    learning_curve: np.ndarray  # (sizes, 3) poses, and the errors of unseen ones: see learning.residual


@dataclass(frozen=True)
class Hybrids:
    fits: tuple[Corrected, ...]  # in the order of Identified.fits


@dataclass(frozen=True)
class Fits(Bundle):
    """All that was fitted to measured poses: `methods.calibrated.calibrations` puts it together, fit by fit."""

    identified: Identified
    transferred: Transferred
    hybrids: Hybrids
