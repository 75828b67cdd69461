"""Speed and accuracy, side by side with what a user would write today. `make bench` runs the quick ones.

Nothing here fails on time.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")  # small matrices: BLAS threads only wait for each other
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
