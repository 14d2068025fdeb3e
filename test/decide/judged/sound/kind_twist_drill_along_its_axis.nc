(expect: may be run)
(set: cutting.detail=engagement)
G21 G90 G17
(T1 TWIST DRILL D=10)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z-3 F300
Z2 F1000
X20 F4000
Z-3 F300
Z2 F1000
G0 Z5
M30
