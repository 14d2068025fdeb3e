%
(expect: warning cutter radius)
(set: cutting.detail=engagement)
(T1 D=10. CR=0. - ZMIN=-1. - FLAT END MILL)
G21 G90 G94 G17 G54
T1 M6
S8000 M3
G0 X-40 Y-30 Z10
Z2
G1 Z-1 F500
G41 D1 X-20 Y-15 F1500
Y15
X20
Y-15
X-20
G40 X-40 Y-30
G0 Z10
M30
%
