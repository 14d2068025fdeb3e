"""A G-code program on the cell of the test piece: the summary and the findings."""

from pathlib import Path
from tempfile import TemporaryDirectory

from kr270_milling import check, read_cell

PROGRAM = """G21 G90 G17
T1 M6
S8000 M3
G0 X-15 Y10 Z5
Z-1
G1 X65 F500
G0 Z5
M30
"""
with TemporaryDirectory() as folder:
    program = Path(folder, "slot.nc")
    program.write_text(PROGRAM)
    cell = read_cell("test_piece.yaml", f"path.file={program}", "stock.min_mm=[0, 0, -10]", "stock.max_mm=[50, 20, 0]")
    checked = check(cell)
print(checked.summary)
for finding in checked.findings:
    print(f"{finding.severity}: {finding.text}")
