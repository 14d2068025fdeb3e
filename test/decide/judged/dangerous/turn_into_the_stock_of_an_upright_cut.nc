(expect: stop rapid in material)
(set: cutting.detail=engagement)
(set: stock.min_mm=[-20,-20,-20])
(set: stock.max_mm=[20,20,0])
(set: tool.stick_out_mm=45)
(T1 D=10. - FLAT END MILL)
G21 G90 G94 G17
T1 M6
S8000 M3
G54
G43.5 H1
G0 X-30 Y-23 Z30 I0 J0 K1
G0 Z-1
G1 X30 F1500
G0 Y-30
(beside the stock the tool leans over it in place)
G0 X0
G0 X0 Y-30 Z-3 I0 J0.9063 K0.4226
G0 X0 Y-30 Z-3 I0 J0 K1
G0 Z40
M5
M30
