(expect: stop plunge)
(set: cutting.detail=engagement)
(set: tool.centre_cutting=false)
G21 G90 G17
(T1 D=10. CR=0. - ZMIN=-1. - FLAT END MILL 4 FLUTES)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z0 F400
X1.072 Z-0.5 F500
X0
G0 Z5
M30
