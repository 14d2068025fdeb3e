(expect: stop rapid in material)
(set: cutting.detail=engagement)
(set: stock.min_mm=[-20,-20,-10])
(set: stock.max_mm=[100,40,0])
(T1 D=10 FLAT END MILL 4 FLUTES)
G21 G90 G17 G94
T1 M6
S8000 M3
G0 X0 Y0 Z20
G0 Z2
G1 Z-1 F200
X30 F1000
G28 A0
G0 X60 Y20
G1 X80 F1000
G0 Z20
M30
