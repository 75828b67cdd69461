"""The robot as drawn: description, closed chain, kinematics."""
