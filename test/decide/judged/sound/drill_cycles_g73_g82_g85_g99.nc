(expect: may be run)
(set: cutting.detail=engagement)
(set: stock.min_mm=[0,0,-15])
(set: stock.max_mm=[60,40,0])
(T3 D=6. - drill)
G21 G90 G17 G54
T3 M6
S3000 M3
G0 X10 Y10 Z15
G99 G73 Z-8 R2 Q2 F200
G82 X25 Z-6 R2 P500
G85 X40 Z-5 R2
G98 X50
G80
G0 Z20
M5
M30
