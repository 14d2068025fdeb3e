"""The error of a corrected slot on simulated robots, each with other stiffness, lag and backlash."""

from kr270_milling import compensate, read_cell, verdict

cell = read_cell("paper.yaml", "path.length_mm=20", "stock.max_mm=[20, 12, 0]")
reference = compensate(cell, "robust").compensated.reference
judged = verdict(cell, reference, samples=8)
print(judged)
