(the robot program comes down from 800 mm above the stock, and A5 passes through 0)
(expect: stop singularity)
(set: cutting.detail=engagement)
(set: stock.min_mm=[0,0,-20])
(set: stock.max_mm=[60,40,0])
(set: program.safe_height_mm=800)
G21 G90 G17
T1 M6 (flat end mill D10)
S8000 M3
G0 X-10 Y20 Z5
Z-1
G1 X20 F500
G0 Z5
M30
