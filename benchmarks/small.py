"""Settings of a run that takes seconds, for who looks at files and processes: benchmarks, and the tests."""

# A tracker, and small networks whose accuracy is not looked at.
SMALL = (
    'measure.channels=["orientation"]',
    "prior.poses=125",
    "pretrain.iterations=15",
    "pretrain.continued=3",
    "transfer.iterations=10",
    "siblings.count=4",
    "siblings.poses=40",
    "siblings.hidden=6",
    "siblings.iterations=30",
    "correct.own_units=4",
    "correct.shared_units=4",
    "evaluate.closed_loop=false",  # test_six_methods closes it
)
QUICK = ("plan.poses=12", *SMALL)
