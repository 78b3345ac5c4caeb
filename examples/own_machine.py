"""Read machines of the library, and prove one job on the machine as built and as modified.

`lathe-winder+physical` is the library's winder with an overlay: a few numbers of the file changed.
Run it from the root of the repository: python examples/own_machine.py
"""

import threadline as tl

for name in ("lathe-winder", "lathe-winder+physical"):
    machine = tl.load_machine(name)
    proof = tl.prove("examples/x-180.prg", machine, interpolation="linear", level="nominal")
    error = proof.result("contour_error")
    print(f"{machine.name}, axes {', '.join(machine.axis_names)}: {1e3 * error.measured:.3f} mm")
