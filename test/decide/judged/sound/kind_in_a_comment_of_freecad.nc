(expect: warning stability not judged)
(set: cutting.detail=engagement)
G21 G90 G17
(Begin operation: TC: 10mm_Ball_End)
(TC: 10mm_Ball_End)
(Begin toolchange)
M5
M6 T1
M3 S8000
G0 X0 Y0 Z5
G1 Z0 F500
X6 Z-0.3
X0 F500
G0 Z5
M30
