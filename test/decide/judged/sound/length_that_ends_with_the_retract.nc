(expect: may be run)
(set: cutting.detail=engagement)
G21 G90 G17 G40 G49
(T1 D=10. CR=0. - FLAT END MILL)
T1 M6
S8000 M3
G43 H1
G0 X0 Y0 Z5
G1 Z0 F500
X8 Z-0.4
G0 Z5
G49 G91 G28 Z0
G90 G49
M30
