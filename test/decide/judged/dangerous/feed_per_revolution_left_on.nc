(expect: stop feed per tooth)
(set: cutting.detail=engagement)
G21 G90 G17
(T1 D=10. CR=0. - ZMIN=-1. - FLAT END MILL 4 FLUTES)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G94 G1 Z0 F500
X8 Z-0.4
G95 X0 F1200
G0 Z5
M30
