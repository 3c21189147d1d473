import socket

import pytest

from kedge.apps.serve import execute
from kedge.core.errors import KedgeError


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (("0.0.0.0", 8020, None, 1.0), "expected --token"),
        (("0.0.0.0", 8020, "", 1.0), "expected --token"),
        (("127.0.0.1", 8020, "", 1.0), "found an empty one"),
        (("127.0.0.1", 99999, None, 1.0), "found 99999, expected 1 to 65535"),
        (("127.0.0.1", 8020, None, 0.0), "found 0, expected 0.1 to 100"),
        (("127.0.0.1", 8020, None, float("nan")), "found nan"),
    ],
)
def test_settings_of_no_use_are_refused(settings, text):
    with pytest.raises(KedgeError, match=text):
        execute(*settings)


def test_a_port_in_use_is_said_before_anything_is_simulated():
    pytest.importorskip("fastapi")
    pytest.importorskip("uvicorn")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(KedgeError, match=f"127.0.0.1:{port}.*expected a free port"):
            execute("127.0.0.1", port, None, 1.0)
