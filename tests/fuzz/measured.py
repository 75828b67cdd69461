"""`python -m tests.fuzz.measured -m kincal ..`: the command; stderr's last line is its peak of memory [MB]."""

import atexit
import resource
import runpy
import sys

atexit.register(
    lambda: print(
        f"\npeak {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f}", file=sys.stderr, flush=True
    )
)
module = sys.argv[2]
sys.argv = [module, *sys.argv[3:]]
runpy.run_module(module, run_name="__main__", alter_sys=True)
