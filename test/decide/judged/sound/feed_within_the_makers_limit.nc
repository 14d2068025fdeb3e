(expect: may be run)
(set: cutting.detail=engagement)
(set: tool.max_feed_per_tooth_mm=0.6)
G21 G90 G17
(T1 D=10. CR=0. - ZMIN=-1. - FLAT END MILL 4 FLUTES)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z0 F500
X8 Z-0.4
X0 F16000
G0 Z5
M30
