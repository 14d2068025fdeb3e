"""G-code as Fanuc-, Haas-, LinuxCNC-, GRBL- and Sinumerik-flavoured posts write it."""
