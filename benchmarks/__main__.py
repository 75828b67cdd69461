"""Run every benchmark, or those named, each in a process of its own: python -m benchmarks [kinematics] [commands] .."""

import subprocess
import sys

ALL = ("kinematics", "identification", "commands")

for name in sys.argv[1:] or ALL:
    subprocess.run([sys.executable, "-m", f"benchmarks.{name}"], check=True)
