(expect: stop below the stock)
(set: cutting.detail=engagement)
(set: stock.min_mm=[0,0,-15])
(set: stock.max_mm=[60,40,0])
(set: limits.below_stock_mm=2)
(set: workpiece.table_z_mm=-16)
(T3 D=6. - drill)
G21 G90 G17 G54
T3 M6
S3000 M3
G0 X45 Y20 Z15
G81 Z-16.8 R3 F200
G80
G0 Z20
M5
M30
