(expect: stop in the fixture)
(set: cutting.detail=engagement)
(set: stock.min_mm=[-20,-20,-20])
(set: stock.max_mm=[20,20,0])
(set: tool.stick_out_mm=45)
(set: workpiece.fixtures_mm=[-2,25,-20,2,29,45])
(T1 D=10. - FLAT END MILL)
G21 G90 G94 G17
T1 M6
S8000 M3
G54
G43.5 H1
G0 X-30 Y0 Z60 I0 J0 K1
G0 Z-1
G1 X30 F1500
G0 Z60
G0 X-25 Y27 I0.433 J-0.75 K0.5
G0 Z10
(the tip moves by 0.01 mm while the tool turns past a clamp)
G0 Y27.01 I0.433 J0.75 K0.5
G0 Z60
G0 I0 J0 K1
M5
M30
