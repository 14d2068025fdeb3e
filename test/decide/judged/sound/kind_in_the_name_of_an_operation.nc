(expect: may be run)
(set: cutting.detail=engagement)
G21 G90 G17
(T1 D=10. CR=0. - ZMIN=-1. - FLAT END MILL)
(2D Chamfer1)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z0 F500
X6 Z-0.3
X0 F500
G0 Z5
(Drill 5mm holes by milling)
G0 X30
(Engrave text)
G1 Z-1 F300
X35 F500
G0 Z5
M30
