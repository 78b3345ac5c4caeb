"""Words, numbers and units that are odd, and bytes that are changed at random."""

from __future__ import annotations

import random

TOKENS = """
G0 G1 G01 G4 G20 G21 G28 G64 G90 G91 G93 G94 G2 G61.1 G-1 G1e2 M0 M00 M2 M5 M30 M98 M99 M6
P1 P999 P0.5 P-1 P L1 L0 L3 L1000000000 L1e9 O1 O999 O998 O O-1 N10 N N1.5 F100 F0 F-1 F
F12000 F1e400 X1 X-1 X+.5 X. X X1.2.3 X--1 Xnan Xinf X1e400 X1,5 A10.13 A Y5 Y5 Z1 B1 C1 S500
T1 E5 U1 #1=2 X#1 X[1+2] [ ] / /X1 % ; ;; ; X1 ( ) (a) (a (b (a)) ((a)) (% ;a=1 ;a=b ;a=1e9
""".split()  # noqa: SIM905 - a table of words
NUMBERS = """
0 1 -1 0.1 1e400 -1e400 nan inf -inf 1e-400 9999999999999999999999 0.00000000000000000001
1/0 1,5 --1 +-1 0x10 1_000 ١٢٣ ² ½ 1e 1e+ .e1 . 1.2.3 NaN Infinity 007 1e309 2**99
""".split()  # noqa: SIM905 - a table of words
UNITS = """
mm m in ft s ms us min h Hz kHz MHz deg rad rev count count/mm count/deg count/tick tick dac
dac/count kg kg*m^2 kg m^2 N N*m N/m V A ohm H % percent rpm m/s mm/s mm/min m/s^2 m/s^3 bar
/ // ^ ** *** m^ m^^2 m^1e9 m^999999 ( ) (m (m/s)/s () m/0 0 1/s kilo mega mm/mm/mm m·s m² e
((((m/mm)^9)^9)^9)^9 m*9**9**9 m^9^9^9
pi delta_degC dimensionless [length] a_b __class__ import lambda 1e9m m1e9 µs μs µ µµs
""".split()  # noqa: SIM905 - a table of words
BYTES = [0, 9, 10, 13, 26, 27, 32, 34, 37, 40, 41, 44, 46, 59, 61, 91, 92, 127, 128, 0xC3, 0xFF]


def mutate(rng: random.Random, data: bytes) -> bytes:
    """Cut, repeat, swap, overwrite and insert; now and then another encoding."""
    out = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3, 8))):
        at = rng.randrange(len(out) + 1)
        span = rng.choice((1, 1, 2, 5, 40))
        kind = rng.randrange(8)
        if kind == 0:
            out[at : at + span] = b""
        elif kind == 1:
            out[at:at] = out[at : at + span]
        elif kind == 2:
            out[at:at] = bytes(rng.choices(BYTES, k=rng.choice((1, 1, 3))))
        elif kind == 3:
            out[at:at] = rng.choice(TOKENS).encode()
        elif kind == 4:
            out[at : at + span] = rng.choice(NUMBERS).encode()
        elif kind == 5:
            out[at : at + 1] = bytes([rng.randrange(256)])
        elif kind == 6:
            other = rng.randrange(len(out) + 1)
            out[at:at] = out[other : other + 3 * span]
        else:
            del out[at:]
    text = bytes(out)
    wild = rng.randrange(200)
    if wild == 0:
        return text.decode("latin-1").encode("utf-16")
    if wild == 1:
        return text + text[:200] * rng.choice((10, 300))
    if wild == 2:
        return rng.randbytes(rng.randrange(300))
    return text
