"""The mean wind in the field: its error, profiles, motion of the lidar, pairs of beams."""
