"""Filters as they are typed."""

import math

import pytest

from kedge.config.filters import build_filter, split_names
from kedge.core.errors import ConfigError, UnknownName
from kedge.filters.gaussian.extended import ExtendedKalman
from kedge.filters.gaussian.unscented import UnscentedKalman
from kedge.filters.particle.bootstrap import BootstrapParticle


def test_filters_from_what_is_typed():
    assert isinstance(build_filter("extended"), ExtendedKalman)
    particle = build_filter("particle: count=50, threshold=1")
    assert isinstance(particle, BootstrapParticle)
    assert (particle.count, particle.threshold) == (50, 1.0)
    assert type(particle.threshold) is float


def test_a_recovery_is_switched_off_by_infinity():
    assert build_filter("gated:recovery=inf").recovery_time() == math.inf
    assert build_filter("gated:recovery=3").recovery_time() == 3.0


def test_a_filter_in_a_filter():
    assert isinstance(build_filter("gated:inner=unscented").inner, UnscentedKalman)
    gated = build_filter(
        "gated: inner=(robust:tuning=3, inner=(particle:count=7)), false_alarm=0.05"
    )
    assert (gated.false_alarm, gated.inner.tuning, gated.inner.inner.count) == (
        0.05,
        3.0,
        7,
    )


def test_names_are_split_at_the_commas_between_filters():
    assert split_names("extended, particle:count=5,threshold=1, kalman+smoother") == [
        "extended",
        "particle:count=5,threshold=1",
        "kalman+smoother",
    ]
    nested = "gated:inner=(particle:count=5,threshold=1),false_alarm=0.1"
    assert split_names(f"{nested},gated:inner=unscented:alpha=0.5") == [
        nested,
        "gated:inner=unscented:alpha=0.5",
    ]


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("particle:cuont=5", "no parameter of particle called 'cuont' (did you mean 'count'?)"),
        ("particle:count=5.0", "count: found '5.0', expected a whole number"),
        ("particle:count=many", "count: found 'many', expected a whole number"),
        ("particle:threshold=True", "threshold: found 'True', expected a number"),
        ("particle:count", "found 'count', expected PARAMETER=VALUE"),
        ("particle:count=5,count=6", "found 'count' twice"),
        ("particle:count=1", "particle: count is 1, must be at least 2"),
        ("gated:inner=(particle:cuont=5)", "no parameter of particle called 'cuont'"),
        ("extended:count=1", "no parameter of extended called 'count'; there are none"),
    ],
)
def test_filters_that_cannot_be_built(spec, message):
    with pytest.raises(ConfigError) as caught:
        build_filter(spec)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"filter {spec!r}")


def test_an_unknown_filter():
    with pytest.raises(UnknownName, match=r"no filters called 'extendet' \(did you mean"):
        build_filter("extendet")
