(0.4 mm wide, 2 mm deep, around four corners)
(expect: may be run)
(set: stock.min_mm=[0,-10,-30])
(set: stock.max_mm=[12,10,0])
(set: exchange.period_ms=0.259259259)
G21 G90 G17
T1 M6 (flat end mill D10)
S9000 M3
G0 X-12 Y-9.6 Z5
G0 Z-2
G1 X16.6 F1500
Y9.6
X-4.6
Y-9.2
X16.2
Y9.2
X-4
G0 Z5
M30
