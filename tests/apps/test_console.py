"""What commands print."""

import warnings

from kedge.apps.console import plain_warnings


def test_a_warning_is_one_line_for_users_and_as_ever_for_programmers(capsys, monkeypatch):
    seen = []
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        monkeypatch.setattr(warnings, "showwarning", lambda message, *_: seen.append(message))
        with plain_warnings():
            warnings.warn("the box straddles zero", stacklevel=1)
            warnings.warn("an old name", DeprecationWarning, stacklevel=1)
        warnings.warn("afterwards", stacklevel=1)
    assert capsys.readouterr().err == "kedge: warning: the box straddles zero\n"
    assert [str(message) for message in seen] == ["an old name", "afterwards"]
