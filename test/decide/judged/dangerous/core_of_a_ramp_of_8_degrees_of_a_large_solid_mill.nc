(expect: stop plunge)
(set: cutting.detail=engagement)
(set: tool.centre_cutting=false)
G21 G90 G17
(T1 D=16. CR=0. - ZMIN=-3. - FLAT END MILL 4 FLUTES)
T1 M6
S4000 M3
G0 X0 Y0 Z5
G1 Z0 F400
X21.346 Z-3 F500
X0
G0 Z5
M30
