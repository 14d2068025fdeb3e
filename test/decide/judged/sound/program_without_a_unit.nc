%
(expect: warning no unit)
(set: cutting.detail=engagement)
(T1 D=10. CR=0. - ZMIN=-1. - FLAT END MILL)
G90 G17
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z0 F500
X8 Z-0.4
G0 Z5
M30
%
