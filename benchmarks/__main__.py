"""Run the speed benchmarks, or those named, each in a process of its own: python -m benchmarks [kinematics] ..

`python -m benchmarks accuracy` runs the six methods over five seeds; it takes a quarter of an hour.
"""

import subprocess
import sys

ALL = ("kinematics", "identification", "commands")

for name in sys.argv[1:] or ALL:
    subprocess.run([sys.executable, "-m", f"benchmarks.{name}"], check=True)
