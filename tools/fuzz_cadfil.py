"""Files of CADFIL as seeds: paths as its help describes them and as CADFIL 9 writes them."""

from __future__ import annotations

from collections.abc import Mapping

_FIB = b"""    16
 MADE.MND
    24
     4
    1  -120.0000      .0000    30.0000   .0000000  1.0000000   .0000000
    2  -110.0000    20.0000    40.0000   .2672612   .8017837  -.5345225
   24      .0000    50.0000    10.0000   .6000000   .1568926  -.7844629
   55    10.0733    51.5000      .0000   .6577299   .0983193  -.7468095
"""
_PAY = b"""    22 0 1 1 1 1 1
 MADE.MND
    42    24   .120000E+02   .250000E+01   .160072E+02
     2
  -120.000      .000    30.000  .0000000 1.0000000  .0000000  .0000000  .0000000 -1.000000
  -119.000    60.000    31.000    61.000
   10.0000    51.500      .000  .6577299  .0983193 -.7468095  .0000000  .0000000  .0000000
    60.000    70.000    -30.00    65.000
"""
# As CADFIL 9 writes them: settings and notes between the lines that its help describes.
_PAY_9 = b"\n".join(
    [*_PAY.split(b"\n")[:3], b"$MVL-R1=50.000", b"$FIBER-TEX=800.000", b"       2", b"ANR05", b""]
) + b"\n".join(_PAY.split(b"\n")[4:])
_FIB_9 = _FIB.replace(b"    24\n     4\n", b" 24 4\n$NELE=4\n")
_MND = b"""XRDATA   (CADFIL AXISYMMETRIC)
     0          (SYMMETRY FLAG)
     6          (NO. OF MANDREL DATA POINTS)
   -140.0000        0.000000         0    0.000000
   -135.0000        20.00000         0    0.000000
   -120.0000        40.00000         0    0.000000
   -100.0000        50.00000        17    0.000000
    60.00000        50.00000         0    0.000000
    80.00000        42.00000         0    0.000000
     2          (NO. OF ENVELOPE DATA POINTS)
   -150.0000        70.00000         0    0.000000
    150.0000        70.00000         0    0.000000
"""

CADFIL: Mapping[str, list[bytes]] = {
    "fib": [_FIB, _FIB_9],
    "pay": [_PAY, _PAY_9],
    "ctl": [
        b" 1\n MADE.PAY 2\n",
        b"C:\\WIND\\A.PAY, 1, 20.0, 2\nb.pay\n",
        b" SPCTL2\n2\n1\nmade.pay\n1000.000000\n2\n\n\n1\nmade.pay\n5000.000000\n1\n\n\n",
    ],
    "mnd": [_MND],
}
"""Seeds by the ending of the file; the first payout path stands beside each control file."""
