(an arm with a damping ratio of 0.01)
(expect: stop chatter)
(set: stock.min_mm=[0,-10,-30])
(set: stock.max_mm=[30,10,0])
(set: dynamics.damping_ratio=0.01)
G21 G90 G17
T1 M6 (flat end mill D10)
S8000 M3
G0 X-12 Y0 Z5
G1 Z-4 F2000
X14
G0 Z5
M30
