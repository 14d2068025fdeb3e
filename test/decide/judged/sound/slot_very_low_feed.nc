(chips of 6 um)
(expect: may be run)
G21 G90 G17
T1 M6 (flat end mill D10)
S8000 M3
G0 X-12 Y0 Z5
G1 Z-1 F200
X2
G0 Z5
M30
