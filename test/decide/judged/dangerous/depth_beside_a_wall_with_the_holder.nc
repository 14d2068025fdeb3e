(expect: stop tool body)
(set: cutting.detail=engagement)
(set: tool.stick_out_mm=5)
(set: stock.min_mm=[0,-8,-30])
(set: stock.max_mm=[20,8,0])
G21 G90 G17
(T1 D=6. CR=0. - FLAT END MILL 3 FLUTES)
T1 M6
S8000 M3
G0 X-6 Y-9 Z5
G0 X-6 Y-9
Z-2
G1 X26 F1500
G0 Z5
G0 X-6 Y-9
Z-4
G1 X26 F1500
G0 Z5
G0 X-6 Y-9
Z-6
G1 X26 F1500
G0 Z5
M30
