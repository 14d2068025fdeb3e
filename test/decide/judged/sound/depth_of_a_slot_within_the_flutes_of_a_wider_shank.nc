(expect: may be run)
(set: cutting.detail=engagement)
(set: tool.flute_length_mm=4.1)
(set: tool.shank_diameter_mm=8)
(set: tool.stick_out_mm=25)
(set: exchange.engagement_period_ms=1)
G21 G90 G17
(T1 D=6. CR=0. - FLAT END MILL 3 FLUTES)
T1 M6
S8000 M3
G0 X0 Y0 Z5
G1 Z0 F400
X8 Z-1 F600
X0 Z-2
X8 Z-3 F600
X0 Z-4
X8
G0 Z5
M30
