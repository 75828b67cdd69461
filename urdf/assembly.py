"""A mechanism put together: its loops closed with the tool at home, and its workspace checked."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kincal.urdf.closed_chain import ClosedChain, load_chain
from kincal.urdf.description import Mechanism, Workspace
from kincal.urdf.kinematics import at_home
from kincal.urdf.rigid_motion import Motion, from_xyz_angles
from kincal.urdf.workspace import WorkspaceReport, check_workspace


def assembled(mechanism: Mechanism, text: str, file: Path) -> tuple[ClosedChain, WorkspaceReport]:
    """The chain of a mechanism and the text of its URDF or MJCF, at home and fit for calibration (else InputError)."""
    chain = at_home(load_chain(mechanism, text, file), home_pose(mechanism.workspace))
    return chain, check_workspace(chain, mechanism.workspace)


def home_pose(workspace: Workspace) -> Motion | None:
    """The tool's home in the base frame; None: as the file shows it."""
    if workspace.home_mm is None and workspace.home_rotation_deg is None:
        return None
    angles = np.deg2rad(workspace.home_rotation_deg or (0.0, 0.0, 0.0))
    return Motion(from_xyz_angles(angles), np.array(workspace.home_mm or (0.0, 0.0, 0.0)) * 1e-3)
