(expect: warning tool length)
(set: cutting.detail=engagement)
(set: exchange.engagement_period_ms=1)
G21 G90 G17
(T1 D=10. CR=0. - FLAT END MILL)
(T2 D=10. CR=0. - FLAT END MILL)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z0 F500
X3 Z-1
X0 F500
G0 Z5
T2 M6
S9000 M3
G0 X0 Y0 Z5
G1 Z0 F500
X3 Z-2
X0 F500
G0 Z5
M30
