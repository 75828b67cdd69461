"""How it all runs: stages, cache, virtual robots, comparison, report, the Python interface and the command."""
