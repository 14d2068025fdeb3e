(slightly unequal pitch at a foot of a lobe)
(expect: stop growing vibration)
(set: stock.min_mm=[0,-10,-30])
(set: stock.max_mm=[30,10,0])
(set: exchange.period_ms=0.238095238)
(set: tool.pitch_deg=[88, 92, 88, 92])
G21 G90 G17
T1 M6 (flat end mill D10)
S7000 M3
G0 X-12 Y0 Z5
G1 Z-9 F2000
X14
G0 Z5
M30
