"""A ship in a seaway: waves, the vessel's response, and the motion of every point on board.

Axes: x forward, y to port, z up; R = Rz(yaw) Ry(pitch) Rx(roll). Waves travel towards `direction`, counted from x
towards y: 0 is a following sea, 90 degrees a sea from starboard, 180 a head sea.
"""
