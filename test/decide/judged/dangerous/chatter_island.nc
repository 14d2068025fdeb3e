(half immersion, down, 10000 rpm: an island of the mode of the tool from 2.106 to 2.345 mm)
(expect: stop chatter)
(set: stock.min_mm=[0,-10,-30])
(set: stock.max_mm=[30,10,0])
(set: cutting.linear_edge.tangential_cutting_n_per_mm2=600)
(set: cutting.linear_edge.tangential_edge_n_per_mm=0)
(set: cutting.linear_edge.radial_cutting_n_per_mm2=200)
(set: cutting.linear_edge.radial_edge_n_per_mm=0)
(set: tool.teeth=2)
(set: tool.modes=[{direction: [1, 0, 0], frequency_hz: 922, damping_ratio: 0.011, mass_kg: 0.03993}])
(set: exchange.period_ms=0.25)
G21 G90 G17
T1 M6 (flat end mill D10)
S10000 M3
G0 X42 Y-10 Z5
G0 Z-2.2
G1 X-12 F1000
G0 Z5
M30
