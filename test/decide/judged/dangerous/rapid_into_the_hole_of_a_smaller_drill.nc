(expect: stop rapid in material)
(set: cutting.detail=engagement)
(set: stock.min_mm=[0,0,-15])
(set: stock.max_mm=[60,40,0])
(T3 D=6. - drill)
(T1 D=10. CR=0. - flat end mill 2 flutes)
G21 G90 G17 G54
T3 M6
S3000 M3
G0 X20 Y20 Z15
G81 Z-10 R3 F200
G80
G0 Z20
M5
T1 M6
S6000 M3
G0 X20 Y20 Z5
Z-5
G1 Z-8 F200
X30 F1500
G0 Z20
M5
M30
