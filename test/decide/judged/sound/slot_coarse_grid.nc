(a grid of a third of the feed per tooth)
(expect: may be run)
(set: stock.grid_step_um=20)
G21 G90 G17
T1 M6 (flat end mill D10)
S8000 M3
G0 X-12 Y0 Z5
G1 Z-1 F2000
X14
G0 Z5
M30
