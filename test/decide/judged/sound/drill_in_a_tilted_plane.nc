(expect: may be run)
(set: cutting.detail=engagement)
(set: tool.stick_out_mm=60)
(set: stock.min_mm=[42,-8,-20])
(set: stock.max_mm=[58,8,0])
(T1 D=8 TWIST DRILL)
G21 G90 G17 G94
T1 M6
S3000 M3
G0 X50 Y0 Z50
G68.2 X50 Y0 Z0 I0 J20 K0
G53.1
G0 X0 Y0 Z10
G81 Z-4 R2 F400
G80
G0 Z20
G69
G0 Z60
M30
