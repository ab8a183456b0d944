# scipy's integrators on the lumped model in its loop: Eqs 1 to 4 with the published radius, PI, the pressure limited. They begin
# anew where a cubic of the reference begins or ends, lest they step over it.
scipy = package("scipy")
from math import cos, nan, pi, sqrt, tan

from scipy.integrate import solve_ivp


def prepared(case, method, tolerance):
    f = case["free"]
    L, R, m, I = f["length"], f["radius"], f["mass"], f["inertia"]
    ke, kt, ce, ct = f["axial_stiffness"], f["torsional_stiffness"], f["axial_damping"], f["torsional_damping"]
    G, kp, ki, limit = f["gamma"], case["proportional"], case["integral"], case["limit"]
    cos_rest, turns = cos(G), L * tan(G) / R
    move, slot = TASK["move"], TASK["slot"]
    goals = [0.0] + TASK["goals"]

    def piece(k, begin, end):
        """The slopes between two times, on which the reference is a cubic (move) or stands."""
        low, high = goals[k], goals[k + 1]

        def slopes(t, y):
            s, phi, ds, dphi, integral = y
            u = min(max((t - k * slot) / move, 0.0), 1.0)
            error = low + (high - low) * u * u * (3.0 - 2.0 * u) - phi
            pressure = min(max(kp * error + ki * integral, 0.0), limit)
            c = (1.0 + s / L) * cos_rest
            if not (abs(c) < 1.0 and turns + phi < 0.0):
                return [nan] * 5  # beyond the kinematics: the step is refused
            q = -c / sqrt(1.0 - c * c)  # cot g, of an L FREE
            r = L / q / (turns + phi)
            a = pi * r * r * pressure
            force = m * 9.81 - ke * s - ce * ds + a * (1.0 - 2.0 * q * q)
            moment = -kt * phi - ct * dphi - 2.0 * a * r * q
            return [ds, dphi, force / m, moment / I, error]

        times = [t for t in TASK["times"] if begin < t <= end + 1e-9]
        return slopes, begin, max(end, times[-1]), times

    pieces = []
    for k in range(len(goals) - 1):
        pieces += [piece(k, k * slot, k * slot + move), piece(k, k * slot + move, (k + 1) * slot)]

    def solve():
        state, rotations = [0.0] * 5, [0.0]
        for slopes, begin, end, times in pieces:
            found = solve_ivp(slopes, (begin, end), state, method, times, rtol=tolerance, atol=1e-3 * tolerance)
            if not found.success:
                raise ArithmeticError(found.message)
            rotations += list(found.y[1])
            state = found.y[:, -1]
        return rotations

    return solve


for case in TASK["cases"]:
    for method in TASK["methods"]:
        for tolerance in TASK["tolerances"]:
            name = f"{case['name']}, {method}, rtol {tolerance:g}"
            try:
                rotations, least = best(lambda: prepared(case, method, tolerance), 0.0)
                tell(task=case["name"], case=name, time_s=least, values=rotations)
            except Exception as error:
                tell(task=case["name"], case=name, failed=str(error))
