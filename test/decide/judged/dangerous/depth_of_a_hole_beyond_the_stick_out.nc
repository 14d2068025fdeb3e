(expect: stop tool body)
(set: cutting.detail=engagement)
(set: tool.stick_out_mm=5)
G21 G90 G17
(T1 D=6. CR=0. - FLAT END MILL 3 FLUTES)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z-2 F300
Z1 F2000
G1 Z-4 F300
Z1 F2000
G1 Z-6 F300
Z1 F2000
G0 Z5
M30
