(expect: stop tool bending)
(set: tool.stick_out_mm=60)
(set: cutting.detail=teeth)
(set: stock.min_mm=[0,-5,-5])
(set: stock.max_mm=[20,5,0])
(set: stock.grid_step_um=40)
G21 G90 G17
(T1 D=4. CR=0. - FLAT END MILL 2 FLUTES)
T1 M6
S8000 M3
G0 X-6 Y0 Z5
Z-2
G1 X6 F1200
G0 Z5
M30
