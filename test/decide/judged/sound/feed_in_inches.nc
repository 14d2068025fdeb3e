(expect: may be run)
(set: cutting.detail=engagement)
G20 G90 G17
(T1 D=0.236 CR=0. - FLAT END MILL 4 FLUTES)
T1 M6
S6000 M3
G0 X0 Y0 Z0.2
G1 Z0 F20
X0.8 Z-0.04
X0 F40
G0 Z0.2
M30
