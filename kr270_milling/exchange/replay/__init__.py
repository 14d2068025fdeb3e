"""Recorded passes through the models again, without graph and clock: recomputed, compensated, scored."""
