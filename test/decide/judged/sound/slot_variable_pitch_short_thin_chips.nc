(what repeats with each revolution changes while the tool enters: no growth)
(expect: may be run)
(set: stock.min_mm=[-6,-7,-5])
(set: stock.max_mm=[6,7,0])
(set: tool.pitch_deg=[80, 95, 87, 98])
G21 G90 G17
T1 M6 (flat end mill D10)
S8000 M3
G0 X-12 Y0 Z5
Z-1
G1 X-3 F200
G0 Z5
M30
