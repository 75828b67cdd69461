"""Run the quick benchmarks, or those named, each in a process of its own: python -m benchmarks [kinematics] ..

Quick: kinematics, identification (without its slow peers and its scaling: `python -m benchmarks.identification`) and
commands. Long ones, by name:

    accuracy          the six methods over ten seeds; a quarter of an hour
    non_geometric     which errors each method removes, one at a time; ten minutes
    poses             D-optimal poses beside other layouts
    recovery          error and chi-square beside what is possible, all shipped robots; an hour
    coverage          do 95 % intervals hold 95 %; half an hour
    estimators        the five estimators and the losses side by side
    training          networks beside scikit-learn and torch's Adam, ten seeds at once; six minutes
    ur10_recording    a real arm, where its recordings are at hand; a minute
    learning_recordings  the six methods and scikit-learn's regressors on recorded robots; twenty minutes
    attitude          roll and pitch at sea beside smsfusion, Madgwick and an accelerometer, 20 seeds; five minutes
    static_poses      the filter of static poses beside the white-noise bound
    compensator       microseconds a command of the exported C, samples a second in Python; ten minutes
    predicted_regions    do the regions of predictions hold the truth; ten minutes
    damage            accidents of the store, each tried and counted (make damage); twenty minutes
    family            which unit of a fleet is out of family: false alarms, and units that are missed; ten minutes
    mistakes          which cause is named, of tables with one mistake each; twenty minutes
    fleet             24 units on 1 and 2 workers and on Dask, and 200 cached ones; twenty minutes
    ship_motion       generated ship motion beside waveresponse's statistics, and the replay of a log; a minute
"""

import subprocess
import sys

ALL = {"kinematics": [], "identification": ["--quick"], "commands": []}

for name in sys.argv[1:] or ALL:
    options = ALL[name] if not sys.argv[1:] else []
    subprocess.run([sys.executable, "-m", f"benchmarks.{name}", *options], check=True)
