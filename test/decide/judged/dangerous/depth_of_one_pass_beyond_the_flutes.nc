(expect: stop depth of cut)
(set: cutting.detail=engagement)
(set: tool.flute_length_mm=1.5)
G21 G90 G17
(T1 D=6. CR=0. - FLAT END MILL 3 FLUTES)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z0 F400
X16 Z-2
X0 Z-4
X16
G0 Z5
M30
