(expect: stop tool shape)
(set: cutting.detail=engagement)
G21 G90 G17
(T1 D=10. CR=0. - form mill)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z0 F500
X6 Z-0.3
X0 F500
G0 Z5
M30
