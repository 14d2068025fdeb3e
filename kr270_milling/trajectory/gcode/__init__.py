"""G-code as Fanuc-, Haas-, LinuxCNC-, GRBL- and Sinumerik-flavoured posts write it."""

from kr270_milling.trajectory.gcode.reader import read_gcode

__all__ = ["read_gcode"]
