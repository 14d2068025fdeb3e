(a foot of a lobe: 8 mm are stable at 9000 rpm, not at 7000)
(expect: stop chatter)
(set: stock.min_mm=[0,-10,-30])
(set: stock.max_mm=[30,10,0])
(set: exchange.period_ms=0.238095238)
G21 G90 G17
T1 M6 (flat end mill D10)
S7000 M3
G0 X-12 Y0 Z5
G1 Z-8 F2000
X14
G0 Z5
M30
