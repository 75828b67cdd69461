"""Sensor streams as instruments log them: reading, their health, and the still stretches that become poses."""
