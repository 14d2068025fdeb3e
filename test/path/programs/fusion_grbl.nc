(1001)
(T1  D=10 CR=0 - ZMIN=-1 - flat end mill)
G90 G94
G17
G21
(When using Fusion 360 for Personal Use, the feedrate of)
(rapid moves is reduced to match the feedrate of cutting)
(moves, which can increase machining time. Unrestricted rapid)
(moves are available with a Fusion 360 Subscription.)
G28 G91 Z0
G90

(2D Pocket1)
T1
S5000 M3
G54
G0 X4 Y0
Z15
Z2
G3 X4 Y0 Z1 I-4 F300
X4 Y0 Z0 I-4
X4 Y0 Z-1 I-4
X4 Y0 I-4 F800
G1 X8
Y5
X-8
Y-5
X8
Y0
(2D Pocket1 finish)
X14
Y8
G3 X12 Y10 I-2
G1 X-12
G3 X-14 Y8 J-2
G1 Y-8
G3 X-12 Y-10 I2
G1 X12
G3 X14 Y-8 J2
G1 Y0
G19 G3 Y1 Z0 K1
G17
G0 Z15
G28 G91 Z0
G90
G28 G91 X0 Y0
G90
M5
M30
