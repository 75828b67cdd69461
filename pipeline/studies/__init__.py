"""Many runs at once: sweeps over settings and seeds, and fleets of robots."""
