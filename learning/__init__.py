"""What geometry can't explain. Knows arrays and networks, no robots."""
