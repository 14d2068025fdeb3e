(expect: stop plunge)
(set: cutting.detail=engagement)
(set: tool.centre_cutting=false)
G21 G90 G17
(T1 D=20. CR=0. - ZMIN=-3. - FLAT END MILL 4 FLUTES)
T1 M6
S4000 M3
G0 X1 Y0 Z5
G1 Z0 F400
G3 X1 Y0 Z-0.5 I-1 J0 F600
G3 X1 Y0 Z-1 I-1 J0 F600
G3 X1 Y0 I-1 J0
G0 Z5
M30
