(2 % of the diameter)
(expect: may be run)
(set: stock.min_mm=[0,-10,-30])
(set: stock.max_mm=[30,10,0])
G21 G90 G17
T1 M6 (flat end mill D10)
S8000 M3
G0 X-12 Y-14.8 Z5
G0 Z-2
G1 X42 F1500
G0 Z5
M30
