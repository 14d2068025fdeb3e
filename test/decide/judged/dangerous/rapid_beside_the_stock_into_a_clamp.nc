(expect: stop in the fixture)
(set: cutting.detail=engagement)
(set: stock.min_mm=[0,0,-15])
(set: stock.max_mm=[60,40,0])
(set: workpiece.fixtures_mm=[-20,10,-15,-5,30,-1])
(T1 D=10. CR=0. - flat end mill 2 flutes)
G21 G90 G17 G54
T1 M6
S6000 M3
G0 X-8 Y20 Z5
Z-2
G1 X30 F1500
G0 Z20
M5
M30
