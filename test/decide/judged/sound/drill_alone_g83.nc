(expect: may be run)
(set: cutting.detail=engagement)
(T3 D=6. - drill)
G21 G90 G17 G54
T3 M6
S3000 M3
G0 X20 Y10 Z15
G98 G83 Z-12 R3 Q3 F200
X35
G80
G0 Z20
M5
M30
