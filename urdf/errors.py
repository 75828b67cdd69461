"""The two ways in which kincal says no."""


class InputError(ValueError):
    """Bad input: one line that names the file, the field, what was found and what is allowed (exit status 2)."""


class CalibrationError(RuntimeError):
    """The calibration failed its own checks; nothing is exported (exit status 1)."""
