"""G-code as Fanuc-, Haas-, LinuxCNC-, GRBL- and Sinumerik-flavoured posts write it."""

ENDINGS = (".nc", ".gcode", ".ngc", ".tap", ".cnc", ".mpf", ".spf", ".ncc", ".eia", ".iso", ".txt")  #: of file names
