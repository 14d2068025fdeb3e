(chips of 6 um)
(expect: may be run)
(set: stock.min_mm=[-6,-7,-5])
(set: stock.max_mm=[6,7,0])
G21 G90 G17
T1 M6 (flat end mill D10)
S8000 M3
G0 X-12 Y0 Z5
Z-1
G1 X2 F200
G0 Z5
M30
