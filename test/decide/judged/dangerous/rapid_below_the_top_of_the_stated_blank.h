; (expect: stop rapid in material)
; (set: cutting.detail=engagement)
BEGIN PGM BLANK MM
; the blank stands 5 mm above the datum
BLK FORM 0.1 Z X+0 Y+0 Z-15
BLK FORM 0.2 X+60 Y+40 Z+5
TOOL CALL 1 Z S6000
; T1 D=10. CR=0. - flat end mill 2 flutes
L X-10 Y+20 R0 FMAX M3
L Z+6 FMAX
L Z+4 FMAX
L X+70 F800
L Y+10 F800
L Z+2 FMAX
L X+30 FMAX
L Z+50 FMAX M30
END PGM BLANK MM
