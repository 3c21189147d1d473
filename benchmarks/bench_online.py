"""One event online: the same estimator by machine code and by XLA."""

import time

import jax
import jax.numpy as jnp
import numpy as np

import kedge

PUSHES = 300


def test_push(times):
    vehicle = kedge.make_vehicle("unicycle", speed_noise=0.1, yaw_rate_noise=0.02)
    gnss = kedge.make_sensor("gnss", std=1.0)
    prior = kedge.Gaussian(vehicle.start(), 0.1 * jnp.eye(3))
    rig = kedge.Rig(vehicle, (kedge.Installation("gnss", gnss),), prior)
    fix = gnss.measures(np.zeros(2))
    found = {}
    for engine in ("native", "xla"):
        estimator = kedge.Estimator(kedge.make_filter("extended"), rig, engine=engine)
        taken = []
        for i in range(PUSHES):
            begin = time.perf_counter()
            answer = estimator.push(0.1 * (i + 1), "gnss", fix)
            jax.block_until_ready(answer.moments)
            taken.append(time.perf_counter() - begin)
        found[engine] = min(taken[10:]), answer
    np.testing.assert_allclose(
        found["native"][1].moments.cov, found["xla"][1].moments.cov, rtol=1e-9
    )
    times.row("push, unicycle with GNSS", "kedge by XLA", found["xla"][0], found["native"][0])
