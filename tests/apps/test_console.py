"""What commands print."""

import warnings

from kedge.apps.console import plain_warnings


def test_a_warning_is_one_line_for_users_and_as_ever_for_programmers(capsys):
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        with plain_warnings():
            warnings.warn("the box straddles zero", stacklevel=1)
            warnings.warn("an old name", DeprecationWarning, stacklevel=1)
        usual = warnings.showwarning
    first, *rest = capsys.readouterr().err.splitlines()
    assert first == "kedge: warning: the box straddles zero"
    assert "DeprecationWarning: an old name" in rest[0]
    assert usual.__module__ == "warnings"
