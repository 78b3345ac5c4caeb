"""The fastest motion through points: no job and no machine file, any unit of length.

Run it from the root of the repository: python examples/retime_points.py
"""

import numpy as np

import threadline as tl

square = [[0, 0], [1, 0], [1, 1], [0, 1], [0, 0]]

for tolerance in (0.001, 0.01, 0.1):
    motion = tl.retime(square, velocity=2, acceleration=10, jerk=500, tolerance=tolerance)
    print(f"corners cut by up to {tolerance}: {motion.duration_s:.3f} s")

times = np.linspace(0.0, motion.duration_s, 5)
print("places:", motion(times).round(3).tolist())
print("largest share of any limit:", round(float(motion.bound), 3))
