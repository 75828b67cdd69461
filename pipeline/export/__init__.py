"""The calibrated robot for other programs: URDF and robot.toml, JSON, C."""
