%
(expect: may be run)
(set: cutting.detail=engagement)
(T1 | 10. FLAT ENDMILL | H1 | D1 | WEAR COMP | TOOL DIA. - 10.)
G21 G90 G94 G17 G54
T1 M6
S8000 M3
G0 X-27 Y-20 Z10
Z2
G1 Z-1 F500
G41 D1 X-25 F1500
Y20
G40 X-27
G0 Z10
M30
%
