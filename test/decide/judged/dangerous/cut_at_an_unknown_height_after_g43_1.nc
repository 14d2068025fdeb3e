%
(expect: refused before X, Y and Z are known)
(set: cutting.detail=engagement)
(the line after G43.1 cuts, at a height that only the control knows)
(T1 D=10 FLAT END MILL)
G21 G90 G17 G54
T1 M6
S8000 M3
G0 X-20 Y0 Z5
G1 Z-1 F500
X10 F1200
G43.1 Z20.
X50
G0 Z5
M5
M30
%
