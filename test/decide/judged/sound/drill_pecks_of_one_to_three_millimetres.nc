(the arm swings within one step of the map while the drill goes down again in its hole)
(expect: may be run)
(set: cutting.detail=engagement)
(set: stock.min_mm=[0,0,-15])
(set: stock.max_mm=[60,40,0])
(T3 D=6. - drill)
G21 G90 G17 G54
T3 M6
S2500 M3
G0 X10 Y20 Z20
G98 G83 Z-10 R2 Q2 F200
X20 Z-10 R2 Q3
X30 Z-5 R1 Q1
G73 X40 Z-8 R2 Q2
G80
M5
M30
