"""Full passes with every combination of two keys, as a table of pandas."""

from kr270_milling import sweep

table = sweep(
    "paper.yaml",
    "path.length_mm=20",
    "stock.max_mm=[20, 12, 0]",
    vary={"path.depth_of_cut_mm": [0.3, 0.6], "tool.teeth": [2, 4]},
)
print(table[["path.depth_of_cut_mm", "tool.teeth", "static_deviation_um", "max_deviation_um"]].round(2).to_string())
