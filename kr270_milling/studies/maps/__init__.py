"""Many cells at once: stability lobes, maps of placements, sweeps of keys."""
