%
(G90 G28 leads to its place first: down into the part)
(T1 D=10. CR=0. - FLAT END MILL)
G21 G90 G94 G17
T1 M6
S8000 M3
G54
G0 X-12 Y0
G43 Z10 H1
G0 Z-0.3
G1 X0 F1000
G0 Z10
G28 X5 Y0 Z-3
M5
M30
(set: cutting.detail=engagement)
(set: stock.min_mm=[-5, -10, -10])
(set: stock.max_mm=[10, 10, 0])
(expect: stop rapid in material)
%
