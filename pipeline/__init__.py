"""How it all runs: stages, cache, virtual robots, comparison, report, the command."""

import os

# Our matrices are small: more threads don't make them faster, but the sums' last bits depend on their number.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")
