(expect: stop spindle off)
(set: cutting.detail=engagement)
(set: stock.min_mm=[0,0,-15])
(set: stock.max_mm=[60,40,0])
G21 G90 G17 G54
S8000
G0 X-8 Y20 Z5
Z-2
G1 X30 F1500
G0 Z20
M30
