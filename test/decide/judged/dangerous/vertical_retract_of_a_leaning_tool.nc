%
(expect: stop rapid in material)
(set: stock.min_mm=[-12,-20,-20])
(set: stock.max_mm=[20,20,0])
(set: tool.stick_out_mm=45)
(T1 D=10. - FLAT END MILL)
G21 G90 G94 G17
T1 M6
S8000 M3
G54
G43.5 H1
G0 X-30 Y0 Z30 I0.034899 J0.341812 K0.939120
(slot that leans by 20 deg and leads by 2 deg, its corner 6.7 mm deep)
G0 Y-8 Z-5
G1 X0 F900
(a vertical retract runs through the material above the leaning tool)
G0 Z17
M5
M30
%
