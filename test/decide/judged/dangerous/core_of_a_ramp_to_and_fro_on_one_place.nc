(expect: stop plunge)
(set: cutting.detail=engagement)
(set: tool.centre_cutting=false)
G21 G90 G17
(T1 D=10. CR=0. - ZMIN=-1. - FLAT END MILL 4 FLUTES)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z0 F400
X2 Z-0.1
X0 Z-0.2
X2 Z-0.3
X0 Z-0.4
X2 Z-0.5
X0 Z-0.6
X2 Z-0.7
X0 Z-0.8
X2 Z-0.9
X0 Z-1
G0 Z5
M30
