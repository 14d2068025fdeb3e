(expect: refused the radius of the tool is not known)
G21 G90 G17
T1 M6
S8000 M3
G0 X0 Y0 Z5
G41 D1 G1 X5 F500
G1 Z-1
X20
M30
