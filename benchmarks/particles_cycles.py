"""Cycles of particle filters in `particles`, run by bench_particle in its own environment.

Reads cases as JSON on standard input, writes seconds a cycle and the means on standard output.
"""

import json
import sys
import time

import numpy as np
import particles
from particles import distributions as dists
from particles import state_space_models as ssm
from particles.collectors import Moments


class Linear(ssm.StateSpaceModel):
    """x' = a x + w, z = x + v, and the optimal proposal."""

    def PX0(self):  # the state at the first reading, which comes after one step
        return dists.Normal(loc=0.0, scale=np.sqrt(self.a**2 * self.start**2 + self.q**2))

    def PX(self, t, xp):
        return dists.Normal(loc=self.a * xp, scale=self.q)

    def PY(self, t, xp, x):
        return dists.Normal(loc=x, scale=self.r)

    def _fit(self, mean, scale, seen):
        variance = 1 / (1 / scale**2 + 1 / self.r**2)
        loc = variance * (mean / scale**2 + seen / self.r**2)
        return dists.Normal(loc=loc, scale=np.sqrt(variance))

    def proposal0(self, data):
        first = self.PX0()
        return self._fit(0.0, first.scale, data[0])

    def proposal(self, t, xp, data):
        return self._fit(self.a * xp, self.q, data[t])


def run(case):
    kind = {"particle": ssm.Bootstrap, "guided": ssm.GuidedPF}[case["filter"]]
    model = Linear(**{name: case[name] for name in ("a", "q", "r", "start")})
    readings = np.array(case["readings"])
    fk = kind(ssm=model, data=readings)
    shortest = np.inf
    for _ in range(case["repeats"]):
        filter = particles.SMC(
            fk=fk, N=case["count"], resampling="systematic", ESSrmin=0.5, collect=[Moments()]
        )
        before = time.perf_counter()
        filter.run()
        shortest = min(shortest, time.perf_counter() - before)
    means = [float(moment["mean"]) for moment in filter.summaries.moments]
    return {"seconds": shortest / len(readings), "means": means}


if __name__ == "__main__":
    np.random.seed(0)  # noqa: NPY002 - the package draws from the global generator
    json.dump([run(case) for case in json.load(sys.stdin)], sys.stdout)
