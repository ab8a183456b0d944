# python-control's root locus of a FREE behind its regulator and its IMU under a PID: poles at every factor on the gains.
control = package("control")
from math import pi, tan

import numpy

radius, gamma = TASK["radius"], TASK["gamma"]
actuation = 2.0 * pi * radius**3 / abs(tan(gamma))
s = control.tf("s")
plant = actuation / (TASK["inertia"] * s**2 + TASK["damping"] * s + TASK["stiffness"])
pid = (1 + TASK["seen"] * s) * (TASK["proportional"] + TASK["integral"] / s)
pid += TASK["derivative"] * s / (1 + s / (2.0 * pi * TASK["filter"]))
delay = control.tf(*control.pade(TASK["delay"], 3))
loop = control.minreal(plant / (1 + TASK["lag"] * s) * pid * delay, verbose=False)
factors = numpy.array(TASK["factors"])
answer, least = best(lambda: lambda: control.root_locus_map(loop, factors))
# Real and imaginary part in turn, factor by factor.
values = [float(x) for row in answer.loci for z in row for x in (z.real, z.imag)]
tell(task="root locus", case=f"root locus at {len(factors)} gains", time_s=least, values=values)
