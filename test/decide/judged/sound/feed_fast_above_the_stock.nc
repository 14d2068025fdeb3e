(expect: may be run)
(set: cutting.detail=engagement)
G21 G90 G17
(T1 D=3. CR=0. - FLAT END MILL 2 FLUTES)
T1 M6
S10000 M3
G0 X0 Y0 Z5
G1 Z0 F200
X10 Z-0.3
X0 F600
Z2 F9000
X12 Y4
G0 Z5
M30
