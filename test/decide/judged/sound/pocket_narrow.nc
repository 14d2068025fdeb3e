(0.4 mm wide, 2 mm deep: the tool leaves corners)
(expect: may be run)
(set: stock.floor_tolerance_um=20)
G21 G90 G17
T1 M6 (flat end mill D10)
S9000 M3
G0 X0 Y0 Z1
G1 Z-2 F300
G1 X-2.400 Y-0.400 F2500
X2.400
Y0.400
X-2.400
Y-0.400
G1 X-2.800 Y-0.800 F2500
X2.800
Y0.800
X-2.800
Y-0.800
G1 X-3.200 Y-1.200 F2500
X3.200
Y1.200
X-3.200
Y-1.200
G0 Z5
M30
