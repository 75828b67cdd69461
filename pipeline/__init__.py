"""How it all runs: stages, cache, virtual robots, comparison, report, the command."""
