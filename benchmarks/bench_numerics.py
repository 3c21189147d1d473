"""Full covariance with Joseph's form beside square roots: time, and digits that are left.

Accuracy is against the same recursion in 60 digits. The table of docs/why/numerics.md is what
this prints.
"""

import functools as ft

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest

import kedge
from kedge.filters.gaussian.square_root import SquareRootKalman
from kedge.sensors.gnss import Gnss, Measurement
from kedge.sensors.landmarks import Landmark, Landmarks
from kedge.sensors.landmarks import Measurement as Sight
from kedge.vehicles import constant_velocity, unicycle

STEPS, BATCH, DT = 200, 1000, 0.1
FORMS = {"covariance": kedge.make_filter}
FORMS["square root"] = lambda name: SquareRootKalman(kedge.make_filter(name))


def cast(tree, dtype):
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), tree)


def runner(filter, vehicle, sensor, control, seen, dtype, dt=DT, steps=STEPS):
    """One run from a prior: ``steps`` predictions and updates, then the last belief."""
    key = jax.random.key(0)
    control, seen, dt = cast(control, dtype), cast(seen, dtype), jnp.asarray(dt, dtype)

    def run(prior):
        def cycle(belief, _):
            belief = filter.predict(vehicle, belief, control, dt, key)
            return filter.update(sensor, belief, seen, key)[0], None

        belief, _ = jax.lax.scan(cycle, filter.init(prior, key), length=steps)
        return belief.moments()

    return run


@pytest.mark.parametrize("dtype", [jnp.float64, jnp.float32], ids=["64", "32"])
@pytest.mark.parametrize("name", ["extended", "unscented"])
def test_time(times, name, dtype):
    vehicle, control = unicycle.Unicycle(), unicycle.Control(1.0, 0.1)
    sensor = Landmarks(target=Landmark(jnp.array([[5.0, 4.0]], dtype))).for_target(0)
    prior = cast(kedge.Gaussian(vehicle.start(), 0.1 * jnp.eye(3)), dtype)
    many = jax.tree.map(lambda leaf: jnp.stack([leaf] * BATCH), prior)
    found = {}
    for form, make in FORMS.items():
        run = runner(make(name), vehicle, sensor, control, Sight(6.0, 0.5), dtype)
        for batch, call in (("alone", run), (f"in {BATCH}", jax.vmap(run))):
            call = jax.jit(call)
            given = prior if batch == "alone" else many
            jax.block_until_ready(call(given))
            _, seconds = times.best(lambda c=call, g=given: jax.block_until_ready(c(g)), 7)
            runs = 1 if batch == "alone" else BATCH
            found[form, batch] = seconds / STEPS / runs * 1e6
    for batch in ("alone", f"in {BATCH}"):
        full, root = found["covariance", batch], found["square root", batch]
        bits = jnp.finfo(dtype).bits
        times.note(
            f"{name}, float{bits}, {batch}: covariance {full:.3f} us a step, square root "
            f"{root:.3f} us ({root / full:.2f}x)"
        )


CASES = {
    # prior variances of position and velocity, noise of the reading, of the motion, steps
    "usual": (1.0, 1.0, 0.5, 0.1, 200),
    "unknown start": (1e6, 1e2, 1e-2, 1e-2, 200),
    "R = 1e-12": (1e4, 1e2, 1e-6, 1e-2, 200),
    "R = 1e-12, 10,000 steps": (1.0, 1.0, 1e-6, 1e-2, 10_000),
    "calm and exact": (1e6, 1e2, 1e-6, 1e-6, 200),
}


@ft.cache
def exact(case):
    """One axis of the covariance in 60 digits; the recursion settles long before 2,000."""
    mpmath.mp.dps = 60
    place, pace, std, density, steps = (mpmath.mpf(value) for value in CASES[case])
    dt = mpmath.mpf(DT)
    F = mpmath.matrix([[1, dt], [0, 1]])
    G = mpmath.matrix([dt**2 / 2, dt])
    P, Q = mpmath.matrix([[place, 0], [0, pace]]), G * G.T * (density**2 / dt)
    H = mpmath.matrix([[1, 0]])
    for _ in range(min(int(steps), 2000)):
        P = F * P * F.T + Q
        P = P - P * H.T * H * P / (P[0, 0] + std**2)
    return np.array(P.tolist(), float)


def by_dynamax(case):
    """One axis of the same recursion by dynamax, which updates by P - K S K^T."""
    inference = pytest.importorskip("dynamax.linear_gaussian_ssm.inference")
    place, pace, std, density, steps = CASES[case]
    F = np.array([[1, DT], [0, 1]])
    G = np.array([[DT**2 / 2], [DT]])
    Q = G @ G.T * density**2 / DT
    first = F @ np.diag([place, pace]) @ F.T + Q  # its first state is at the first reading
    none = jnp.zeros((2, 0))
    params = inference.ParamsLGSSM(
        inference.ParamsLGSSMInitial(jnp.zeros(2), jnp.asarray(first)),
        inference.ParamsLGSSMDynamics(
            jnp.asarray(F), jnp.zeros(2), none, jnp.asarray(Q)
        ),
        inference.ParamsLGSSMEmissions(
            jnp.array([[1.0, 0.0]]), jnp.zeros(1), none[:1],
            jnp.array([[std**2]]),
        ),
    )  # fmt: skip
    found = inference.lgssm_filter(params, jnp.zeros((steps, 1)))
    return found.filtered_covariances[-1]


def told(cov, answer):
    """The largest relative error, and whether the matrix is a covariance at all."""
    scale = np.sqrt(np.outer(np.diag(answer), np.diag(answer)))
    off = np.abs((cov - answer) / scale).max()
    lowest = np.linalg.eigvalsh(cov / scale).min() if np.isfinite(off) else off
    return off, f"{off:.0e}" + ("" if lowest >= -1e-15 else " (indefinite)")


@pytest.mark.filterwarnings("ignore")  # dynamax imports what JAX will remove
@pytest.mark.parametrize("case", CASES)
def test_digits(times, case):
    place, pace, std, density, steps = CASES[case]
    vehicle = constant_velocity.ConstantVelocity(density)
    start = constant_velocity.State(jnp.zeros(2), jnp.zeros(2))
    prior = kedge.Gaussian(start, jnp.diag(jnp.array([place, place, pace, pace])))
    answer, seen = exact(case), Measurement(jnp.zeros(2))
    texts = []
    for dtype in (jnp.float64, jnp.float32):
        bits = jnp.finfo(dtype).bits
        for name in ("kalman", "cubature"):
            for form, make in FORMS.items():
                run = runner(make(name), vehicle, Gnss(std=std), (), seen, dtype, steps=steps)
                cov = np.asarray(jax.jit(run)(cast(prior, dtype)).cov, float)[::2, ::2]
                off, text = told(cov, answer)
                texts.append(f"{name}, {form}, float{bits}: {text}")
                if dtype == jnp.float64:
                    assert off < 1e-3
    texts.append(f"dynamax, float64: {told(np.asarray(by_dynamax(case)), answer)[1]}")
    times.note(f"{case}: largest relative error of the covariance\n    " + "\n    ".join(texts))
