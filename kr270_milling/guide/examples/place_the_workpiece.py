"""The five best places of the workpiece for a slot: reach, limits and predicted error at 21 places."""

from kr270_milling import placements, read_cell

cell = read_cell("paper.yaml", "path.length_mm=40", "stock.max_mm=[40, 12, 0]")
table = placements(cell, x_mm=range(1200, 1801, 100), z_mm=(600, 700, 800))
best = table.query("feasible").nsmallest(5, "error_max_um")
print(best.round(1).to_string(index=False))
