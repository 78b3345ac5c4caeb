"""Short windings whose plan takes little time, as seeds of hostile ones.

Most of a case's time goes into the plan of a winding that is accepted: circuits, patterns, seven
distances of the eye, and the replay that checks them. So these windings have few circuits, one
distance of the eye and a wide tolerance.
"""

from __future__ import annotations

_BAND = """[band]
width = "18 mm +- 0.2 mm"
thickness = "0.3 mm"
tex = 7200
[friction]
value = "0.25 +- 0.05"
[fibre]
speed = "300 mm/s"
take_up = "50 mm"
clearance = "2 mm"
envelope = "15 mm"
tolerance = "0.5 mm"
tension = "40 N"
[coverage]
"""
_HOOP = f"""[mandrel]
at = "100 mm +- 0.1 mm"
[[part]]
kind = "cylinder"
radius = "40 mm"
length = "120 mm"
{_BAND}begin = "30 mm"
end = "90 mm"
[[layer]]
kind = "hoop"
circuits = 1
tension = "10 N"
"""
_VESSEL = f"""[[part]]
kind = "hemisphere"
radius = "40 mm"
opening = "12 mm"
pole = "left"
[[part]]
kind = "cylinder"
radius = "40 mm"
length = "80 mm"
[[part]]
kind = "hemisphere"
radius = "40 mm"
opening = "12 mm"
pole = "right"
{_BAND}begin = "40 mm"
end = "115 mm"
gap = "0.2 mm"
[[layer]]
cover = "103 %"
circuits = 13
shift = 5
"""
SHORT: list[bytes] = [*[_HOOP.encode()] * 6, *[_VESSEL.encode()] * 2]
