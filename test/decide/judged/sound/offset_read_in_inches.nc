(expect: warning parameter unit)
(set: cutting.detail=engagement)
G20 G90 G17
(T1 D=0.5 CR=0. - FLAT END MILL)
G10 L2 P2 X0.2 Y0 Z0
T1 M6
S8000 M3
G0 X0 Y0 Z0.2
G1 Z0 F20
X[0.1+#5241] Z-0.01
G0 Z0.2
M30
