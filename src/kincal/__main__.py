"""The command `kincal`; also `python -m kincal`."""

import os

# The matrices are small: more threads do not make them faster, but the last bits of a sum depend on their number.
# The libraries read these variables when they are imported, so they are set before anything else is.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


def main() -> None:
    """Run the command line and exit with its status."""
    for name in _THREADS:
        os.environ.setdefault(name, "1")
    from kincal.pipeline.commands.app import main as run

    run()


if __name__ == "__main__":
    main()
