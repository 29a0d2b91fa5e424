"""Cases with a known optimum, in place of simulations."""

import numpy as np

from slipperjax.design.judge import Judged


def judged(self, designs, memory):
    """`Problem.judged` of a bowl: lowest at 1 mm and 0.31 m between the bounds of the tests; chaos above 1500 m/s."""
    values = np.repeat(self.values(designs), self.count, axis=0)
    speed = np.tile(self.cases.get("speed", np.array([1250.0])), len(designs))
    unit = (values - self.low) / self.width
    apart = unit - np.array([0.8 / 2.8, 0.5, 0.5])[: unit.shape[1]]
    total = 1e4 * (1 + np.sum(apart**2, axis=1)) * speed / 1000
    slope = 2e4 * apart / self.width * speed[:, None] / 1000
    count, many = len(speed), len(self.question.objectives)
    irregular = speed > 1500
    error = np.where(irregular, 100.0, 0.0)[:, None] * np.ones(many)
    found = dict(
        status=np.zeros(count, int),
        period=np.where(irregular, 0, 1),
        multiplier=np.where(irregular, np.nan, 0.5),
        state=np.zeros((count, 20)),
        value=total[:, None] * np.ones(many),
        gradient=slope[:, None, :] * np.ones((many, 1)),
        stderr=error,
        gradient_stderr=error[..., None] * np.ones(unit.shape[1]),
        inverse=np.full((count, 20, 20), np.nan),
        simulated=np.full(count, 200.0),
    )
    return Judged(**{name: found[name] for name in Judged._fields})
