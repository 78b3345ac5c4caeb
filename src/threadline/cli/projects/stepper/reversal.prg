( Reversal test: out by 180 mm and back, eight points each way, at 36 mm/s )
G21 G91 G94
G1 F2160 X25.716
X25.714
X25.714
X25.714
X25.714
X25.714
X25.714
X-25.714
X-25.714
X-25.714
X-25.714
X-25.714
X-25.714
X-25.716
M30
