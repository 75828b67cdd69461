"""Attitude of a moving target from inertial sensors: an error-state Kalman filter, its smoother and its statistics."""
