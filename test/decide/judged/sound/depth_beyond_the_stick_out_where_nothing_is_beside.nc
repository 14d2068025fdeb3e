(expect: may be run)
(set: cutting.detail=engagement)
(set: tool.stick_out_mm=2)
(set: stock.min_mm=[0,-5,-30])
(set: stock.max_mm=[8,5,0])
G21 G90 G17
(T1 D=20. CR=0. - FLAT END MILL 3 FLUTES)
T1 M6
S4000 M3
G0 X-12 Y0
Z-1
G1 X20 F1500
G0 Z5
G0 X-12 Y0
Z-2
G1 X20 F1500
G0 Z5
G0 X-12 Y0
Z-3
G1 X20 F1500
G0 Z5
G0 X-12 Y0
Z-4
G1 X20 F1500
G0 Z5
M30
