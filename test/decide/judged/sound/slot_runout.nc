(run-out repeats with each revolution)
(expect: may be run)
(set: tool.runout_um=[10, -5, 8, 0])
G21 G90 G17
T1 M6 (flat end mill D10)
S8000 M3
G0 X-12 Y0 Z5
G1 Z-1 F2000
X14
G0 Z5
M30
