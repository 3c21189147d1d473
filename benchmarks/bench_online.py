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


def receiver():
    """A vehicle with three states and a gated receiver; one of its fixes."""
    vehicle = kedge.make_vehicle("unicycle", speed_noise=0.1, yaw_rate_noise=0.02)
    gnss = kedge.make_sensor("gnss", std=1.0)
    rig = kedge.Rig(
        vehicle,
        (kedge.Installation("gnss", gnss, gate=0.001),),
        kedge.Gaussian(vehicle.start(), 0.1 * jnp.eye(3)),
    )
    fix = gnss.measures(np.zeros(2))
    return rig, fix


def test_waiting(times):
    """Ten events that wait, in one call and one by one; and a fix 150 ms late at 100 Hz."""
    rig, fix = receiver()

    def made():
        estimator = kedge.Estimator(kedge.make_filter("extended"), rig, lag=2.0)
        estimator.ready()
        return estimator

    singly, many = made(), made()
    one, batch, late = [], [], []
    for i in range(PUSHES):
        events = [kedge.Event(0.1 * i + 0.01 * k) for k in range(1, 10)]
        events.append(kedge.Event(0.1 * (i + 1), "gnss", fix))
        rows = many.rows(events)
        begin = time.perf_counter()
        answers = many.push_many(rows)
        batch.append((time.perf_counter() - begin) / 10)
        begin = time.perf_counter()
        for event in events:
            answer = singly.push(event.time, event.sensor, event.measurement)
        one.append((time.perf_counter() - begin) / 10)
        assert answers["nis"][-1] == answer.outcome.nis
        begin = time.perf_counter()
        singly.push(singly.time - 0.15 - 1e-3, "gnss", fix)
        late.append(time.perf_counter() - begin)
        many.push(many.time - 0.15 - 1e-3, "gnss", fix)
    best = [float(np.median(taken[10:])) for taken in (one, batch, late)]
    times.row("ten waiting events, each", "kedge singly", best[0], best[1])
    times.row("a fix 150 ms late, 2 s window", "kedge on time", best[0], best[2])


def test_beside_a_push(times):
    """A refusal, a look ahead, a state as bytes, and 50 vehicles in turn in one thread."""
    rig, fix = receiver()
    fleet = [kedge.Estimator(kedge.make_filter("extended"), rig, lag=2.0) for _ in range(50)]
    for estimator in fleet:
        estimator.ready()
    first = fleet[0]
    calls = {
        "fused": lambda i: first.push(0.1 * (i + 1), "gnss", fix),
        "duplicate": lambda i: first.push(0.1 * (i + 1), "gnss", fix),
        "late": lambda i: first.push(-1.0, "gnss", fix),
        "future": lambda i: first.push(1e6, "gnss", fix),
        "peek": lambda i: first.peek(0.1 * (i + 1) + 0.05),
        "state": lambda i: first.state(),
        "fleet": lambda i: [one.push(0.1 * (i + 1), "gnss", fix) for one in fleet[1:]],
    }
    seconds = {name: [] for name in calls}
    for i in range(PUSHES):
        for name, call in calls.items():
            begin = time.perf_counter()
            answer = call(i)
            seconds[name].append(time.perf_counter() - begin)
            if name in ("fused", "duplicate", "late", "future"):
                assert answer.verdict.name == name.upper()
    median = {name: float(np.median(values[10:])) for name, values in seconds.items()}
    median["fleet"] /= len(fleet) - 1
    for title, name in {
        "a refusal: twice the same": "duplicate",
        "a refusal: too late": "late",
        "a refusal: of the future": "future",
        "a look ahead (peek)": "peek",
        "the state as bytes, 2 s window": "state",
        "one of 50 vehicles in turn": "fleet",
    }.items():
        times.row(title, "kedge push", median["fused"], median[name])
