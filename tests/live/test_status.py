import pytest

from kedge.live.status import Limits, Status, reasons_of

SOURCE = {
    "name": "camera", "nominal": 2.0, "silent": 0.2, "offset": 0.0, "count": 10,
    "refused": 0.0, "span": 5.0,
}  # fmt: skip
GOOD = {"deviation": 0.3, "aligned": True, "since_fused": 0.2, "limits": Limits()}


@pytest.mark.parametrize(
    ("source", "estimate", "level", "value"),
    [
        ({}, {"aligned": False, "deviation": 0.9}, "ALIGNING", "0.90 m (needs 0.60 m)"),
        ({"silent": 3.1}, {}, "DEGRADED", "silent for 3.1 s (allowed 2.0 s)"),
        ({"offset": 3.0}, {}, "DEGRADED", "+3.00 s behind (limit 0.50 s)"),
        ({"refused": 0.4}, {}, "DEGRADED", "40 % refused in 5 s (limit 25 %)"),
        ({}, {"since_fused": 2.5}, "DEAD_RECKONING", "for 2.5 s (limit 2.0 s)"),
        ({"refused": 1.0}, {"since_fused": 4.5}, "LOST", "for 4.5 s (limit 4.0 s)"),
        ({}, {"deviation": 3.2}, "LOST", "3.2 m (limit 3.0 m)"),
    ],
)
def test_each_reason_gives_its_value_and_its_limit(source, estimate, level, value):
    worst = reasons_of([SOURCE | source], [True], **(GOOD | estimate))[0]
    assert worst.level == level
    assert value in worst.text


def test_nothing_wrong_is_no_reason():
    assert reasons_of([SOURCE], [True], **GOOD) == []


def test_without_a_source_of_positions_it_is_dead_reckoning():
    assert reasons_of([SOURCE], [False], **GOOD)[0].level == "DEAD_RECKONING"


def test_a_status_is_quick_to_worsen_slow_to_recover_and_does_not_flap():
    lost = reasons_of([SOURCE], [True], **(GOOD | {"deviation": 9.0}))
    status = Status(0.0, Limits())
    changes = []
    for step in range(1, 100):
        now = step / 10
        # Lost from 3 s to 6 s; for one step at 7.5 s as well.
        holds = 3.0 <= now < 6.0 or step == 75
        if change := status.update(lost if holds else [], now):
            changes.append((change["to"], now))
        if now == 5.0:
            assert status.reasons[0]["since"] == 3.0
    assert changes == [("OK", pytest.approx(1.1)), ("LOST", 3.3), ("OK", 7.0)]
