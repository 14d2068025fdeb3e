(expect: stop tool shape)
(set: cutting.detail=engagement)
G21 G90 G17
(TC: 10mm Endmill)
T1 M6
S8000 M3
G43 H1
G0 X0 Y0 Z5
G1 Z0 F500
X3 Z-1
X0 F500
G0 Z5
(TC: 60degree_Vbit)
M5
T2 M6
S9000 M3
G43 H2
G0 X0 Y0 Z5
G1 Z0 F500
X3 Z-1
X0 F500
G0 Z5
M30
