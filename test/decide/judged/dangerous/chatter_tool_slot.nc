(the mode of the tool in a slot at 15000 rpm chatters above 0.39 mm)
(expect: stop chatter)
(set: stock.min_mm=[0,-10,-30])
(set: stock.max_mm=[30,10,0])
(set: cutting.linear_edge.tangential_cutting_n_per_mm2=600)
(set: cutting.linear_edge.tangential_edge_n_per_mm=0)
(set: cutting.linear_edge.radial_cutting_n_per_mm2=200)
(set: cutting.linear_edge.radial_edge_n_per_mm=0)
(set: tool.teeth=2)
(set: tool.modes=[{direction: [1, 0, 0], frequency_hz: 922, damping_ratio: 0.011, mass_kg: 0.03993}])
(set: exchange.period_ms=0.255555556)
G21 G90 G17
T1 M6 (flat end mill D10)
S15000 M3
G0 X-12 Y0 Z5
G1 Z-0.6 F1500
X14
G0 Z5
M30
