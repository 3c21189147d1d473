"""``kedge compare --smooth``."""

from kedge.apps.workflow import with_smoothers


def test_all_that_can_be_smoothed_are_once():
    names = [
        "extended",
        "unscented",
        "particle",
        "extended+smoother",
        "gated:inner=etkf",
    ]
    assert with_smoothers(names) == [
        *names,
        "unscented+smoother",
        "gated:inner=etkf+smoother",
    ]
