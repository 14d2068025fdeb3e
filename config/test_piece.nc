%
; Contouring test piece in the manner of ISO 10791-7, in a size for the cell, aluminium.
; Stock 100 x 100 mm about the origin, its top at Z0, at least 10 mm high.
; Tool: end mill of 20 mm diameter, 4 teeth. The paths are those of its centre: 10 mm outside of the contours.
; The tool runs clockwise round the part, so the clockwise spindle mills down (climb milling).
; Every level is entered from outside the stock or along a tangent. No point needs a cutter compensation.
;
; feature        contour, mm                                                    level   depth of cut
; square         outside square 80 x 80, sides parallel to X and Y              Z-1.2   1.2 (half immersion)
; clearing       corners of the square outside of radius 46.5                   Z-0.8   0.8
; circle         diameter 54                                                    Z-0.4   0.4
; diamond        square of side 56.5685 turned by 45 deg, its corners in the
;                middles of the sides of the outside square                     Z-0.8   0.4 to 0.8
; inclined_side  from X-40 Y-40 to X40 Y-44.1926, 3 deg to the side of the square  Z-1.6   0.4
;
; Arc centres I, J are counted from the start of the arc.
N10 G17 G21 G40 G49 G54 G80 G90 G94
N20 S8000 M3
N30 G0 X-70 Y50 Z5
(square)
N100 G0 Z-1.2
N110 G1 X40 F4000
N120 G2 X50 Y40 I0 J-10
N130 G1 Y-40
N140 G2 X40 Y-50 I-10 J0
N150 G1 X-40
N160 G2 X-50 Y-40 I0 J10
N170 G1 Y70
N180 G0 Z5
(clearing)
N200 G0 X56.5 Y0
N210 G0 Z-0.8
N220 G2 I-56.5 J0
N230 G0 Z5
(circle)
N300 G0 X37 Y60
N310 G0 Z-0.4
N320 G1 Y0
N330 G2 I-37 J0
N340 G1 Y-60
N350 G0 Z5
(diamond)
N400 G0 X-70 Y-15.8579
N410 G0 Z-0.8
N420 G1 X0 Y54.1421
N430 G1 X54.1421 Y0
N440 G1 X0 Y-54.1421
N450 G1 X-70 Y15.8579
N460 G0 Z5
(inclined_side)
N500 G0 X70 Y-55.7786
N510 G0 Z-1.6
N520 G1 X-70 Y-48.4415
N530 G0 Z5
N540 M5
N550 M30
%
