"""Times DAPPER's cycles; runs in an environment of DAPPER's own, which kedge is not in.

Reads cases from standard input, one JSON list; each has truth and readings, so that both
libraries do the same. Diagnostics are left out: a cycle is forecast, analysis, inflation.
"""

import contextlib
import io
import json
import sys
import time

import numpy as np

with contextlib.redirect_stdout(io.StringIO()):
    from dapper.da_methods.ensemble import EnKF_analysis, local_analyses, post_process
    from dapper.mods import Lorenz63, Lorenz96
    from dapper.tools.localization import nd_Id_localization
    from dapper.tools.randvars import GaussRV


def cycles(case):
    size, count, dt = case["size"], case["count"], case["dt"]
    step = (Lorenz63 if size == 3 else Lorenz96).step
    rng = np.random.default_rng(0)
    readings, truth = np.asarray(case["readings"]), np.asarray(case["truth"])
    E = np.asarray(case["start"]) + case["start_std"] * rng.standard_normal((count, size))
    noise = GaussRV(C=case["std"] ** 2, M=size)
    batches, taper = (None, None)
    if case["radius"] is not None:
        # DAPPER's radius is the standard deviation of the Gaussian that the taper resembles.
        localizer = nd_Id_localization((size,), (1,))
        batches, taper = localizer(case["radius"] / (2 * 1.82), "x2y", "GC")
    means, began = [], time.perf_counter()
    for reading in readings:
        for _ in range(case["substeps"]):
            E = step(E, 0.0, dt / case["substeps"])
        if batches is None:
            E = EnKF_analysis(E, E.copy(), noise, reading, case["method"])
        else:
            E, _ = local_analyses(E, E.copy(), noise.C, reading, batches, taper)
        E = post_process(E, case["inflation"], case["rotation"])
        means.append(E.mean(0))
    seconds = time.perf_counter() - began
    kept = slice(len(readings) // 3, None)
    error = np.sqrt(np.mean((np.array(means) - truth) ** 2, axis=1))[kept].mean()
    return {"seconds": seconds / len(readings), "rmse": error}


if __name__ == "__main__":
    found = []
    for case in json.load(sys.stdin):
        tries = [cycles(case) for _ in range(case["repeats"])]
        found.append(min(tries, key=lambda one: one["seconds"]))
    json.dump(found, sys.stdout)
