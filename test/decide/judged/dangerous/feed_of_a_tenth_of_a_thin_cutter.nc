(expect: stop feed per tooth)
(set: cutting.detail=engagement)
G21 G90 G17
(T1 D=1. CR=0. - FLAT END MILL 2 FLUTES)
T1 M6
S20000 M3
G0 X0 Y0 Z5
G1 Z0 F200
X5 Z-0.1
X0 F4000
G0 Z5
M30
