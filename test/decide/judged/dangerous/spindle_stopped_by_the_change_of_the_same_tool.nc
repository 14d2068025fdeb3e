(expect: refused while the spindle is off)
(set: cutting.detail=engagement)
G21 G90 G17
(T1 D=10. CR=0. - FLAT END MILL 4 FLUTES)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z-1 F200
X40 F800
G0 Z5
T1 M6
G0 X0 Y15
G1 Z-1 F200
X40 F800
G0 Z5
M30
