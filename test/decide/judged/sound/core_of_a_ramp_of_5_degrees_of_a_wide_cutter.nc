(expect: may be run)
(set: cutting.detail=engagement)
(set: tool.centre_cutting=false)
(set: limits.spindle_torque_n_m=100)
G21 G90 G17
(T1 D=50. CR=0. - FACE MILL 4 INSERTS)
T1 M6
S2000 M3
G0 X0 Y0 Z5
G1 Z0 F400
X28.601 Z-2 F1000
X0
G0 Z5
M30
