(expect: stop rapid in material)
(set: cutting.detail=engagement)
(set: stock.min_mm=[0,0,-15])
(set: stock.max_mm=[60,40,0])
(T1 D=10. CR=0. - flat end mill 2 flutes)
G21 G90 G17 G54
T1 M6
S6000 M3
G0 X45 Y20 Z5
G1 Z-5 F200
G1 X43 F1000
G3 X43 Y20 I2 J0
G1 X45
G0 X42 Y20
G0 X40
G0 Z20
M5
M30
