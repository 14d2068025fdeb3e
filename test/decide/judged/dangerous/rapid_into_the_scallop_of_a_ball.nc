(expect: stop rapid in material)
(set: stock.max_mm=[30,10,0])
(a flat end would have cut the walls beside the groove of the ball)
G21 G90 G17
(T1 D=10. CR=5. - BALL END MILL)
T1 M6
S8000 M3
G0 X-8 Y0 Z5
G0 Z-2
G1 X20 F500
G0 Y4
G0 Z5
M30
