"""The straight slot of the paper: deviation without and with a correction, by three methods."""

from kr270_milling import compensate, read_cell

cell = read_cell("paper.yaml", "path.length_mm=40", "stock.max_mm=[40, 12, 0]")
for method in ("linear", "spline", "inverse"):
    result = compensate(cell, method)
    before, after = result.original.max_deviation_um, result.compensated.max_deviation_um
    print(f"{method:8} {before:6.2f} um -> {after:5.2f} um")
