(expect: may be run)
(set: cutting.detail=engagement)
(T1 D=0.5 FLAT END MILL 4 FLUTES)
G20 G90 G17
T1 M6
S8000 M3
G0 X0 Y0 Z0.2
G1 Z0 F20
X0.8 Z-0.04
X0 F80
G0 Z0.2
G21
M30
