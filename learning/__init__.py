"""What geometry can't explain: networks and their training. Knows arrays, no robots."""
