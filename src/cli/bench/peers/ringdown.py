# scipy's curve_fit on plucks: offset and one decaying oscillation, from the values that a log decrement gives.
scipy = package("scipy")
import numpy
from scipy.optimize import curve_fit


def model(t, offset, a, b, decay, omega):
    return offset + numpy.exp(-decay * t) * (a * numpy.cos(omega * t) + b * numpy.sin(omega * t))


for number, pluck in enumerate(TASK["plucks"]):
    times, angles = numpy.array(pluck["times"]), numpy.array(pluck["angles"])
    times = times - times[0]
    offset = angles[len(angles) // 2 :].mean()
    start = [offset, angles[0] - offset, 0.0, pluck["decay"], pluck["omega"]]
    name = f"{TASK['name']}, FREE {number + 1}"
    try:
        found, least = best(lambda: lambda: curve_fit(model, times, angles, start)[0], 0.0)
        tell(task=TASK["name"], case=name, time_s=least, values=[float(found[3]), abs(float(found[4]))])
    except Exception as error:
        tell(task=TASK["name"], case=name, failed=str(error))
