(a right-hand cutter, as nearly all are, does not cut with M4)
(expect: refused counterclockwise (M4, CCLW), but tool.rotation of the cell)
(set: cutting.detail=engagement)
G21 G90 G17
(T1 D=10. CR=0. - FLAT END MILL 4 FLUTES)
T1 M6
S8000 M4
G0 X0 Y0 Z5
G1 Z-1 F400
X20 F1200
G0 Z5
M30
