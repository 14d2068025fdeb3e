(expect: warning stability not judged)
(set: cutting.detail=engagement)
G21 G90 G17
(FRESA SFERICA D10)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z-1 F200
X8 F800
G0 Z5
M30
