"""The deviation of the tool over the depth of cut: one pass a depth, with the static and the largest deviation."""

from kr270_milling import read_cell, simulate

for depth in (0.2, 0.4, 0.6, 0.8):
    cell = read_cell("paper.yaml", f"path.depth_of_cut_mm={depth}", "path.length_mm=40", "stock.max_mm=[40, 12, 0]")
    done = simulate(cell)
    print(f"{depth} mm: static {done.static_deviation_um:6.2f} um, largest {done.max_deviation_um:6.2f} um")
