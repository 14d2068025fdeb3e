(expect: stop tool body)
(set: cutting.detail=engagement)
(set: tool.stick_out_mm=5)
G21 G90 G17
(T1 D=6. CR=0. - FLAT END MILL 3 FLUTES)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z0 F400
X8 Z-1 F600
X0 Z-2
X8 Z-3 F600
X0 Z-4
X8 Z-5 F600
X0 Z-6
X8
G0 Z5
M30
