# %% [markdown]
# A part of your own: from a CAM program to a decision, step by step. Change `program` and the settings.

# %%
from pathlib import Path

from kr270_milling import check, compensate, read_cell

program = Path("slot.nc")
program.write_text("G21 G90 S8000 M3\n(slot)\nG0 X-65 Y0 Z5\nG0 Z-1\nG1 X-30 F4000\nG0 Z5\nM30\n")
cell = read_cell("test_piece.yaml", f"path.file={program.resolve()}", "part.tolerance_um=50", "stock.grid_step_um=50")

# %% may it be run as it was programmed?
checked = check(cell)
print("\n".join(checked.lines()))

# %% compensated: the decision, and the series of the pass
both = compensate(cell, "inverse")
print(both)
both.compensated.to_csv("slot_inverse.csv")

# %% the path error of each feature
print(both.original.tolerance, both.compensated.tolerance, sep="\n")
