(no limit is stated for unequal pitch: the simulated pass shows the growth)
(expect: stop growing vibration)
(set: stock.min_mm=[0,-10,-30])
(set: stock.max_mm=[30,10,0])
(set: tool.pitch_deg=[85, 95, 85, 95])
G21 G90 G17
T1 M6 (flat end mill D10)
S8000 M3
G0 X-12 Y0 Z5
G1 Z-14 F2000
X14
G0 Z5
M30
