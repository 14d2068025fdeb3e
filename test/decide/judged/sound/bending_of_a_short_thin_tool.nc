(expect: may be run)
(set: cutting.detail=engagement)
(set: tool.stick_out_mm=20)
G21 G90 G17
(T1 D=4. CR=0. - FLAT END MILL 2 FLUTES)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z0 F400
X40 Z-2 F1200
X0
X40 Z-4
X0
G0 Z5
M30
