"""The robot as built: measurements, the full-parameter error model, identification and accuracy."""
