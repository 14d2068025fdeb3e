(expect: refused the tools cut in G54 and G55; state x, y and z of each)
G21 G90 G17
(T1 D=10. CR=0. - FLAT END MILL)
(T2 D=6. CR=0. - FLAT END MILL)
T1 M6
S8000 M3
G54
G0 X-10 Y0 Z5
G1 Z-1 F500
X20
G0 Z5
T2 M6
S9000 M3
G55
G0 X-10 Y0 Z5
G1 Z-2 F300
X20
G0 Z5
M30
