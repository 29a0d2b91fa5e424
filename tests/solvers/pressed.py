"""A mass that is pressed onto a contact by a force over time, split at all its events with SciPy.

The damping of the contact refers to the fastest approach since touchdown. The integration stops where the contact
begins and ends, where its approach becomes the fastest so far, where it is so no more, and where the force has kinks.
"""

import numpy as np
from scipy.integrate import solve_ivp


def pressed(gap, rate, times, forces, *, mass, stiffness, factor):
    """Gap [m] and its rate [m/s] at the last of `times`, and the numbers of events by name.

    **Arguments:** `gap` and `rate` at the first of the `times` [s]; `forces`: on the mass away from the contact there
    [N], linear between them; `stiffness`: [N/m^1.5]; `factor`: c of Eq. (12).
    """
    state, reference, mode = np.array([gap, rate]), 0.0, "open"
    counts = dict.fromkeys(("begins", "leads", "holds", "ends"), 0)

    def acceleration(t, y):
        ratio = 1.0 if mode == "leads" else y[1] / reference if mode == "holds" else 0.0
        depth = max(-y[0], 0.0) if mode != "open" else 0.0
        contact = max(stiffness * depth**1.5 * (1 + factor * ratio), 0.0)
        return (np.interp(t, times, forces) + contact) / mass

    def event(function, direction):
        function.terminal, function.direction = True, direction
        return function

    while times[0] < times[-1]:
        events = {
            "open": {"begins": event(lambda t, y: y[0], -1)},
            "holds": {
                "ends": event(lambda t, y: y[0], 1),
                "leads": event(lambda t, y, rate=reference: y[1] - rate, -1),
            },
            "leads": {"holds": event(lambda t, y: acceleration(t, y), 1)},
        }[mode]
        found = solve_ivp(
            lambda t, y: [y[1], acceleration(t, y)],
            (times[0], times[1]),
            state,
            "DOP853",
            rtol=1e-13,
            atol=1e-16,
            max_step=(times[1] - times[0]) / 50,
            events=list(events.values()),
        )
        state, now = found.y[:, -1], found.t[-1]
        if found.status == 0:
            times, forces = times[1:], forces[1:]
            continue
        forces = np.append(np.interp(now, times, forces), forces[1:])
        times = np.append(now, times[1:])
        name = next(name for name, at in zip(events, found.t_events, strict=True) if len(at))
        counts[name] += 1
        mode = {"begins": "holds", "ends": "open"}.get(name, name)
        if name in ("begins", "holds"):
            reference = state[1] * (1 + 1e-13)  # so that rounding does not find the same rate to be faster
        if name == "begins" and acceleration(now, state) < 0:
            mode = "leads"
    return state, counts
