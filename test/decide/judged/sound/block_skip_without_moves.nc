(expect: may be run)
(set: cutting.detail=engagement)
(T1 D=10 FLAT END MILL 2 FLUTES)
G21 G90 G17 G94
T1 M6
S8000 M3
/N20 M8
G0 X-40 Y0 Z5
G1 Z-1 F400
G1 X40 F800
/M1
G0 Z20
T0 M6
M30
