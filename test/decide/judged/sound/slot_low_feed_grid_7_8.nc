(thin chips of 16 um: noise of the grid from tooth to tooth is no growth)
(expect: may be run)
(set: stock.min_mm=[-6,-7,-5])
(set: stock.max_mm=[6,7,0])
(set: stock.grid_step_um=7.8)
G21 G90 G17
T1 M6 (flat end mill D10)
S8000 M3
G0 X-12 Y0 Z5
Z-1
G1 X-3 F500
G0 Z5
M30
