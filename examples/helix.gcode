; A circuit of 55 degrees on a tube of 100 mm, 300 mm long, for grbl: X along, A turns
; F counts a degree as a millimetre
G21
G90
G94
G1 X300 A490.961 F6000
G1 A690.961
G1 X0 A1181.922
G1 A1391.922
M30
