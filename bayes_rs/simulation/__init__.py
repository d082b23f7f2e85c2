"""A virtual lidar: records drawn on lines, or seen in boxes of turbulence."""
