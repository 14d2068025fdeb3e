"""The limit depth of cut over the spindle speed, of an arm and a tool with two modes."""

from kr270_milling import read_cell, stability

cell = read_cell("test_piece_tool_modes.yaml")
lobes = stability(cell, range(6000, 12001, 1000))
for row in lobes.to_frame().to_dict("records"):
    print({key: round(value, 3) if isinstance(value, float) else value for key, value in row.items()})
